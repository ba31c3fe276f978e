//! Channels with fewer new values than samples. A logger that reads a slow sensor, or samples slowly, repeats each
//! value until the next one, or sends `null` instead.

use super::{
    movement::start_of_motor,
    samples::{median_of, quantum, samples_in},
};
use crate::throw::Trace;

/// A channel with this many new values, or fewer, is left as it is.
const LEAST_UPDATES: usize = 10;
/// Least median change from one value to the next \[steps of the converter\]. A coarse converter without noise repeats
/// its values as well, but then changes by one step.
const LEAST_CHANGE: f64 = 1.5;
/// New values must come regularly: this share of the times from one to the next must equal their median, within one
/// sample or within `REGULAR_TOLERANCE` of it.
const REGULAR_SHARE: f64 = 0.6;
const REGULAR_TOLERANCE: f64 = 0.1;

/// The values that a logger measured, at the rate of the current's new values.
pub(crate) struct Resampled {
    pub(crate) trace: Trace,
    /// Its first sample in the trace of the logger, and the number of samples there from one to the next.
    pub(crate) first: usize,
    pub(crate) every: usize,
    /// Number of its samples from one new position to the next; the positions between them are on a line.
    pub(crate) position_every: f64,
}

/// The values that the logger of this trace measured; `None` if both channels have a new value in each sample.
pub(crate) fn resampled(trace: &Trace) -> Option<Resampled> {
    let channels = [trace.current_a(), trace.position_mm()];
    let [current, position] = channels.map(Updates::of);
    if current.is_none() && position.is_none() {
        return None;
    }
    let joined = |values: &[f64], updates: &Option<Updates>, start: Option<usize>| match updates {
        Some(updates) => updates.joined(values, start),
        None => values.to_vec(),
    };
    let current_a = joined(channels[0], &current, None);
    // Before the start of the motor the toe stands, so no line may begin before it.
    let start = start_of_motor(&current_a, 1.0 / trace.sample_rate_hz(), &mut Vec::new());
    let position_mm = joined(channels[1], &position, start);
    let every = current.as_ref().map_or(1, |updates| updates.every);
    let first = current.as_ref().map_or(0, Updates::phase);
    let picked = |values: Vec<f64>| values.into_iter().skip(first).step_by(every).collect();
    let position_every = position.map_or(1.0, |updates| (updates.every as f64 / every as f64).max(1.0));
    let trace = Trace::new(trace.sample_rate_hz() / every as f64, picked(current_a), picked(position_mm)).ok()?;
    Some(Resampled { trace, first, every, position_every })
}

/// Power of the noise at low frequencies if one of `every` samples is measured and lines join these, as multiple of
/// that of white noise with the same variance of all samples. A sample at the share f of the way between two measured
/// samples has 1 - 2 f + 2 f² of their variance. With n for `every`, the mean over f is
/// 1 - (n - 1) / n + (n - 1) (2 n - 1) / (3 n²).
pub(crate) fn noise_power(every: f64) -> f64 {
    let between = (every - 1.0) / every;
    every / (1.0 - between + between * (2.0 * every - 1.0) / (3.0 * every))
}

/// The new values of a channel that repeats its values.
struct Updates {
    /// Usual number of samples from one new value to the next, at least 2.
    every: usize,
    /// Indices of the samples with a new value.
    at: Vec<usize>,
}

impl Updates {
    /// `None` if the channel does not repeat its values.
    fn of(values: &[f64]) -> Option<Self> {
        // A fast check for the usual traces: a new value in most samples, or a coarse converter. A comparison with NaN
        // is false.
        let changes_of = |least: f64| values.array_windows().filter(|[a, b]| (b - a).abs() > least).count();
        let changed = changes_of(0.0);
        if 3 * changed > 2 * values.len() || 2 * changes_of(LEAST_CHANGE * quantum(values)) < changed {
            return None;
        }
        let (mut at, mut new) = (Vec::new(), Vec::new());
        for (sample, value) in values.iter().enumerate() {
            if value.is_finite() && new.last() != Some(value) {
                at.push(sample);
                new.push(*value);
            }
        }
        if at.len() <= LEAST_UPDATES {
            return None;
        }
        let gaps: Vec<f64> = at.array_windows().map(|[before, after]| (after - before) as f64).collect();
        let changes: Vec<f64> = new.array_windows().map(|[before, after]| (after - before).abs()).collect();
        let mut scratch = Vec::new();
        let (gap, change) = (median_of(&gaps, &mut scratch), median_of(&changes, &mut scratch));
        let tolerance = (REGULAR_TOLERANCE * gap).max(1.0);
        let regular = gaps.iter().filter(|samples| (**samples - gap).abs() <= tolerance).count();
        let every = samples_in(gap, 1.0);
        let is_held =
            every > 1 && change >= LEAST_CHANGE * quantum(&new) && regular as f64 >= REGULAR_SHARE * gaps.len() as f64;
        is_held.then_some(Self { every, at })
    }

