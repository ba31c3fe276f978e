//! Checks for damaged samples: impossible values, clipping, stuck channels, single wrong values and lasting steps.

use std::f64::consts::FRAC_1_SQRT_2;

use statrs::function::erf::erf;

use super::{
    movement::{INRUSH_S, MIN_QUIET, Movement},
    samples::{every, quantum, samples_in, second_difference_noise},
};
use crate::{
    estimate::{lanes::largest, rejection::Rejection},
    throw::Channel,
};

/// Largest plausible current \[A\]; public recordings contain 188,776 A.
const LARGEST_CURRENT_A: f64 = 1000.0;
/// Largest plausible position \[mm\].
const LARGEST_POSITION_MM: f64 = 10_000.0;
/// Least value of a clipped plateau, as share of the peak.
const CLIPPED_SHARE: f64 = 0.5;
/// A plateau of the largest value is clipped if it has at least this many samples and its flanks fall by at least this
/// many steps of the converter within the width of the plateau. A smooth crest has lower flanks: it varies by at most
/// one step within the plateau, so one width outside it has fallen by nine steps at most.
const CLIPPED_SAMPLES: usize = 3;
const CLIPPED_FLANK: f64 = 30.0;
/// Probability above which noise may have made the samples of a plateau equal. Under them, the crest then varies by this
/// many standard deviations of the noise more.
const EQUAL_CHANCE: f64 = 1e-6;
const CREST_SIGMAS: f64 = 4.0;
/// Least number of equal consecutive samples of a stuck channel.
const REPEATED_SAMPLES: f64 = 25.0;
/// Probability, at each sample, that a working channel counts as stuck. A throw at 20 kHz has 90,000 samples.
const REPEATED_CHANCE: f64 = 1e-9;
/// A fast first search compares only the two ends of parts of this many samples: every stretch of at least
/// [`REPEATED_SAMPLES`] equal samples contains one whole part.
const REPEATED_PART: usize = 13;
/// A position without noise may repeat longer: this many times the time of one converter step at mean speed, and at
/// least this time \[s\] for the slow start of the toe.
const REPEATED_STEPS: f64 = 10.0;
const REPEATED_S: f64 = 0.02;
/// While the machine unlocks, the toe stands within this many converter steps of its position at rest. It leaves this
/// position by at most as many steps plus this multiple of the mean movement between samples. A stuck sensor jumps
/// instead.
const STANDING_STEPS: f64 = 1.5;
const DEPARTURE_MEAN_STEPS: f64 = 2.0;
/// Longest repetition of a current without noise, as share of the movement: such a current may be constant.
const LEVEL_CURRENT_SHARE: f64 = 0.3;

/// Rejects values that are not finite, or not plausible.
pub(crate) fn values(current: &[f64], position: &[f64], interval_s: f64) -> Result<(), Rejection> {
    let channels = [(Channel::Current, current, LARGEST_CURRENT_A), (Channel::Position, position, LARGEST_POSITION_MM)];
    // A fast check that the usual trace passes. A comparison with NaN is false.
    let is_plausible = |values: &[f64], largest: f64| every(values.iter().map(|v| v.abs() <= largest));
    if channels.iter().all(|(_, values, largest)| is_plausible(values, *largest)) {
        return Ok(());
    }
    for (channel, values, _) in channels {
        if let Some(sample) = values.iter().position(|v| !v.is_finite()) {
            return Err(Rejection::NotFinite { channel, sample, at_s: sample as f64 * interval_s });
        }
    }
    for (channel, values, largest) in channels {
        if let Some(at) = values.iter().position(|v| v.abs() > largest) {
            return Err(Rejection::ImplausibleValue { channel, at_s: at as f64 * interval_s, value: values[at] });
        }
    }
    Ok(())
}

