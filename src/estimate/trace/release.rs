//! The release: the moment from which the spring of the rails acts.
//!
//! Before the motor starts, a brake or dry friction holds the rails against their spring: the output y is 0 although
//! the unstressed position `y_eq` is not. So the term a0 `y_eq` of equation (12) acts from the start of the motor. An
//! error of 1 ms in this moment changes all three coefficients by 0.8 % in the direction in which the spring drives the
//! throw.
//!
//! In an unfiltered current the moment is the foot of the rise, extrapolated from the first samples. An anti-alias
//! filter delays and rounds the foot. Then a rectangular pulse that passed the same filter is fitted to the rise, and
//! the moment is the start of the best pulse.
//!
//! The foot is also a kink: the slope of the current i jumps by m, from 0 to supply voltage over inductance. Trapezoids
//! between samples miss charge of the curve after the kink, and add charge in the interval with the kink, in total
//! (Euler, Maclaurin)
//!
//! ```text
//! ∫ i dt - Σ trapezoids = m h² / 2 (1/6 - f (1 - f))
//! ```
//!
//! with the sampling interval h and the place f of the kink in its interval, from 0 to 1. This is 0.5 % of the inrush
//! at 1 kHz and 2 % at 500 Hz, and would change the three coefficients as much.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

use super::{
    movement::{MIN_QUIET, Movement, start_of_motor},
    samples::{mean, samples_in},
};
use crate::estimate::rejection::Rejection;

/// Widths of the fitted pulse \[s\], for motors of low to high inductance.
const PULSE_WIDTHS_S: [f64; 5] = [0.005, 0.01, 0.02, 0.04, 0.08];
/// Number of samples of an unfiltered rise from which its foot is extrapolated.
const RISE_SAMPLES: usize = 6;
/// Largest departure of the rise from that of a linear armature: in standard deviations of the noise, or as share of
/// the peak if that is larger. Healthy traces have less than 5 standard deviations, and less than 3 % of the peak with
/// a rectified supply. Five lost samples cause 10 %, jitter of 0.3 ms causes 1 to 20 %.
const ROUGH_RISE_SIGMAS: f64 = 8.0;
const ROUGH_RISE_SHARE: f64 = 0.03;
/// Part of the departure of the rise that noise explains \[standard deviations\], and that does not count.
const RISE_NOISE_SIGMAS: f64 = 4.0;
/// Longest time from the start of the motor to the crest of the inrush \[s\] that the fit of a pulse uses: it bounds the
/// work for a trace whose current rises until its end.
const LONGEST_RISE_S: f64 = 0.5;
/// Number of equal steps between the first and the last start of a pulse that the fit tries.
const STEPS: u32 = 100;
/// Delay of a fourth-order Butterworth low-pass at 0 Hz, in units of `1/ω_c`: 2 (sin π/8 + sin 3π/8).
const FILTER_DELAY: f64 = 2.613_125_929_752_753;

/// The moment of release \[s\] in a trace before its decimation. If the current is that of a `linear` armature without
/// filter, adds the missing charge at the foot to it. `None` if the motor was never off or never on.
pub(crate) fn at_full_rate(current: &mut [f64], interval_s: f64, linear: bool, scratch: &mut Vec<f64>) -> Option<f64> {
    let foot = start_of_motor(current, interval_s, scratch).filter(|foot| *foot > 0)?;
    let offset = mean(&current[..foot]);
    let Some(onset) = onset(current, offset, foot) else { return Some(foot as f64 * interval_s) };
    if linear {
        onset.complete(current, foot);
    }
    Some((foot as f64 + onset.at) * interval_s)
}

/// The moment of release \[s\] from the first sample of `current` \[A\]; `foot` is the last sample before the start of
/// the motor.
pub(crate) fn time(current: &[f64], offset: f64, foot: usize, interval_s: f64, filter_hz: Option<f64>) -> f64 {
    match filter_hz {
        None => onset(current, offset, foot).map_or(foot as f64, |onset| foot as f64 + onset.at) * interval_s,
        Some(hz) => pulse_start(current, offset, foot, interval_s, hz).clamp(0.0, (foot + 3) as f64 * interval_s),
    }
}

