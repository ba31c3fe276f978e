//! Checks of a trace before the estimation.

use super::{
    movement::{Level, MIN_QUIET, Movement, every, largest, mean, median_of_magnitudes, peak, quantum},
    rejection::{Channel, Rejection},
    settings::Settings,
};

/// Largest plausible current \[A\] and position \[mm\]; public recordings contain 188,776 A.
const LARGEST_CURRENT_A: f64 = 1000.0;
const LARGEST_POSITION_MM: f64 = 10_000.0;
/// Shortest movement: \[mm\], as share of the stroke, and in standard deviations of the position noise. A locked rail
/// that bends moves less.
const LEAST_TRAVEL_MM: f64 = 2.0;
const LEAST_TRAVEL_SHARE: f64 = 0.02;
const LEAST_TRAVEL_SIGMAS: f64 = 8.0;
/// Largest bend of the rails of a locked toe \[mm\], and least distance of two medians that noise does not cause
/// \[standard deviations\].
const LARGEST_BEND_MM: f64 = 20.0;
const MEDIAN_SIGMAS: f64 = 3.0;
/// Difference of the first and the last quarter of the quiet samples from which the toe was displaced \[standard
/// deviations\]: 200 samples of white noise or hum cause less than 0.8, a displacement at any time 0.9 or more.
const DISPLACED_SIGMAS: f64 = 0.85;
/// Least speed of a moving toe in a noisy position, as share of its mean speed, and least movement \[standard deviations\].
const LEAST_SPEED_SHARE: f64 = 0.25;
const MOVED_SIGMAS: f64 = 4.0;
/// Least and largest travel of a complete throw, as share of the stroke.
const COMPLETE_SHARE: f64 = 0.95;
const TOO_LONG_SHARE: f64 = 1.15;
/// Longest movement \[s\]: machines take 0.5 to 10 s, and their overload protection ends much longer movements.
const LONGEST_MOVEMENT_S: f64 = 30.0;
/// Longest time of the motor after the arrival of the toe \[s\].
const LONGEST_STALL_S: f64 = 0.5;
/// Least peak current, in standard deviations of the noise: chance gives six once in 10^9 samples.
const LEAST_CURRENT_SIGMAS: f64 = 6.0;
/// Largest movement backwards, or before the start of the motor: as share of the travel (the rails spring), and in
/// standard deviations of the noise (largest of several thousand samples).
const WRONG_WAY_SHARE: f64 = 0.02;
const WRONG_WAY_SIGMAS: f64 = 10.0;
/// Displacement of three consecutive positions at the start of the motor, in standard deviations; chance exceeds it in
/// 1 of 1,000,000 healthy throws.
const EARLY_SIGMAS: f64 = 2.8;
/// Current of the first sample, as share of the peak, above which the recording began too late.
const LATE_START_SHARE: f64 = 0.25;
/// Largest ratio of measured to configured noise; more is a fault of the sensor or its wiring. Noise of the current
/// affects the coefficients ten times as much as noise of the position. The covariance uses the measured noise.
const CURRENT_NOISE_FACTOR: f64 = 3.5;
const POSITION_NOISE_FACTOR: f64 = 25.0;
/// Least ratio of peak to running current at the start of a motor.
const INRUSH_FACTOR: f64 = 1.5;
/// A clipped plateau: least number of samples, and least height of its flanks in steps of the converter. (A smooth
/// crest falls by nine times its depth over twice its width, and its depth is at least one step.)
const CLIPPED_SAMPLES: usize = 3;
const CLIPPED_FLANK: f64 = 30.0;
/// Largest number of equal consecutive samples of a working channel: with noise of half a step 25 come once in 10^7
/// samples.
const REPEATED_SAMPLES: f64 = 25.0;
/// Length of parts of which one is within every stretch of more than [`REPEATED_SAMPLES`].
const REPEATED_PART: usize = 13;
/// The same for a slow position: in times of one converter step at mean speed, and \[s\] for the slow start of the toe.
const REPEATED_STEPS: f64 = 10.0;
const REPEATED_S: f64 = 0.02;
/// The same for a current without noise, which may be constant, as share of the movement.
const LEVEL_CURRENT_SHARE: f64 = 0.3;