/// Rejects a clipped current: a plateau of equal extreme values with steep flanks.
pub(crate) fn clipping(current: &[f64], interval_s: f64) -> Result<(), Rejection> {
    let limits = [1.0, -1.0].map(|sign| (sign, largest([current], |[i]| sign * i)));
    let least = CLIPPED_SHARE * limits[0].1.max(limits[1].1);
    for (sign, limit) in limits {
        let Some(from) = current.iter().position(|i| sign * i >= limit).filter(|_| limit >= least) else { continue };
        let length = current[from..].iter().take_while(|i| sign * **i >= limit).count();
        if length < CLIPPED_SAMPLES || from == 0 {
            continue;
        }
        let drop_at = |k: usize| current.get(k).map_or(0.0, |i| limit - sign * i);
        let before = drop_at(from.saturating_sub(length));
        let after = drop_at(from + 2 * length - 1);
        let step = quantum(current);
        let noise = second_difference_noise(current, &mut Vec::new());
        let by_chance = equal_share(noise / step).powf(length as f64) > EQUAL_CHANCE;
        let steep = CLIPPED_FLANK * if by_chance { step + CREST_SIGMAS * noise } else { step };
        if before.min(after).max(drop_at(from - 1)) > steep && before > steep {
            return Err(Rejection::Clipped { limit: sign * limit, at_s: from as f64 * interval_s });
        }
    }
    Ok(())
}

/// Rejects a channel that repeats a value during the movement for longer than the converter step explains.
///
/// A machine may unlock for some tenths of a second before its toe moves. A converter whose step is larger than the
/// noise repeats the position at rest for this time, and then goes on from it step by step. This is not a stuck
/// channel.
pub(crate) fn sticking(
    movement: &Movement<'_>,
    channel: Channel,
    values: &[f64],
    interval_s: f64,
    factor: usize,
) -> Result<(), Rejection> {
    let to = (movement.near_end * factor).min(values.len());
    let start = (movement.start() * factor).min(to);
    // Without a part with equal ends there is no long stretch of equal values.
    let is_equal = |part: &[f64]| part[0].to_bits() == part[part.len() - 1].to_bits();
    if !values[..to].chunks_exact(REPEATED_PART).any(is_equal) {
        return Ok(());
    }
    let step = quantum(&values[start..to]);
    let noisy = movement.level(channel).hides(step) && step > 0.0;
    let mean_step = movement.travel_mm / (to - start).max(1) as f64;
    let rest = &values[..start];
    // Without noise the values before the start of the motor are equal in a working channel too.
    let from = if noisy { 0 } else { start };
    let values = &values[from..to];
    let longest = match channel {
        _ if noisy => repeated_by_chance(movement.level(channel).sd / step).max(repeated_as_at_rest(rest)),
        Channel::Position => REPEATED_SAMPLES.max(REPEATED_STEPS * step / mean_step).max(REPEATED_S / interval_s),
        Channel::Current => REPEATED_SAMPLES.max(LEVEL_CURRENT_SHARE * values.len() as f64),
    };
    let longest = if channel == Channel::Position { longest * movement.position_every } else { longest };
    let waits = |value: f64, next: Option<&f64>| {
        let departure = STANDING_STEPS * step + DEPARTURE_MEAN_STEPS * mean_step;
        channel == Channel::Position
            && !noisy
            && (value - movement.position.mean).abs() <= STANDING_STEPS * step
            && next.is_some_and(|next| (next - value).abs() <= departure)
    };
    let mut at = 0;
    for stretch in values.chunk_by(|a, b| a.to_bits() == b.to_bits()) {
        if stretch.len() as f64 > longest && !waits(stretch[0], values.get(at + stretch.len())) {
            let (at_s, stuck_s) = ((from + at) as f64 * interval_s, stretch.len() as f64 * interval_s);
            return Err(Rejection::Stuck { channel, value: stretch[0], at_s, stuck_s });
        }
        at += stretch.len();
    }
    Ok(())
}

/// Largest number of equal consecutive samples of a working channel with this noise \[steps of the converter\].
fn repeated_by_chance(noise: f64) -> f64 {
    REPEATED_SAMPLES.max(REPEATED_CHANCE.ln() / equal_share(noise).ln())
}

/// Probability that white noise \[steps of the converter\] leaves a sample within a converter step, for the worst case:
/// a level in the middle of the step.
fn equal_share(noise: f64) -> f64 {
    erf(0.5 * FRAC_1_SQRT_2 / noise)
}

