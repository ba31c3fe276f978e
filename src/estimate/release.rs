//! When the machine is let go.
//!
//! Before the motor is on, a brake or dry friction holds rails that lean against a spring: y = 0 although `y_eq` is not.
//! The term a0 `y_eq` of equation (12) acts from the moment in which the motor starts, so that moment matters: 1 ms too
//! early costs 0.8 % of all three coefficients in the direction in which the spring drives the throw.
//!
//! Unfiltered, the current shows it: the foot of its rise, extrapolated through the first samples. A filter that both
//! channels passed delays and rounds the foot; then the start is that of the rectangular pulse which, filtered alike,
//! fits the current's rise best.

use nalgebra::Complex;
use std::f64::consts::TAU;

use super::movement::start_of_motor;

/// Widths of inrush that are tried \[s\].
const PULSE_WIDTHS_S: [f64; 5] = [0.005, 0.01, 0.02, 0.04, 0.08];
/// Starts that are tried.
const STEPS: u32 = 100;
/// Delay of a fourth-order Butterworth low-pass at 0 Hz, in units of `1/ω_c`: 2 (sin π/8 + sin 3π/8).
const FILTER_DELAY: f64 = 2.613_125_929_752_753;

/// The moment of release \[s\] in a trace before its decimation; `None` when the motor was never off or never on.
pub(super) fn at_full_rate(current: &[f64], interval_s: f64, scratch: &mut Vec<f64>) -> Option<f64> {
    start_of_motor(current, scratch).filter(|foot| *foot > 0).map(|foot| foot as f64 * interval_s)
}

/// The moment of release \[s\] from the first sample of `current` \[A\], whose last quiet sample is `foot`.
pub(super) fn time(current: &[f64], offset: f64, foot: usize, interval_s: f64, filter_hz: Option<f64>) -> f64 {
    match filter_hz {
        None => (foot as f64 + foot_fraction(current, offset, foot)) * interval_s,
        Some(hz) => (pulse_start(current, offset, foot, interval_s, hz)).clamp(0.0, (foot + 3) as f64 * interval_s),
    }
}

/// Where between `foot` and the sample after it the rise begins: the rise's slope there is that of the next two
/// intervals, extrapolated.
fn foot_fraction(current: &[f64], offset: f64, foot: usize) -> f64 {
    let Some([first, second, third]) = current.get(foot + 1..foot + 4) else { return 0.0 };
    let slope = 2.0 * (second - first) - (third - second);
    let run = (first - offset) / slope;
    if run.is_finite() && run > 0.0 { 1.0 - run.min(1.0) } else { 0.0 }
}

/// The start of the inrush by least squares: up to its crest the filtered current is that of a rectangular pulse, of the
/// start and width that fit best.
fn pulse_start(current: &[f64], offset: f64, foot: usize, interval_s: f64, hz: f64) -> f64 {
    let level = |k: usize| current[k] - offset;
    let crest = (foot..current.len()).max_by(|&a, &b| level(a).abs().total_cmp(&level(b).abs())).unwrap_or(foot);
    let samples = foot.saturating_sub(1)..(crest + 2).min(current.len());
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

/// Mean over each sampling interval of the step at `released` \[s\], after the filter.
pub(super) fn course(step: &mut Vec<f64>, len: usize, released: f64, interval_s: f64, filter_hz: Option<f64>) {
    step.clear();
    step.extend((0..len).map(|k| {
        let from = k as f64 * interval_s - released;
        match filter_hz {
            None => ((from + interval_s) / interval_s).clamp(0.0, 1.0),
            Some(hz) => 0.5 * (step_response(from, hz) + step_response(from + interval_s, hz)),
        }
    }));
}

/// Step response of a fourth-order Butterworth low-pass.
fn step_response(time_s: f64, hz: f64) -> f64 {
    let x = TAU * hz * time_s;
    if x <= 0.0 {
        return 0.0;
    }
    if x > 60.0 {
        return 1.0;
    }
    // Poles e^{j 5π/8}, e^{j 7π/8} and their conjugates; residue of 1/(s Π (s - p)) at each.
    let angles = [5.0, 7.0].map(|eighths: f64| Complex::from_polar(1.0, eighths * TAU / 16.0));
    let poles = [angles[0], angles[0].conj(), angles[1], angles[1].conj()];
    let transient: f64 = [0, 2]
        .into_iter()
        .map(|i| {
            let others = (0..4).filter(|j| *j != i).fold(poles[i], |product, j| product * (poles[i] - poles[j]));
            2.0 * ((poles[i] * x).exp() / others).re
        })
        .sum();
    1.0 + transient
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_step_response_starts_at_zero_overshoots_and_settles() {
        assert!(step_response(1e-9, 10.0).abs() < 1e-6);
        assert!((step_response(10.0, 10.0) - 1.0).abs() < 1e-9);
        let most = (0..1000).map(|k| step_response(f64::from(k) * 1e-4, 10.0)).fold(0.0, f64::max);
        assert!((most - 1.108).abs() < 0.002, "{most}");
    }
}
