//! The start of a movement: its delay behind the current, and its acceleration per ampere.
//!
//! The later movement shows the ratios of the coefficients. With these the movement after a start without delay is
//! known except for b0: y = b0 F with F = ∬ (u - a1/b0 y' - a0/b0 (y - `y_eq`)). A delay δ and b0 are fitted by least
//! squares to the first part of the travel,
//!
//! ```text
//! y(t) = b0 F(t - δ)
//! ```
//!
//! A brake that releases late, play, lost motion or a late position signal delays the movement, or reduces its first
//! acceleration. Friction, motor and inertia hardly change δ. Dry friction and the elastic drive are not in the model,
//! so a healthy machine has a δ of some milliseconds of either sign. Only changes of δ show a fault.

use crate::estimate::trace::{samples::samples_in, window::Window};

/// Share of the travel that counts as the start: after 3 % the inrush is over.
const START_SHARE: f64 = 0.03;
/// Longest start, and longest delay \[s\].
const LONGEST_S: f64 = 0.6;
/// Time after the start for which F is computed as well, as a negative delay needs it \[s\].
const AHEAD_S: f64 = 0.03;
/// Largest change of the delay in a step of the iteration \[s\].
const STEP_S: f64 = 0.01;
/// Number of steps of the iteration.
const STEPS: usize = 60;
/// Change of the delay at which the iteration ends \[s\]: far below the scatter of 0.2 ms.
const CONVERGED_S: f64 = 2e-6;
/// Least number of samples of a usable start.
const LEAST_SAMPLES: usize = 8;

/// Computes F, the movement after a start without delay for b0 = 1, for `samples` from the foot of the current's rise
/// on.
pub(crate) fn free_movement(free: &mut Vec<f64>, window: &Window, samples: usize, [a1_per_b0, a0_per_b0]: [f64; 2]) {
    let Window { interval_s, foot, .. } = *window;
    let [input, output, shift] = [&window.input, &window.output, &window.shift].map(|signal| &signal[foot..]);
    free.clear();
    free.resize(samples, 0.0);
    let (mut charge, mut angle, mut before) = (0.0, 0.0, 0.0);
    for k in 1..samples {
        charge += 0.5 * (input[k - 1] + input[k]) * interval_s;
        angle += (0.5 * (output[k - 1] + output[k]) - shift[k - 1]) * interval_s;
        let balance = charge - (a1_per_b0 * output[k] + a0_per_b0 * angle);
        free[k] = free[k - 1] + 0.5 * (before + balance) * interval_s;
        before = balance;
    }
}

/// The start of a movement.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start {
    /// The delay of the movement behind the current, and its standard deviation from the noise \[s\].
    pub(crate) delay_s: f64,
    pub(crate) delay_sd_s: f64,
    /// b0 from the start alone \[rad s⁻² A⁻¹\].
    pub(crate) gain: f64,
}

/// Finds the start of a movement. `None` if the samples do not show it.
pub(crate) fn find(window: &Window, ratios: [f64; 2], free: &mut Vec<f64>) -> Option<Start> {
    let (output, interval_s) = (&window.output[window.foot..], window.interval_s);
    let travel = *output.last()?;
    let last = output.iter().take(samples_in(LONGEST_S, interval_s)).position(|y| *y > START_SHARE * travel)?;
    let end = (last + samples_in(AHEAD_S, interval_s).max(1) + 1).min(output.len());
    if last < LEAST_SAMPLES {
        return None;
    }
    free_movement(free, window, end, ratios);
    // The delay in samples.
    let (mut delay, step) = (0.0_f64, STEP_S / interval_s);
    let square: f64 = output[..=last].iter().map(|y| y * y).sum();
    for _ in 0..STEPS {
        let (mut own, mut both, mut slope, mut right, mut right_slope) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (k, y) in output[..=last].iter().enumerate() {
            let at = (k as f64 - delay).min((end - 1) as f64);
            if at <= 0.0 {
                continue;
            }
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "not negative, and below the length"
            )]
            let before = (at as usize).min(end - 2);
            let speed = free[before + 1] - free[before];
            let f = free[before] + (at - before as f64) * speed;
            own += f * f;
            both -= f * speed;
            slope += speed * speed;
            right += f * y;
            right_slope -= speed * y;
        }
        let determinant = own * slope - both * both;
        let gain = (right * slope - right_slope * both) / determinant;
        let change = (own * right_slope - both * right) / determinant / gain;
        if !(change.is_finite() && gain > 0.0) {
            return None;
        }
        delay += change.clamp(-step, step);
        if (change * interval_s).abs() < CONVERGED_S {
            let variance = window.output_noise.max((square - gain * right) / last as f64);
            let delay_sd_s = (variance * own / determinant).max(0.0).sqrt() / gain * interval_s;
            return Some(Start { delay_s: delay * interval_s, delay_sd_s, gain });
        }
    }
    None
}