/// Largest number of equal consecutive samples of a working channel that repeats its values as at rest. A logger that
/// averages its samples makes noise that is not white, and repeats values more often. If each sample is equal to the
/// one before with the same probability, the longest stretch grows with the logarithm of the number of samples. The
/// last stretch at rest may go on in motion, and does not count.
fn repeated_as_at_rest(rest: &[f64]) -> f64 {
    let stretches = rest.chunk_by(|a, b| a.to_bits() == b.to_bits()).map(<[f64]>::len);
    let longest = stretches.rev().skip(1).max().unwrap_or(0);
    longest as f64 * REPEATED_CHANCE.ln() / (rest.len().max(2) as f64).recip().ln()
}

/// Least height of a spike: as share of the peak current or of the travel, and in standard deviations of the noise.
const SPIKE_CURRENT_SHARE: f64 = 0.02;
const SPIKE_TRAVEL_SHARE: f64 = 0.002;
const SPIKE_SIGMAS: f64 = 12.0;
/// Factor on these shares for a filtered trace, which usually has a low rate: there vibrations of the machine look like
/// spikes.
const SPIKE_FILTERED_FACTOR: f64 = 10.0;
/// Least height of a spike as share of the signal's change over two samples: on a steep flank, jitter of the sampling
/// looks like a spike.
const SPIKE_SLOPE_SHARE: f64 = 0.4;
/// Tolerance of the shape of a spike, as share of its height. A value minus the mean of its neighbours is the height at
/// the spike, minus half the height next to it, and 0 two samples away.
const SPIKE_BESIDE_SHARE: f64 = 0.3;
/// This many spikes, or more, are a ripple that the sampling hardly resolves.
const RIPPLE_SPIKES: usize = 6;

/// Samples of a part of the trace in the fast check for spikes.
const SPIKE_PART: usize = 64;

/// Rejects single values far from their neighbours. The second difference is large at such a spike, half as large with
/// the opposite sign at the neighbours, and small two samples away, unlike the ringing of an anti-alias filter after
/// the inrush. A few spikes are corrupt values. Many are a ripple that the sampling hardly resolves, and pass.
pub(crate) fn spikes(movement: &Movement<'_>, channel: Channel, filtered: bool) -> Result<(), Rejection> {
    let values = movement.values(channel);
    let range = if channel == Channel::Current {
        SPIKE_CURRENT_SHARE * movement.peak_a
    } else {
        SPIKE_TRAVEL_SHARE * movement.travel_mm
    };
    let range = if filtered { SPIKE_FILTERED_FACTOR * range } else { range };
    let threshold =
        range.max(SPIKE_SIGMAS * movement.level(channel).sd).max(3.0 * movement.level(channel).quantum.min(range));
    let bend = |k: usize| values[k] - 0.5 * (values[k - 1] + values[k + 1]);
    let steep = |k: usize| SPIKE_SLOPE_SHARE * (values[k + 1] - values[k - 1]).abs();
    let last = movement.near_end.min(values.len().saturating_sub(3));
    // A fast check that nearly all parts of a trace pass.
    let is_straight = |[a, b, c]: &[f64; 3]| {
        let here = (b - 0.5 * (a + c)).abs();
        (here <= threshold) | (here <= SPIKE_SLOPE_SHARE * (c - a).abs())
    };
    let parts = (3..last).step_by(SPIKE_PART).map(|from| from..last.min(from + SPIKE_PART));
    let bent = parts.filter(|part| !every(values[part.start - 1..=part.end].array_windows().map(is_straight)));
    let mut spikes = bent.flatten().filter(|&k| {
        let here = bend(k);
        let opposite = |beside: f64| -beside * here.signum() > SPIKE_BESIDE_SHARE * here.abs();
        let quiet = |further: f64| further.abs() < SPIKE_BESIDE_SHARE * here.abs();
        here.abs() > threshold.max(steep(k))
            && opposite(bend(k - 1))
            && opposite(bend(k + 1))
            && quiet(bend(k - 2))
            && quiet(bend(k + 2))
    });
    match spikes.next() {
        Some(at) if spikes.count() + 1 < RIPPLE_SPIKES => {
            Err(Rejection::Spike { channel, height: bend(at), at_s: at as f64 * movement.interval_s })
        }
        _ => Ok(()),
    }
}