/// Adds the missing charge at the foot to an unfiltered `input`, whose offset is removed. Returns the departure of its
/// rise from that of an armature, without that from noise, as share of the peak, and the reason why the start of the
/// throw is unusable, if it is.
pub(crate) fn complete_onset(input: &mut [f64], movement: &Movement<'_>, foot: usize) -> (f64, Option<Rejection>) {
    let noise_a = movement.current.sd;
    let Some(onset) = onset(input, 0.0, foot) else {
        let is_late = movement.quiet < MIN_QUIET || input[foot + 1] > 0.5 * movement.peak_a;
        return (0.0, is_late.then_some(Rejection::StartMissing { current_a: input[foot + 1] }));
    };
    if let Some(missing) = onset.missing() {
        return (0.0, Some(Rejection::OnsetMissing { missing_s: missing * movement.interval_s }));
    }
    if onset.roughness > (ROUGH_RISE_SIGMAS * noise_a).max(ROUGH_RISE_SHARE * movement.peak_a) {
        return (0.0, Some(Rejection::RoughRise { departure_a: onset.roughness }));
    }
    onset.complete(input, foot);
    ((onset.roughness - RISE_NOISE_SIGMAS * noise_a).max(0.0) / movement.peak_a, None)
}

/// The onset of the current: the kink at which its rise begins, between two samples.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Onset {
    /// Place of the kink \[samples after the last quiet sample\].
    at: f64,
    /// Slope of the current after the kink \[A per sample\].
    slope: f64,
    /// Root mean square departure of the first samples from a linear system of second order \[A\].
    roughness: f64,
}

impl Onset {
    /// Number of missing samples if the onset is about one sample or more before the foot; else `None`.
    fn missing(&self) -> Option<f64> {
        (self.at < -0.9).then_some(-self.at)
    }

    /// Adds the charge that trapezoids miss to the sample after the foot.
    fn complete(&self, current: &mut [f64], foot: usize) {
        let part = self.at - self.at.floor();
        current[foot + 1] += 0.5 * self.slope * (1.0 / 6.0 - part * (1.0 - part));
    }
}

/// The onset of an unfiltered rise. A motor's current responds to a voltage step as a linear system of second order
/// (inductance and back-EMF), so its samples follow `i_k` = α `i_{k-1}` + β `i_{k-2}`. This recursion is fitted to the
/// first samples and gives the curve before them. `None` if this curve does not cross zero near the foot, with a slope.
fn onset(current: &[f64], offset: f64, foot: usize) -> Option<Onset> {
    let rise = current.get(foot + 1..foot + 1 + RISE_SAMPLES)?;
    let (mut square, mut both, mut earlier, mut ahead, mut behind) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let threes = || rise.array_windows().map(|three| three.map(|i| i - offset));
    for [before, last, next] in threes() {
        square += last * last;
        both += last * before;
        earlier += before * before;
        ahead += next * last;
        behind += next * before;
    }
    let determinant = square * earlier - both * both;
    let alpha = (ahead * earlier - behind * both) / determinant;
    let beta = (behind * square - ahead * both) / determinant;
    let [first, second] = [rise[0] - offset, rise[1] - offset];
    let at_foot = (second - alpha * first) / beta;
    let before = (first - alpha * at_foot) / beta;
    // The cubic through the samples at -1, 0, 1 and 2 (Newton's form); its zero by Newton's iteration.
    let (d1, d2, d3) = (
        at_foot - before,
        0.5 * (first - 2.0 * at_foot + before),
        (second - 3.0 * first + 3.0 * at_foot - before) / 6.0,
    );
    let value = |t: f64| before + (t + 1.0) * (d1 + t * (d2 + (t - 1.0) * d3));
    let slope = |t: f64| d1 + t * (d2 + (t - 1.0) * d3) + (t + 1.0) * (d2 + (2.0 * t - 1.0) * d3);
    let at = (0..4).fold(0.5, |t, _| t - value(t) / slope(t));
    let departure = |[before, last, next]: [f64; 3]| next - alpha * last - beta * before;
    let squares: f64 = threes().map(|three| departure(three).powi(2)).sum();
    // Four equations for two unknowns leave two degrees of freedom.
    let onset = Onset { at, slope: slope(at), roughness: (0.5 * squares).sqrt() };
    let steep = onset.slope * first > 0.5 * first * first;
    (steep && (-5.0..1.1).contains(&at) && onset.slope.abs() < 4.0 * (second.abs() + first.abs())).then_some(onset)
}

