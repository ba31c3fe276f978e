//! Statistics of samples: level, noise, converter step, median and peak.

use crate::estimate::lanes::{largest, sum};

/// Mean and standard deviation of a channel at rest, in its unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Level {
    pub(crate) mean: f64,
    pub(crate) sd: f64,
    /// Number of samples at rest.
    pub(crate) samples: usize,
    /// Quantum of the channel: one step of its analogue-to-digital converter, from the whole trace; 0 if unknown.
    pub(crate) quantum: f64,
}

impl Level {
    /// Whether the noise hides this step of the converter, so that a constant value does not give the same output for
    /// long. A constant value between two outputs of the converter makes it flicker with a standard deviation of half a
    /// step, even with hardly any noise; this does not count.
    pub(crate) fn hides(&self, step: f64) -> bool {
        self.sd > 0.6 * step
    }

    pub(crate) fn of(values: &[f64]) -> Self {
        if values.is_empty() {
            return Self::default();
        }
        // A difference from the first value, so that the mean of equal values is exact.
        let mean = values[0] + sum([values], |[v]| v - values[0]) / values.len() as f64;
        let squares = sum([values], |[v]| (v - mean) * (v - mean));
        let sd = if values.len() > 1 { (squares / (values.len() - 1) as f64).sqrt() } else { 0.0 };
        Self { mean, sd, samples: values.len(), quantum: 0.0 }
    }
}

/// Largest distance of a value from the level; 0 without values.
pub(crate) fn peak(values: &[f64], level: f64) -> f64 {
    largest([values], |[v]| (v - level).abs()).max(0.0)
}

/// Whether all tests are true. It counts them, as a loop that may end early takes three times as long.
pub(crate) fn every(tests: impl ExactSizeIterator<Item = bool>) -> bool {
    let count = tests.len() as u64;
    tests.map(u64::from).sum::<u64>() == count
}

/// Index of the first value from `from` on of which the function is at least `least`.
pub(super) fn first(values: &[f64], from: usize, least: f64, of: impl Fn(f64) -> f64) -> Option<usize> {
    // A fast check that nearly all parts of a trace fail.
    const PART: usize = 64;
    let parts = values.get(from..)?.chunks(PART);
    let part = from + PART * parts.map(|part| largest([part], |[v]| of(v))).position(|largest| largest >= least)?;
    values[part..].iter().position(|v| of(*v) >= least).map(|at| part + at)
}

/// Mean of the values; 0 without values.
pub(crate) fn mean(values: &[f64]) -> f64 {
    sum([values], |[v]| v) / values.len().max(1) as f64
}

/// Mean distance of the values from a level; 0 without values.
pub(crate) fn mean_distance(values: &[f64], level: f64) -> f64 {
    sum([values], |[v]| (v - level).abs()) / values.len().max(1) as f64
}

/// Fills `integral` with the integral of the values less a level, by trapezoids, from the first value on.
pub(crate) fn integrate(integral: &mut Vec<f64>, values: &[f64], level: f64, interval_s: f64) {
    let area = |before: f64, after: f64| (0.5 * (before + after) - level) * interval_s;
    integral.clear();
    integral.reserve(values.len());
    integral.push(0.0);
    let (mut sum, mut rest) = (0.0, values);
    // In blocks of four, so that one addition in four waits for the sum before it.
    while let [a, b, c, d, e, ..] = *rest {
        let (one, third) = (area(a, b), area(c, d));
        let (two, last) = (one + area(b, c), third + area(d, e));
        integral.extend([sum + one, sum + two, sum + (two + third), sum + (two + last)]);
        sum += two + last;
        rest = &rest[4..];
    }
    integral.extend(rest.array_windows().map(|[before, after]| {
        sum += area(*before, *after);
        sum
    }));
}

/// Number of whole sampling intervals in a time; both in s.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time over an interval")]
pub(crate) fn samples_in(time_s: f64, interval_s: f64) -> usize {
    (time_s / interval_s) as usize
}

/// Whether a sampling interval is that of at least this rate. A rate computed from the times of a recording is wrong by
/// less than a thousandth.
pub(crate) fn has_rate(interval_s: f64, rate_hz: f64) -> bool {
    interval_s * rate_hz <= 1.0 + 1e-3
}

/// Median (for an even number of values the upper one), computed in the scratch buffer; 0 without values.
pub(crate) fn median_of(values: &[f64], scratch: &mut Vec<f64>) -> f64 {
    scratch.clear();
    scratch.extend_from_slice(values);
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *scratch.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Median of values that are not negative, computed in place; 0 without values. Such values have the same order as
/// their bits, and integers compare faster.
pub(crate) fn median_of_magnitudes(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by_key(middle, |value| value.to_bits()).1 }
}

/// Median distance of values from a level, computed in the scratch buffer; 0 without values.
pub(super) fn median_distance(values: &[f64], level: f64, scratch: &mut Vec<f64>) -> f64 {
    scratch.clear();
    scratch.extend(values.iter().map(|v| (v - level).abs()));
    median_of_magnitudes(scratch)
}

/// Ratio of the standard deviation of a normal variable to the median of its magnitude.
pub(crate) const SD_PER_MEDIAN: f64 = 1.4826;

/// Standard deviation of white noise on a smooth signal, from the median of its second differences.
pub(crate) fn second_difference_noise(values: &[f64], scratch: &mut Vec<f64>) -> f64 {
    scratch.clear();
    scratch.extend(values.array_windows().map(|[a, b, c]| (c - 2.0 * b + a).abs()));
    SD_PER_MEDIAN * median_of_magnitudes(scratch) / 6.0_f64.sqrt()
}

/// Standard deviation of white noise from first differences, for a mostly constant signal.
pub(super) fn first_difference_noise(values: &[f64], scratch: &mut Vec<f64>) -> f64 {
    scratch.clear();
    scratch.extend(values.array_windows().map(|[a, b]| (b - a).abs()));
    SD_PER_MEDIAN * median_of_magnitudes(scratch) / 2.0_f64.sqrt()
}

/// The smallest difference other than 0 between neighbouring values: the step of the converter if noise does not hide
/// it. 0 if all values are equal.
pub(crate) fn quantum(values: &[f64]) -> f64 {
    let neighbours = [&values[..values.len().max(1) - 1], values.get(1..).unwrap_or_default()];
    let least = -largest(neighbours, |[before, after]| {
        let difference = (after - before).abs();
        if difference > 0.0 { -difference } else { f64::NEG_INFINITY }
    });
    if least.is_finite() { least } else { 0.0 }
}