/// Least height of a step within the inrush: as share of the peak current, and in standard deviations of the noise. The
/// check compares single samples, as a mean over the steep flank of the inrush hides a step.
const INRUSH_STEP_SHARE: f64 = 0.18;
const INRUSH_STEP_SIGMAS: f64 = 12.0;
/// Samples after the start of the motor that are checked for such a step.
const INRUSH_STEP_SAMPLES: std::ops::Range<usize> = 3..19;
/// Least height of a step in means of half the length: as share of its height in the long means (1 for a step, an
/// eighth for a smooth signal), and in standard deviations of its noise.
const SHORT_MEAN_SHARE: f64 = 0.6;
const SHORT_MEAN_SIGMAS: f64 = 5.0;
/// Length of the mean on each side of a step \[s\].
const STEP_S: f64 = 0.008;
/// Least height of a step in standard deviations of its noise: a trace has several thousand places for a false step.
const STEP_SIGNIFICANCE: f64 = 6.5;
/// Longest sampling interval at which a smooth movement shows no step \[s\]. The apparent step grows with the third
/// power of the interval.
const SMOOTH_S: f64 = 0.003;
/// Least step of the current, as share of its peak; rails and friction cause smaller steps.
const LEAST_STEP: f64 = 0.006;
/// Least step of the position, as share of the travel.
pub(super) const LEAST_SLIP: f64 = 5e-4;

/// Rejects a lasting step of the current within the inrush.
fn inrush_step(movement: &Movement<'_>, sd: f64) -> Result<(), Rejection> {
    let current = movement.current_a;
    let least_a = (INRUSH_STEP_SIGMAS * sd).max(INRUSH_STEP_SHARE * movement.peak_a);
    let is_step = |k: &usize| {
        let [a, b, c, d] = [current[k - 1], current[*k], current[k + 1], current[k + 2]];
        (0.5 * (a - d) + 1.5 * (c - b)).abs() > least_a
    };
    let [from, to] = [INRUSH_STEP_SAMPLES.start, INRUSH_STEP_SAMPLES.end].map(|after| movement.start() + after);
    let mut found = (from..to.min(current.len().saturating_sub(2))).filter(is_step);
    // One step shows at two neighbouring samples too. More come from a switching supply.
    match found.next() {
        Some(at) if found.count() < 3 => {
            Err(Rejection::CurrentJump { jump_a: current[at + 1] - current[at], at_s: at as f64 * movement.interval_s })
        }
        _ => Ok(()),
    }
}