/// Rejects values that are not finite, or not plausible.
pub(super) fn values(current: &[f64], position: &[f64], interval_s: f64) -> Result<(), Rejection> {
    let channels = [(Channel::Current, current, LARGEST_CURRENT_A), (Channel::Position, position, LARGEST_POSITION_MM)];
    // The usual trace. A comparison with NaN is false.
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
            return Err(Rejection::Implausible { channel, at_s: at as f64 * interval_s, value: values[at] });
        }
    }
    Ok(())
}

/// Rejects a clipped current: a plateau of equal extreme values with steep flanks.
pub(super) fn clipping(current: &[f64], interval_s: f64) -> Result<(), Rejection> {
    for sign in [1.0, -1.0] {
        let limit = largest(current, |i| sign * i);
        let Some(from) = current.iter().position(|i| sign * i >= limit) else { continue };
        let length = current[from..].iter().take_while(|i| sign * **i >= limit).count();
        if length < CLIPPED_SAMPLES || from == 0 {
            continue;
        }
        let drop_at = |k: usize| current.get(k).map_or(0.0, |i| limit - sign * i);
        let before = drop_at(from.saturating_sub(length));
        let after = drop_at(from + 2 * length - 1);
        let steep = CLIPPED_FLANK * quantum(current);
        if before.min(after).max(drop_at(from - 1)) > steep && before > steep {
            return Err(Rejection::Clipped {
                channel: Channel::Current,
                limit: sign * limit,
                at_s: from as f64 * interval_s,
            });
        }
    }
    Ok(())
}

/// Rejects a trace without one complete movement driven by a measurable current.
pub(super) fn course(
    movement: &Movement,
    (current, position): (&[f64], &[f64]),
    interval_s: f64,
    settings: &Settings,
    noise_mm: f64,
    scratch: &mut Vec<f64>,
) -> Result<(), Rejection> {
    let at = |k: usize| k as f64 * interval_s;
    let travel_mm = movement.travel_mm;
    let furthest = peak(position, position[0]);
    let noise_mm = whole_noise(movement, position, noise_mm, scratch);
    let noisy = Rejection::Noisy {
        channel: Channel::Position,
        measured: noise_mm,
        expected: POSITION_NOISE_FACTOR * settings.position_noise_mm,
    };
    let least =
        LEAST_TRAVEL_MM.max(LEAST_TRAVEL_SHARE * settings.stroke_mm.unwrap_or(0.0)).max(LEAST_TRAVEL_SIGMAS * noise_mm);
    if travel_mm.max(furthest) < least {
        return Err(if travel_mm > LARGEST_BEND_MM.max(MEDIAN_SIGMAS * noise_mm) {
            noisy
        } else {
            Rejection::NoMovement
        });
    }
    // Without quiet samples the noise follows from differences, which include the ripple of the supply.
    let quiet = movement.current;
    let noise_a = if quiet.samples >= MIN_QUIET { quiet.sd } else { first_difference_noise(current, scratch) };
    if movement.motor_off.is_none() || movement.peak_a < LEAST_CURRENT_SIGMAS * noise_a {
        return Err(Rejection::NoCurrent { travel_mm });
    }
    let start = movement.start();
    let moved_mm = peak(&position[..=start], position[0]);
    if moved_mm > WRONG_WAY_SHARE * travel_mm.max(furthest) + WRONG_WAY_SIGMAS * noise_mm {
        return Err(Rejection::MovedBeforeCurrent { moved_mm });
    }
    jumps(movement, position, interval_s, noise_mm)?;
    let back_mm = backwards(movement, &position[..=movement.motor_off.unwrap_or(position.len() - 1)]);
    if back_mm > WRONG_WAY_SHARE * travel_mm + WRONG_WAY_SIGMAS * noise_mm {
        return Err(Rejection::MovedBackwards { back_mm });
    }
    if let Some(stroke_mm) = settings.stroke_mm {
        if travel_mm + noise_mm < COMPLETE_SHARE * stroke_mm {
            return Err(Rejection::Incomplete { travel_mm, stroke_mm });
        }
        if travel_mm - noise_mm > TOO_LONG_SHARE * stroke_mm {
            return Err(Rejection::TravelTooLong { travel_mm, stroke_mm });
        }
    } else if let Some(off) = movement.motor_off {
        let stalled_s = at(off.saturating_sub(movement.arrived));
        if stalled_s > LONGEST_STALL_S {
            let stalled = &position[movement.arrived.midpoint(off)..=off];
            if movement.position.sd > 0.0 && stalled.iter().all(|x| x.to_bits() == stalled[0].to_bits()) {
                let at_s = at(movement.arrived);
                return Err(Rejection::Stuck {
                    channel: Channel::Position,
                    value: stalled[0],
                    at_s,
                    stuck_s: stalled_s,
                });
            }
            if noise_mm > LARGEST_POSITION_SHARE * travel_mm && moves_until(off, movement, position, noise_mm) {
                return Err(noisy);
            }
            return Err(Rejection::Obstructed { position_mm: movement.end_mm, stalled_s });
        }
    }
    let duration_s = at(movement.near_end.saturating_sub(start));
    if duration_s > LONGEST_MOVEMENT_S {
        return Err(Rejection::TooSlow { duration_s, longest_s: LONGEST_MOVEMENT_S, rate_hz: 1.0 / interval_s });
    }
    let first_a = current[0] - movement.current.mean;
    if movement.quiet < MIN_QUIET && first_a.abs() > LATE_START_SHARE * movement.peak_a {
        return Err(Rejection::StartMissing { current_a: first_a });
    }
    Ok(())
}

