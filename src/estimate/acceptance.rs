//! Acceptance of a fitted model: soundness, departure of the movement from the model, and standard deviations.

use nalgebra::Matrix3;

use super::{
    identification::{Estimate, Grade},
    movement::{MIN_QUIET, samples_in},
    rejection::Rejection,
    settings::Settings,
    sriv::Solution,
    start::Fitted,
    window::Window,
};

/// Largest standard deviations of usable b0, a1 and a0 \[%\]; a0 may be small.
const MAX_SD_PCT: [f64; 3] = [6.0, 12.0, 30.0];
/// Largest standard deviation for a trace that ends during the movement \[%\].
const MAX_SD_CUT_PCT: f64 = 1.2;
/// Departures from the linear model that dry friction, rails and a soft drive cause in a healthy throw, as share of the
/// travel: root mean square, and the largest mean over [`MISFIT_STRETCH_S`].
const MISFIT_RMS: f64 = 4e-4;
const MISFIT_PEAK: f64 = 1e-3;
const MISFIT_STRETCH_S: f64 = 0.02;
/// Share of the slow departure from noise of the current that is left after the fit of the model.
const FITTED_SHARE: f64 = 0.3;
/// Relative error of the common scale of b0, a1 and a0: for each second by which the toe starts late (the inrush, which
/// determines the scale, takes 50 ms), and for each millimetre of slow departure (the toe moves about one millimetre in
/// that time).
const SCALE_PER_S: f64 = 20.0;
const SCALE_PER_MM: f64 = 3.0;
/// Error of the common scale for a departure of the rise as large as the peak.
const SCALE_PER_RISE: f64 = 2.0;

/// Departure of an accepted movement from the model.
#[derive(Debug, Clone, Copy)]
pub(super) struct Departure {
    /// Root mean square of the slow departure beyond noise \[mm\].
    pub(super) slow_mm: f64,
    /// Delay of the start \[s\].
    pub(super) delay_s: f64,
    /// Relative standard deviation of the common scale of b0, a1 and a0, by a brake that may drag at the start.
    pub(super) brake_sd: f64,
}

/// Rejects a solution that is unsound, or not that of a switch.
pub(super) fn accept(solution: &Solution<2, 1, 3>, settings: &Settings) -> Result<(), Rejection> {
    let [b0, a1, a0] = solution.parameters;
    let positive = b0 > 0.0 && a1 > 0.0 && a0 > 0.0;
    match solution.sound(settings.fit_floor_pct) {
        Err(reason @ (Rejection::Singular | Rejection::NotConverged { .. })) => Err(reason),
        _ if !positive => Err(Rejection::NotPositive { b0, a1, a0 }),
        sound => sound,
    }
}

/// Rejects an output that departs from that of the model by more than noise and usual dry friction explain; returns the slow
/// departure of an accepted one beyond noise \[mm\].
pub(super) fn misfit(fitted: &Fitted<'_>, window: &Window, travel: f64, lead_mm: f64) -> Result<f64, Rejection> {
    let Fitted { output, model, parameters: [b0, a1, a0], .. } = *fitted;
    // Variance of the model's output for white noise of unit variance on the input, in steady state.
    let settled = b0 * b0 / (2.0 * a1 * a0) * window.interval_s;
    let scale = if window.series { 4.0 * window.running * window.running } else { 1.0 };
    let through = FITTED_SHARE * FITTED_SHARE * settled * scale * window.input_noise;
    let stretch = samples_in(MISFIT_STRETCH_S, window.interval_s).clamp(1, output.len());
    let (mut squares, mut slow, mut peak, mut at) = (0.0, 0.0, 0.0_f64, 0);
    for (block, (y, x)) in output.chunks(stretch).zip(model.chunks(stretch)).enumerate() {
        let sum: f64 = y.iter().zip(x).map(|(y, x)| y - x).sum();
        squares += y.iter().zip(x).map(|(y, x)| (y - x) * (y - x)).sum::<f64>();
        let mean = (sum / y.len() as f64).abs();
        slow += mean * mean * y.len() as f64;
        if y.len() == stretch && mean > peak {
            (peak, at) = (mean, block * stretch);
        }
    }
    // The noise is estimated from few samples: allows for five standard deviations of its variance.
    let factor = 1.0 + 5.0 * (2.0 / window.noise_samples.max(MIN_QUIET) as f64).sqrt();
    let excess = (squares / output.len() as f64 - factor * window.output_noise - through).max(0.0).sqrt();
    let wander = 5.0 * (window.output_noise / stretch as f64 + through).sqrt();
    if excess > (MISFIT_RMS * travel).hypot(3.0 * through.sqrt()) || peak > (MISFIT_PEAK * travel).hypot(wander) {
        let at_s = (window.from + at) as f64 * window.interval_s;
        return Err(Rejection::Misfit { peak_mm: peak * lead_mm / std::f64::consts::TAU, at_s });
    }
    let slow = slow / output.len() as f64 - window.output_noise / stretch as f64;
    Ok((slow - 2.0 * through).max(0.0).sqrt() * lead_mm / std::f64::consts::TAU)
}

/// The estimate with its covariance, from an accepted solution; rejects an uncertain one. `cut_after_mm`: travel of a
/// trace that ends during the movement; `dry` and `offset`: errors from dry friction and from the current at rest; `load`:
/// covariance of the errors from a random load.
pub(super) fn finish(
    solution: &Solution<2, 1, 3>,
    covariance: &[[f64; 3]; 3],
    [dry, offset]: [[f64; 3]; 2],
    load: &Matrix3<f64>,
    departure: Departure,
    window: &Window,
    cut_after_mm: Option<f64>,
) -> Result<Estimate, Rejection> {
    let [b0, a1, a0] = solution.parameters;
    for (i, name) in ["b0", "a1", "a0"].into_iter().enumerate() {
        let sd_pct = 100.0 * covariance[i][i].sqrt() / solution.parameters[i];
        match cut_after_mm {
            Some(travel_mm) if sd_pct.is_nan() || sd_pct > MAX_SD_CUT_PCT => {
                return Err(Rejection::EndMissing { travel_mm });
            }
            _ if sd_pct.is_nan() => return Err(Rejection::Singular),
            _ if sd_pct > MAX_SD_PCT[i] => {
                return Err(Rejection::Uncertain { name: name.to_owned(), sd_pct, limit_pct: MAX_SD_PCT[i] });
            }
            _ => {}
        }
    }
    let scale = (SCALE_PER_S * departure.delay_s)
        .hypot(SCALE_PER_MM * departure.slow_mm)
        .hypot(SCALE_PER_RISE * window.rise)
        .hypot(departure.brake_sd);
    Ok(Estimate {
        grade: Grade::Good,
        b0,
        a1,
        a0,
        ratios_only: false,
        covariance: Matrix3::from_fn(|i, j| 0.5 * (covariance[i][j] + covariance[j][i])),
        systematic: Matrix3::from_fn(|i, j| {
            load[(i, j)] + dry[i] * dry[j] + scale * scale * solution.parameters[i] * solution.parameters[j]
        }),
        offset,
        reason: None,
        fit_pct: 100.0 * solution.fit,
        iterations: solution.iterations,
        start_s: window.from as f64 * window.interval_s,
        end_s: (window.to - 1) as f64 * window.interval_s,
    })
}
