//! Check of the delay of the movement behind the current: a brake, play, lost motion or a time shift between the
//! channels causes one.
//!
//! The first 50 ms of a throw determine the common scale of b0, a1 and a0: later the machine runs at nearly constant
//! speed, which determines only the ratios a1/b0 and a0/b0. A delay of the toe of 1 ms changes the scale by about 2 %.
//! A delay δ and a relative error α of the scale cause different residuals of the measured output y and the modelled
//! x̂,
//!
//! ```text
//! y - x̂ = α ∂x̂/∂ln(scale) - δ x̂'
//! ```
//!
//! so both are found by least squares over the start.

use nalgebra::{Matrix2, Vector2};

use super::start::{LEAST_SAMPLES, START_SHARE};
use crate::estimate::{
    rejection::Rejection,
    sriv::filter::{Discrete, Hold, dot},
    trace::{samples::samples_in, window::Window},
};

/// Longest part of the movement that counts as its start \[s\], for a toe that hardly moves.
const LONGEST_START_S: f64 = 0.4;
/// Largest accepted delay \[s\]. A delay below this many of its standard deviations is accepted too. A soft drive
/// (5e6 N/m) delays the toe by 1 to 2 ms, play of 0.1 mm by 3.3 ms.
const LARGEST_DELAY_S: f64 = 3e-3;
const DELAY_SIGMAS: f64 = 5.0;
/// Relative change of the scale in the numerical derivative ∂x̂/∂ln(scale).
const SCALE_STEP: f64 = 0.02;

/// The delay of the movement \[s\], negative if the toe starts early; 0 if the start has too few samples to show it.
///
/// # Errors
/// When the delay is too large.
pub(crate) fn check(window: &Window, model: &[f64], parameters: [f64; 3]) -> Result<f64, Rejection> {
    match find(window, model, parameters) {
        Some((delay_s, sd_s)) if delay_s.abs() > LARGEST_DELAY_S.max(DELAY_SIGMAS * sd_s) => {
            Err(Rejection::LateStart { delay_ms: 1e3 * delay_s })
        }
        found => Ok(found.map_or(0.0, |(delay_s, _)| delay_s)),
    }
}

/// Computes the delay and its standard deviation \[s\] from the measured and the modelled output.
fn find(window: &Window, model: &[f64], [b0, a1, a0]: [f64; 3]) -> Option<(f64, f64)> {
    let Window { input, output, shift, foot, interval_s, .. } = window;
    let (foot, interval_s) = (*foot, *interval_s);
    let travel = output.last()?.abs();
    let far = (foot..output.len()).find(|&k| output[k] > START_SHARE * travel)?;
    let longest = foot + samples_in(LONGEST_START_S, interval_s);
    let last = far.min(longest).min(output.len() - 2);
    if last < foot + LEAST_SAMPLES {
        return None;
    }
    let factor = 1.0 + SCALE_STEP;
    let scaled = [factor * a1, factor * a0];
    let filter = Discrete::<2>::new(&scaled, interval_s)?;
    let (sampled, held) = (filter.readout(Hold::First), filter.readout(Hold::Zero));
    let mut state = sampled.start(&[0.0; 2], input[0]);
    let mut shift_state = [0.0; 2];
    let (mut normal, mut right, mut squares) = (Matrix2::zeros(), Vector2::zeros(), 0.0);
    for k in 0..=last {
        let from_input = sampled.read(0, &state, input[k]);
        let x = factor * (b0 * from_input + a0 * dot(&held.state[0], &shift_state));
        if k >= foot.max(1) {
            let row = Vector2::new((x - model[k]) / SCALE_STEP, -(model[k + 1] - model[k - 1]) / (2.0 * interval_s));
            normal += row * row.transpose();
            right += row * (output[k] - model[k]);
            squares += (output[k] - model[k]).powi(2);
        }
        filter.advance(&mut state, input[k]);
        filter.advance(&mut shift_state, shift[k]);
    }
    let inverse = normal.try_inverse()?;
    let found = inverse * right;
    let left = (squares - found.dot(&right)) / (last - foot) as f64;
    let variance = inverse[(1, 1)] * window.output_noise.max(left);
    Some((found[1], variance.max(0.0).sqrt()))
}