/// The noise of the position, also if it is hum or other noise that is not white: then the values at rest scatter more
/// than their differences show. A toe that was displaced there is not noise.
fn whole_noise(movement: &Movement, position: &[f64], noise_mm: f64, scratch: &mut Vec<f64>) -> f64 {
    let Level { mean: centre, sd, samples, .. } = movement.position;
    let quarter = samples / 4;
    if quarter < MIN_QUIET || sd < 2.0 * noise_mm {
        return noise_mm;
    }
    let of = |from: usize| mean(position[from..from + quarter].iter().copied());
    if (of(samples - quarter) - of(0)).abs() > DISPLACED_SIGMAS * sd {
        return noise_mm;
    }
    scratch.clear();
    scratch.extend(position[..samples].iter().map(|x| (x - centre).abs()));
    noise_mm.max(SD_PER_MEDIAN * median_of_magnitudes(scratch))
}

/// Whether the toe still moves before the end of the motor: in a noisy position the first sample near the end of the
/// travel is much too early. Compares the means of the second and the last third of the time since then.
fn moves_until(off: usize, movement: &Movement, position: &[f64], noise_mm: f64) -> bool {
    let third = off.saturating_sub(movement.near_end) / 3;
    if third == 0 {
        return false;
    }
    let of = |from: usize| mean(position[from..from + third].iter().copied());
    let moved = movement.sign * (of(off - third) - of(off - 2 * third));
    let usual = movement.travel_mm * third as f64 / off.saturating_sub(movement.start()).max(1) as f64;
    moved > (LEAST_SPEED_SHARE * usual).max(MOVED_SIGMAS * noise_mm * (2.0 / third as f64).sqrt())
}

/// Rejects a toe that already moves at the start of the motor: three consecutive positions are displaced. (Noise can
/// displace one of them.)
pub(super) fn early(movement: &Movement, position: &[f64]) -> Result<(), Rejection> {
    if movement.quiet <= 2 * MIN_QUIET {
        return Ok(());
    }
    let start = movement.start();
    let moved_mm = (mean(position[start - 2..=start].iter().copied()) - movement.position.mean).abs();
    let noise_mm = (EARLY_SIGMAS * movement.position.sd).max(movement.position.quantum);
    if moved_mm > noise_mm.max(LEAST_SLIP * movement.travel_mm) {
        return Err(Rejection::MovedBeforeCurrent { moved_mm });
    }
    Ok(())
}

/// Largest noise for the estimation, as share of the peak current and of the travel.
const LARGEST_NOISE_SHARE: f64 = 0.025;
const LARGEST_POSITION_SHARE: f64 = 0.005;

