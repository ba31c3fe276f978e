//! Checks of the noise of the channels.

use super::{
    movement::{INRUSH_S, LARGEST_POSITION_SHARE, MIN_QUIET, Movement},
    samples::{samples_in, second_difference_noise},
};
use crate::{
    estimate::{lanes::sum, rejection::Rejection, settings::Settings},
    throw::Channel,
};

/// Largest ratio of measured to configured noise of a healthy sensor and its wiring. Noise of the current affects the
/// coefficients ten times as much as noise of the position.
const CURRENT_NOISE_FACTOR: f64 = 3.5;
const POSITION_NOISE_FACTOR: f64 = 25.0;

/// Largest noise of a current that still gives coefficients, as share of the peak.
const LARGEST_NOISE_SHARE: f64 = 0.025;

/// Rejects noise that is too large compared with the signals for any estimate.
pub(crate) fn resolved(movement: &Movement<'_>) -> Result<(), Rejection> {
    let largest_a = LARGEST_NOISE_SHARE * movement.peak_a;
    within(movement, [(largest_a, None), (LARGEST_POSITION_SHARE * movement.travel_mm, None)])
}

/// Rejects noise that is too large compared with that of the configured sensors. The throw may still have an estimate.
pub(crate) fn plausible(movement: &Movement<'_>, settings: &Settings) -> Result<(), Rejection> {
    let Settings { current_noise_a, position_noise_mm, .. } = *settings;
    let current = (CURRENT_NOISE_FACTOR * current_noise_a, Some(current_noise_a));
    within(movement, [current, (POSITION_NOISE_FACTOR * position_noise_mm, Some(position_noise_mm))])
}

/// Rejects a channel whose noise at rest has a standard deviation above a limit. Each limit \[A, mm\] has the configured
/// noise from which it is.
fn within(movement: &Movement<'_>, limits: [(f64, Option<f64>); 2]) -> Result<(), Rejection> {
    for (channel, (largest, expected)) in [Channel::Current, Channel::Position].into_iter().zip(limits) {
        let level = movement.level(channel);
        if level.samples >= MIN_QUIET && level.sd > largest {
            return Err(Rejection::Noisy { channel, measured: level.sd, expected });
        }
    }
    Ok(())
}

/// Second differences are summed in groups of this many, and stretches of this many groups or more are compared.
const GROUP: usize = 16;
const LEAST_GROUPS: usize = 4;
/// Least noise that hides the vibrations of the machine, as share of the configured noise.
const LEAST_NOISE: f64 = 0.5;
/// Allowed deviation of a stretch \[standard deviations\]: one false rejection in 3 million stretches.
const NOISE_QUANTILE: f64 = 5.0;
/// Least noise for a comparison, in steps of the converter. With less noise, rounding determines the differences.
const NOISE_QUANTA: f64 = 8.0;
/// Usual ratio of the noise at rest to that of the whole trace. A larger ratio is a disturbance at rest; with a smaller
/// one the machine itself makes noise in motion.
const REST_NOISE: std::ops::Range<f64> = 0.6..1.5;

/// Rejects a current whose noise is different in one stretch, as there its gain was different. `usual` is the noise of
/// the current until the end of the travel. The check needs a noise that comes from the sensor. There is no check if the
/// supply ripples, the commutator makes noise, the converter is coarse, or the sensor is so good that it shows the
/// vibrations of the machine.
pub(crate) fn noise_level(
    movement: &Movement<'_>,
    usual: f64,
    settings: &Settings,
    scratch: &mut Vec<f64>,
) -> Result<(), Rejection> {
    let current = movement.current_a;
    let quiet = &current[..movement.quiet];
    if quiet.len() < LEAST_GROUPS * GROUP {
        return Ok(());
    }
    let last = movement.near_end + 1;
    if usual < (NOISE_QUANTA * movement.current.quantum).max(LEAST_NOISE * settings.current_noise_a) {
        return Ok(());
    }
    let at_rest = second_difference_noise(quiet, scratch);
    if at_rest > REST_NOISE.end * usual {
        return Err(Rejection::GainChanged { ratio: at_rest / usual });
    }
    // The noisier half counts, as a smoothed stretch may cover most of the other half.
    let [first, second] = [&quiet[..quiet.len() / 2], &quiet[quiet.len() / 2..]];
    let halves = second_difference_noise(first, scratch).max(second_difference_noise(second, scratch));
    if halves < REST_NOISE.start * usual {
        return Ok(());
    }
    let settled = movement.start() + samples_in(INRUSH_S, movement.interval_s);
    let square = (6.0 * usual * usual).recip();
    scratch.clear();
    for part in [&current[..movement.start().saturating_sub(1)], current[..last].get(settled..).unwrap_or_default()] {
        scratch.extend(part.array_windows().map(|[a, b, c]| (c - 2.0 * b + a).powi(2) * square));
    }
    // The sums of all groups before each group, in place of their squares.
    let groups = scratch.len() / GROUP;
    let mut before = 0.0;
    for group in 0..groups {
        let own = sum([&scratch[group * GROUP..][..GROUP]], |[square]| square);
        scratch[group] = before;
        before += own;
    }
    scratch.truncate(groups);
    scratch.push(before);
    let mut width = LEAST_GROUPS;
    while width < scratch.len() {
        let samples = (width * GROUP) as f64;
        // Limits of a mean of squares by Wilson and Hilferty. Neighbouring second differences share samples, so 35/18
        // of them count as one.
        let spread = 2.0 / 9.0 * (35.0 / 18.0) / samples;
        let limit = |sign: f64| (1.0 - spread + sign * NOISE_QUANTILE * spread.sqrt()).powi(3);
        let (low, high) = (limit(-1.0), limit(1.0));
        for from in (0..scratch.len() - width).step_by(width / 4) {
            let ratio = (scratch[from + width] - scratch[from]) / samples;
            // In motion, vibrations of the machine may add to the noise.
            let at_rest = (from + width) * GROUP + 3 < movement.start();
            if ratio < low || (at_rest && ratio > high) {
                return Err(Rejection::GainChanged { ratio: ratio.sqrt() });
            }
        }
        width *= 2;
    }
    Ok(())
}