/// The start of the inrush \[s\] in a filtered current by least squares: the start of the filtered rectangular pulse
/// that fits the current best up to its crest.
fn pulse_start(current: &[f64], offset: f64, foot: usize, interval_s: f64, hz: f64) -> f64 {
    let level = |k: usize| current[k] - offset;
    let last = (foot + samples_in(LONGEST_RISE_S, interval_s)).min(current.len());
    let crest = (foot..last).max_by(|&a, &b| level(a).abs().total_cmp(&level(b).abs())).unwrap_or(foot);
    let samples = foot.saturating_sub(1)..(crest + 2).min(last);
    let misfit = |start: f64, width: f64| {
        let (mut both, mut pulse, mut power) = (0.0, 0.0, 0.0);
        for k in samples.clone() {
            let time_s = k as f64 * interval_s - start;
            let shape = step_response(time_s, hz) - step_response(time_s - width, hz);
            both += shape * level(k);
            pulse += shape * shape;
            power += level(k) * level(k);
        }
        if pulse > 0.0 { power - both * both / pulse } else { power }
    };
    let foot_s = foot as f64 * interval_s;
    let span = FILTER_DELAY / (TAU * hz) + 2.0 * interval_s;
    let candidates = PULSE_WIDTHS_S.into_iter().flat_map(|width| {
        (0..=STEPS).map(move |step| (foot_s + interval_s - span * f64::from(step) / f64::from(STEPS), width))
    });
    candidates
        .map(|(start, width)| (misfit(start, width), start))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or(foot_s, |best| best.1)
}

/// Fills `step` with a step from 0 to `height` at the time `released` \[s\], filtered, as mean over the interval after
/// each sample.
pub(crate) fn course(
    step: &mut Vec<f64>,
    (len, interval_s): (usize, f64),
    (released, height): (f64, f64),
    filter_hz: Option<f64>,
) {
    let settled_s = released + filter_hz.map_or(0.0, |hz| SETTLED / (TAU * hz));
    let settled = (samples_in(settled_s, interval_s) + 2).min(len);
    step.clear();
    step.extend((0..settled).map(|k| {
        let from = k as f64 * interval_s - released;
        height
            * match filter_hz {
                None => ((from + interval_s) / interval_s).clamp(0.0, 1.0),
                Some(hz) => 0.5 * (step_response(from, hz) + step_response(from + interval_s, hz)),
            }
    }));
    step.resize(len, height);
}

/// Time after a step at which the response of the filter is 1, in units of `1/ω_c`.
const SETTLED: f64 = 60.0;
/// sin(π/8) and cos(π/8).
const SIN: f64 = 0.382_683_432_365_089_8;
const COS: f64 = 0.923_879_532_511_286_7;

/// Response of a fourth-order Butterworth low-pass with the cut-off `hz` to a step at time 0. Its poles are
/// `ω_c` (-sin π/8 ± j cos π/8) and `ω_c` (-cos π/8 ± j sin π/8).
fn step_response(time_s: f64, hz: f64) -> f64 {
    let x = TAU * hz * time_s;
    if x <= 0.0 {
        return 0.0;
    }
    if x > SETTLED {
        return 1.0;
    }
    let slow = (-SIN * x).exp() * ((COS * x).cos() - (COS * x).sin());
    let fast = (-COS * x).exp() * ((SIN * x).cos() + (SIN * x).sin());
    1.0 + FRAC_1_SQRT_2 * slow - (1.0 + FRAC_1_SQRT_2) * fast
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A current that rises until the end of a long trace must not make the fit longer.
    #[test]
    fn the_pulse_is_fitted_to_the_first_half_second_after_the_start() {
        let (interval_s, foot) = (1e-3, 100);
        let rising: Vec<f64> = (0..5_000_u32).map(|k| 1e-3 * f64::from(k.saturating_sub(100))).collect();
        let start = |current: &[f64]| pulse_start(current, 0.0, foot, interval_s, 50.0);
        assert!((start(&rising) - start(&rising[..600])).abs() < 1e-12);
    }

    #[test]
    fn the_step_response_starts_at_zero_overshoots_and_settles() {
        assert!(step_response(1e-9, 10.0).abs() < 1e-6);
        assert!((step_response(10.0, 10.0) - 1.0).abs() < 1e-9);
        let most = (0..1000).map(|k| step_response(f64::from(k) * 1e-4, 10.0)).fold(0.0, f64::max);
        assert!((most - 1.108).abs() < 0.002, "{most}");
    }
}