/// Rejects noise that is too large compared with the signals.
pub(super) fn resolved(movement: &Movement) -> Result<(), Rejection> {
    for (channel, level, expected) in [
        (Channel::Current, movement.current, LARGEST_NOISE_SHARE * movement.peak_a),
        (Channel::Position, movement.position, LARGEST_POSITION_SHARE * movement.travel_mm),
    ] {
        if level.samples >= MIN_QUIET && level.sd > expected {
            return Err(Rejection::Noisy { channel, measured: level.sd, expected });
        }
    }
    Ok(())
}

/// Rejects noise that is too large compared with the configured sensors.
pub(super) fn noise(movement: &Movement, settings: &Settings) -> Result<(), Rejection> {
    for (channel, level, expected, factor) in [
        (Channel::Current, movement.current, settings.current_noise_a, CURRENT_NOISE_FACTOR),
        (Channel::Position, movement.position, settings.position_noise_mm, POSITION_NOISE_FACTOR),
    ] {
        if level.samples >= MIN_QUIET && level.sd > factor * expected {
            return Err(Rejection::Noisy { channel, measured: level.sd, expected });
        }
    }
    Ok(())
}

/// Rejects a channel that repeats a value during the movement for longer than the converter step explains.
pub(super) fn sticking(
    movement: &Movement,
    channel: Channel,
    values: &[f64],
    interval_s: f64,
    factor: usize,
) -> Result<(), Rejection> {
    let to = (movement.near_end * factor).min(values.len());
    let start = (movement.start() * factor).min(to);
    let step = quantum(&values[start..to]);
    let noisy = movement.level(channel).sd > 0.5 * step && step > 0.0;
    let mean_step = movement.travel_mm / (to - start).max(1) as f64;
    // Without noise the values before the start are equal.
    let from = if noisy { 0 } else { start };
    let values = &values[from..to];
    let longest = match channel {
        _ if noisy => REPEATED_SAMPLES,
        Channel::Position => REPEATED_SAMPLES.max(REPEATED_STEPS * step / mean_step).max(REPEATED_S / interval_s),
        Channel::Current => REPEATED_SAMPLES.max(LEVEL_CURRENT_SHARE * values.len() as f64),
    };
    // A longer stretch covers both ends of one of these parts.
    let is_equal = |part: &[f64]| part[0].to_bits() == part[part.len() - 1].to_bits();
    if !values.chunks_exact(REPEATED_PART).any(is_equal) {
        return Ok(());
    }
    let mut at = 0;
    for stretch in values.chunk_by(|a, b| a.to_bits() == b.to_bits()) {
        if stretch.len() as f64 > longest {
            let (at_s, stuck_s) = ((from + at) as f64 * interval_s, stretch.len() as f64 * interval_s);
            return Err(Rejection::Stuck { channel, value: stretch[0], at_s, stuck_s });
        }
        at += stretch.len();
    }
    Ok(())
}

/// Least height of a spike: as share of the peak current and of the travel, and in standard deviations of the noise.
const SPIKE_CURRENT_SHARE: f64 = 0.02;
const SPIKE_TRAVEL_SHARE: f64 = 0.002;
const SPIKE_SIGMAS: f64 = 12.0;
/// Factor on these shares at a low rate with a filter, where vibrations of the machine look like single values.
const SPIKE_FILTERED_FACTOR: f64 = 10.0;
/// Least height of a spike as share of the signal's change between samples: on a steep flank jitter looks like a spike.
const SPIKE_SLOPE_SHARE: f64 = 0.4;
/// Tolerance of a spike's shape in the second differences: minus one half of the height at the neighbours, and nothing
/// two samples away.
const SPIKE_BESIDE_SHARE: f64 = 0.3;
/// Number of spikes from which they count as a ripple that the sampling hardly resolves.
const RIPPLE_SPIKES: usize = 6;