/// Rejects a lasting step between two samples. Inductance and inertia prevent such a step in current and position, so
/// the cause is a changed gain, a shifted offset or lost samples. The difference of the means over 8 ms before and
/// after a sample, without the trend, is compared with that over 4 ms: both are the height of a step, but for a smooth
/// signal the shorter means differ by only an eighth as much. Many steps are a ripple that the sampling hardly
/// resolves, and pass.
pub(crate) fn steps(
    movement: &Movement<'_>,
    channel: Channel,
    noise: f64,
    sums: &mut Vec<f64>,
) -> Result<(), Rejection> {
    let (values, interval_s) = (movement.values(channel), movement.interval_s);
    // A step at rest increases the standard deviation at rest, but not `noise`, which comes from differences.
    let rest = movement.level(channel);
    let sd = if rest.samples < MIN_QUIET { noise } else { rest.sd.min(noise) }.max(rest.quantum);
    let start = movement.start();
    let wide = 2 * samples_in(0.5 * STEP_S, interval_s).clamp(2, 16);
    if channel == Channel::Current {
        inrush_step(movement, sd)?;
    }
    sums.clear();
    sums.push(0.0);
    let mut sum = 0.0;
    sums.extend(values.iter().map(|v| {
        sum += v - values[0];
        sum
    }));
    let step = |k: usize, width: usize| {
        let [a, b, c, d, e] =
            [k + 1 - 2 * width, k + 1 - width, k + 1, k + 1 + width, k + 1 + 2 * width].map(|at| sums[at]);
        (1.5 * (d - c - (c - b)) - 0.5 * (e - d - (b - a))) / width as f64
    };
    // The height of a step has 5 / width of the variance of a sample.
    let [long, short] = [wide, wide / 2].map(|width| sd * (5.0 / width as f64).sqrt());
    let settled = start + samples_in(INRUSH_S, interval_s) + wide;
    let (clear, least) = match channel {
        // Inductance and back-EMF oscillate faster than these means.
        Channel::Current => (start.saturating_sub(2 * wide)..settled, LEAST_STEP * movement.peak_a),
        // The toe starts with a jerk, which the means before the start contain as well.
        Channel::Position => (start.saturating_sub(wide)..start + 4 * wide, LEAST_SLIP * movement.travel_mm),
    };
    let last = (movement.near_end + 1).min(values.len()).saturating_sub(2 * wide);
    let threshold = (STEP_SIGNIFICANCE * long).max(least * (interval_s / SMOOTH_S).powi(3).max(1.0));
    // A fast check that the usual trace passes: no step before or after the excluded part.
    let is_flat = |from: usize, to: usize| {
        let Some(count) = to.checked_sub(from).filter(|count| *count > 0) else { return true };
        let [a, b, c, d, e] = std::array::from_fn(|at| &sums[from + 1 + at * wide - 2 * wide..][..count]);
        every((0..count).map(|k| {
            let size = 1.5 * (d[k] - c[k] - (c[k] - b[k])) - 0.5 * (e[k] - d[k] - (b[k] - a[k]));
            size.abs() <= threshold * wide as f64
        }))
    };
    let first = 2 * wide - 1;
    if is_flat(first, clear.start.min(last)) && is_flat(clear.end.max(first), last) {
        return Ok(());
    }
    let mut found = (first..last).filter(|k| {
        let size = step(*k, wide);
        !clear.contains(k) && size.abs() > threshold && {
            let near = step(*k, wide / 2) * size.signum();
            near > (SHORT_MEAN_SIGMAS * short).max(SHORT_MEAN_SHARE * size.abs())
        }
    });
    let Some(at) = found.next() else { return Ok(()) };
    // One step shows at a few neighbouring samples.
    if found.count() > 5 * wide {
        return Ok(());
    }
    let (size, at_s) = (step(at, wide), at as f64 * interval_s);
    Err(match channel {
        Channel::Current => Rejection::CurrentJump { jump_a: size, at_s },
        Channel::Position => Rejection::PositionJump { jump_mm: size.abs(), at_s },
    })
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::estimate::trace::samples::Level;

    /// A crest as that of an inrush at 1 kHz, with a noise of two converter steps, or clipped at three quarters.
    #[test]
    fn equal_samples_of_a_noisy_crest_are_not_clipped() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut false_alarms = 0;
        for _ in 0..20_000 {
            let crest = |k: i32| 25.8 / (1.0 + (f64::from(k) / 25.0).powi(2));
            let mut samples: Vec<f64> = (-100..300)
                .map(|k| 0.01 * (100.0 * crest(k) + 2.0 * rng.sample::<f64, _>(StandardNormal)).round())
                .collect();
            false_alarms += u32::from(clipping(&samples, 1e-3).is_err());
            for amperes in &mut samples {
                *amperes = amperes.min(19.0);
            }
            assert!(matches!(clipping(&samples, 1e-3), Err(Rejection::Clipped { .. })));
        }
        assert_eq!(false_alarms, 0);
    }

    /// The level is in the middle of a converter step, where equal samples are most frequent.
    #[test]
    fn millions_of_samples_of_a_coarse_converter_are_not_stuck() {
        let noise = 0.62;
        let level = Level { mean: 0.0, sd: noise, samples: 200, quantum: 1.0 };
        let movement = Movement {
            motor_off: Some(4500),
            current: level,
            travel_mm: 115.0,
            near_end: 4400,
            quiet: 200,
            ..Movement::of(&[0.0], &[0.0], 5e-5, None, &mut Vec::new())
        };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let samples: Vec<f64> =
            (0..8_000_000).map(|_| (3.0 + noise * rng.sample::<f64, _>(StandardNormal)).round()).collect();
        assert_eq!(sticking(&movement, Channel::Current, &samples, 5e-5, samples.len() / 4400), Ok(()));
        let mut stuck = samples[..90_000].to_vec();
        stuck[40_000..40_050].fill(3.0);
        assert!(matches!(sticking(&movement, Channel::Current, &stuck, 5e-5, 20), Err(Rejection::Stuck { .. })));
    }
}