    /// Index of the first sample with a new value if all were regular: the most frequent remainder of the indices
    /// divided by `every`.
    fn phase(&self) -> usize {
        let mut counts = vec![0_usize; self.every];
        for at in &self.at {
            counts[at % self.every] += 1;
        }
        (0..self.every).max_by_key(|phase| counts[*phase]).unwrap_or(0)
    }

    /// The channel with a line from each new value to the next one. If a value is repeated for longer than usual, the
    /// sensor measured the same value again: then the line begins `every` samples before the next value. A line across
    /// the sample `start` begins there. Longer stretches of missing samples stay missing.
    fn joined(&self, values: &[f64], start: Option<usize>) -> Vec<f64> {
        let mut joined = values.to_vec();
        let mut measured = 0;
        for sample in 0..values.len() {
            if !values[sample].is_nan() {
                measured = sample;
            } else if sample - measured <= self.every {
                joined[sample] = values[measured];
            }
        }
        for [before, after] in self.at.array_windows() {
            let from = if after - before > self.every + 1 { after - self.every } else { *before };
            let from = start.filter(|start| (from..*after).contains(start)).unwrap_or(from);
            let (old, new) = (values[*before], values[*after]);
            for sample in from + 1..*after {
                joined[sample] = old + (new - old) * (sample - from) as f64 / (after - from) as f64;
            }
        }
        joined
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A trace of 2,000 samples at 1 kHz: the position with small steps of the converter, the current without.
    fn trace(current: impl Fn(usize) -> f64, position: impl Fn(usize) -> f64) -> Trace {
        let values = |of: &dyn Fn(usize) -> f64| (0..2000).map(of).collect();
        Trace::new(1000.0, values(&current), values(&position)).unwrap()
    }

    fn toe(sample: usize) -> f64 {
        18.75 * (1.0 - (sample.saturating_sub(300).min(1500) as f64 / 1500.0 * std::f64::consts::PI).cos())
    }

    fn motor(sample: usize) -> f64 {
        3.0 + (0.37 * sample as f64).sin()
    }

    #[test]
    fn channels_with_a_new_value_in_each_sample_and_coarse_converters_are_left_alone() {
        assert!(resampled(&trace(motor, toe)).is_none());
        assert!(resampled(&trace(motor, |at| (toe(at) / 0.1).round() * 0.1)).is_none());
        assert!(resampled(&trace(motor, |_| f64::NAN)).is_none());
        assert!(resampled(&trace(motor, |_| 0.0)).is_none());
    }

    #[test]
    fn a_slow_position_is_joined_by_lines_also_between_nulls_and_with_irregular_distances() {
        let usual = |at: usize| toe(7 + at.saturating_sub(7) / 10 * 10);
        let nulls = |at: usize| if at % 10 == 7 { toe(at) } else { f64::NAN };
        let irregular = |at: usize| toe((at * 10 / 103 * 103).div_ceil(10));
        for position in [&usual as &dyn Fn(usize) -> f64, &nulls, &irregular] {
            let Resampled { trace, position_every, .. } = resampled(&trace(motor, position)).unwrap();
            assert_eq!((trace.len(), position_every), (2000, 10.0));
            let far = trace.position_mm()[10..1900].iter().enumerate().map(|(at, mm)| (mm - toe(at + 10)).abs());
            let largest = far.fold(0.0, f64::max);
            assert!(largest < 0.1, "at the start and at the end the line cuts a corner: {largest}");
        }
    }

    #[test]
    fn held_channels_are_sampled_at_the_rate_of_the_current() {
        let held = |at: usize| 3 + at.saturating_sub(3) / 5 * 5;
        let Resampled { trace, first, every, position_every } =
            resampled(&trace(|at| motor(held(at)), |at| toe(held(at)))).unwrap();
        assert_eq!((trace.sample_rate_hz(), first, every, position_every), (200.0, 3, 5, 1.0));
        assert!(trace.current_a().iter().enumerate().all(|(k, a)| (a - motor(3 + 5 * k)).abs() < 1e-12));
        assert!(trace.position_mm()[1..].iter().enumerate().all(|(k, mm)| (mm - toe(8 + 5 * k)).abs() < 1e-12));
    }

    #[test]
    fn the_noise_of_joined_values_is_that_of_the_measured_ones() {
        assert!((noise_power(1.0) - 1.0).abs() < 1e-12 && (noise_power(2.0) - 2.0 / 0.75).abs() < 1e-12);
    }
}