/// Rejects single values far from their neighbours: the second difference is large there, half as large with the
/// opposite sign at the neighbours, and small two samples away (unlike the ringing of an anti-alias filter after the
/// inrush). A few are corrupt values; many are a ripple that the sampling hardly resolves.
pub(super) fn spikes(
    movement: &Movement,
    channel: Channel,
    values: &[f64],
    interval_s: f64,
    filtered: bool,
) -> Result<(), Rejection> {
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
    // The usual trace bends nowhere that far.
    let is_straight = |[a, b, c]: &[f64; 3]| {
        let here = (b - 0.5 * (a + c)).abs();
        (here <= threshold) | (here <= SPIKE_SLOPE_SHARE * (c - a).abs())
    };
    if last <= 3 || every(values[2..=last].array_windows().map(is_straight)) {
        return Ok(());
    }
    let mut spikes = (3..last).filter(|&k| {
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
            Err(Rejection::Spike { channel, height: bend(at), at_s: at as f64 * interval_s })
        }
        _ => Ok(()),
    }
}

/// Least step within the inrush, as share of the peak and in standard deviations; means would hide it in the flank.
const INRUSH_STEP_SHARE: f64 = 0.18;
const INRUSH_STEP_SIGMAS: f64 = 12.0;
/// Samples after the start of the motor that are checked for such a step.
const INRUSH_STEP_SAMPLES: std::ops::Range<usize> = 3..19;
/// Least share of a step in means of half the length: 1 for a step, an eighth for a smooth signal.
const SHORT_MEAN_SHARE: f64 = 0.6;
const SHORT_MEAN_SIGMAS: f64 = 5.0;
/// Length of the mean on each side of a step \[s\].
const STEP_S: f64 = 0.008;
/// Least step in standard deviations of its noise, for several thousand places on a smooth signal.
const STEP_SIGNIFICANCE: f64 = 6.5;
/// Duration of the oscillation of the inrush \[s\].
const INRUSH_S: f64 = 0.15;
/// Least step of the current, as share of its peak; rails and friction cause smaller ones.
const LEAST_STEP: f64 = 0.006;
/// Least step of the position, as share of the travel.
const LEAST_SLIP: f64 = 5e-4;

/// Rejects a lasting step between two samples: inductance and inertia prevent it in current and position, so it is a
/// changed gain, a shifted offset or lost samples. Means over 8 and over 4 ms, with the trend removed, show the same
/// height only for a step; for a smooth signal the shorter means show an eighth. Many steps are a ripple that the
/// sampling hardly resolves.
pub(super) fn steps(
    movement: &Movement,
    channel: Channel,
    values: &[f64],
    (interval_s, noise): (f64, f64),
    sums: &mut Vec<f64>,
) -> Result<(), Rejection> {
    // A step at rest increases the noise at rest, but not that of differences.
    let rest = movement.level(channel);
    let sd = if rest.samples < MIN_QUIET { noise } else { rest.sd.min(noise) }.max(rest.quantum);
    let start = movement.start();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time over an interval")]
    let wide = 2 * ((0.5 * STEP_S / interval_s) as usize).clamp(2, 16);
    if channel == Channel::Current {
        let far = |k: &usize| {
            let [a, b, c, d] = [values[k - 1], values[*k], values[k + 1], values[k + 2]];
            (0.5 * (a - d) + 1.5 * (c - b)).abs() > (INRUSH_STEP_SIGMAS * sd).max(INRUSH_STEP_SHARE * movement.peak_a)
        };
        let inrush =
            start + INRUSH_STEP_SAMPLES.start..(start + INRUSH_STEP_SAMPLES.end).min(values.len().saturating_sub(2));
        let mut found = inrush.filter(far);
        // One step shows at neighbouring places too; more are a switching supply.
        if let Some(at) = found.next().filter(|_| found.count() < 3) {
            return Err(Rejection::CurrentJump { jump_a: values[at + 1] - values[at], at_s: at as f64 * interval_s });
        }
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
    // The variance of a step is 5 / width of that of a sample.
    let [long, short] = [wide, wide / 2].map(|width| sd * (5.0 / width as f64).sqrt());
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time over an interval")]
    let settled = start + (INRUSH_S / interval_s) as usize + wide;
    let (clear, least) = match channel {
        // Inductance and back-EMF oscillate faster than these means.
        Channel::Current => (start.saturating_sub(2 * wide)..settled, LEAST_STEP * movement.peak_a),
        // The toe starts with a jerk.
        Channel::Position => (start..start + 4 * wide, LEAST_SLIP * movement.travel_mm),
    };
    let last = (movement.near_end + 1).min(values.len()).saturating_sub(2 * wide);
    let threshold = (STEP_SIGNIFICANCE * long).max(least);
    // The usual trace has no step on either side of the excluded part.
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
    // One step shows at a few neighbouring places.
    if found.count() > 5 * wide {
        return Ok(());
    }
    let (size, at_s) = (step(at, wide), at as f64 * interval_s);
    Err(match channel {
        Channel::Current => Rejection::CurrentJump { jump_a: size, at_s },
        Channel::Position => Rejection::PositionJump { jump_mm: size.abs(), at_s },
    })
}

/// Shortest stretch for a noise comparison \[samples\].
const NOISE_SAMPLES: usize = 64;
/// Least noise that hides the vibrations of the machine, as share of the configured noise.
const LEAST_NOISE: f64 = 0.5;
/// Standard normal quantile for one false rejection in 3 million stretches.
const NOISE_QUANTILE: f64 = 5.0;
/// Least noise for a comparison, in steps of the converter; below it, rounding determines the differences.
const NOISE_QUANTA: f64 = 8.0;
/// Ratio of the noise at rest to that of the whole trace: more is a disturbance at rest, less is noise from the
/// machine.
const REST_NOISE: std::ops::Range<f64> = 0.6..1.5;

/// Rejects a stretch of the current with other noise than the rest, which shows another gain, if the noise elsewhere is
/// that of the sensor. (With a ripple of the supply, noise of a commutator, a coarse converter, or a sensor so good
/// that vibrations are visible, there is no check.)
pub(super) fn noise_level(
    movement: &Movement,
    current: &[f64],
    interval_s: f64,
    settings: &Settings,
    scratch: &mut Vec<f64>,
) -> Result<(), Rejection> {
    let quiet = &current[..movement.quiet];
    if quiet.len() < NOISE_SAMPLES {
        return Ok(());
    }
    let last = (movement.near_end + 1).min(current.len());
    let usual = second_difference_noise(&current[..last], scratch);
    if usual < (NOISE_QUANTA * movement.current.quantum).max(LEAST_NOISE * settings.current_noise_a) {
        return Ok(());
    }
    let at_rest = second_difference_noise(quiet, scratch);
    if at_rest > REST_NOISE.end * usual {
        return Err(Rejection::GainChanged { ratio: at_rest / usual });
    }
    // A disturbed stretch may cover most of one half.
    let [first, second] = [&quiet[..quiet.len() / 2], &quiet[quiet.len() / 2..]];
    let halves = second_difference_noise(first, scratch).max(second_difference_noise(second, scratch));
    if halves < REST_NOISE.start * usual {
        return Ok(());
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time over an interval")]
    let settled = movement.start() + (INRUSH_S / interval_s) as usize;
    scratch.clear();
    scratch.push(0.0);
    let (mut sum, square) = (0.0, 6.0 * usual * usual);
    for (k, w) in current[..last].windows(3).enumerate() {
        if (settled..last).contains(&k) || k + 3 < movement.start() {
            sum += (w[2] - 2.0 * w[1] + w[0]).powi(2) / square;
            scratch.push(sum);
        }
    }
    let mut width = NOISE_SAMPLES;
    while width < scratch.len() {
        // Neighbouring second differences share samples, so 35/18 of them count as one. (Wilson, Hilferty)
        let spread = 2.0 / 9.0 * (35.0 / 18.0) / width as f64;
        let limit = |sign: f64| (1.0 - spread + sign * NOISE_QUANTILE * spread.sqrt()).powi(3);
        let (low, high) = (limit(-1.0), limit(1.0));
        for from in (0..scratch.len() - width).step_by(width / 4) {
            let ratio = (scratch[from + width] - scratch[from]) / width as f64;
            // In motion vibrations of the machine may add to the noise.
            let at_rest = from + width + 3 < movement.start();
            if ratio < low || (at_rest && ratio > high) {
                return Err(Rejection::GainChanged { ratio: ratio.sqrt() });
            }
        }
        width *= 2;
    }
    Ok(())
}

/// Rejects a movement without inrush: a starting motor takes more current than a running one.
pub(super) fn inrush(movement: &Movement, current: &[f64], scratch: &mut Vec<f64>) -> Result<(), Rejection> {
    let (start, end) = (movement.start(), movement.near_end.max(movement.start() + 1));
    let early = start + ((end - start) / 5).max(1);
    let level = |i: &f64| (i - movement.current.mean).abs();
    let peak_a = peak(&current[start..early], movement.current.mean);
    scratch.clear();
    scratch.extend(current[early..end].iter().map(level));
    let running_a = median_of_magnitudes(scratch);
    if peak_a < INRUSH_FACTOR * running_a { Err(Rejection::NoInrush { peak_a, running_a }) } else { Ok(()) }
}

/// Least height of the first crest as share of the peak; the crest lasts while the current is above this share of it.
const CREST_SHARE: f64 = 0.9;
const CREST_FLATNESS: f64 = 0.97;

/// Samples from the last quiet one to the end of the first crest of the current.
pub(super) fn rise_samples(movement: &Movement, current: &[f64]) -> usize {
    let start = movement.start();
    let level = |k: usize| (current[k] - movement.current.mean).abs();
    let falls = |k: usize| k + 1 == current.len() || level(k + 1) <= level(k);
    let Some(crest) = (start..current.len()).find(|&k| level(k) >= CREST_SHARE * movement.peak_a && falls(k)) else {
        return 0;
    };
    let flat = (crest + 1..current.len()).take_while(|&k| level(k) >= CREST_FLATNESS * level(crest)).count();
    crest + flat - start + 1
}

/// Largest step of the position between two samples: in mean steps of the movement, in standard deviations of the
/// noise, and in steps of the converter (at most 0.5 mm each).
const JUMP_MEAN_STEPS: f64 = 5.0;
const JUMP_SIGMAS: f64 = 10.0;
const JUMP_QUANTA: f64 = 3.0;
const LARGEST_QUANTUM_MM: f64 = 0.5;

/// Rejects a step between two samples that the speed of the machine does not explain.
fn jumps(movement: &Movement, position: &[f64], interval_s: f64, noise_mm: f64) -> Result<(), Rejection> {
    let span = movement.arrived.saturating_sub(movement.start()).max(1);
    let mean_step = movement.travel_mm / span as f64;
    let allowed = JUMP_MEAN_STEPS * mean_step
        + JUMP_SIGMAS * noise_mm
        + JUMP_QUANTA * movement.position.quantum.min(LARGEST_QUANTUM_MM);
    let steps = position.array_windows().map(|[before, after]| (after - before).abs());
    if every(steps.clone().map(|step| step <= allowed)) {
        return Ok(());
    }
    match steps.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)) {
        Some((at, jump_mm)) if jump_mm > allowed => {
            Err(Rejection::PositionJump { jump_mm, at_s: at as f64 * interval_s })
        }
        _ => Ok(()),
    }
}

/// Largest distance back from the furthest position so far.
fn backwards(movement: &Movement, position: &[f64]) -> f64 {
    let sign = if movement.sign == 0.0 { 1.0 } else { movement.sign };
    let (mut furthest, mut worst) = (f64::NEG_INFINITY, 0.0);
    for x in position {
        let x = sign * x;
        furthest = if x > furthest { x } else { furthest };
        worst = if furthest - x > worst { furthest - x } else { worst };
    }
    worst
}

/// Standard deviation over median magnitude of a normal variable.
const SD_PER_MEDIAN: f64 = 1.4826;

/// Standard deviation of white noise on a smooth signal, from the median of its second differences.
pub(super) fn second_difference_noise(values: &[f64], scratch: &mut Vec<f64>) -> f64 {
    scratch.clear();
    scratch.extend(values.array_windows().map(|[a, b, c]| (c - 2.0 * b + a).abs()));
    SD_PER_MEDIAN * median_of_magnitudes(scratch) / 6.0_f64.sqrt()
}

/// The same from first differences, for a mostly constant signal.
fn first_difference_noise(values: &[f64], scratch: &mut Vec<f64>) -> f64 {
    scratch.clear();
    scratch.extend(values.windows(2).map(|w| (w[1] - w[0]).abs()));
    SD_PER_MEDIAN * median_of_magnitudes(scratch) / 2.0_f64.sqrt()
}
