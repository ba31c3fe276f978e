//! Checks of a fitted model, and the estimate with its covariance from a model that passes them.

pub(super) mod brake;
mod errors;
pub(super) mod start;

use nalgebra::{Matrix3, Vector3};

use errors::Errors;
use start::Start;

use super::{
    identification::{Estimate, Fit, Grade},
    lanes::sum,
    load::Load,
    rejection::Rejection,
    settings::Settings,
    sriv::{Solution, Sriv, Workspace, covariance::Noise},
    trace::{
        movement::{MIN_QUIET, Movement},
        samples::samples_in,
        window::Window,
    },
};

/// Largest standard deviations of usable b0, a1 and a0 \[%\]. That of a0 is large, as a0 itself may be small.
const MAX_SD_PCT: [f64; 3] = [6.0, 12.0, 30.0];
/// Largest standard deviation of each coefficient for a trace that ends during the movement \[%\].
const MAX_SD_CUT_PCT: f64 = 1.2;
/// Largest differences of measured and modelled output that dry friction, rails and a soft drive cause in a healthy
/// throw, as share of the travel: their root mean square, and the largest mean over [`MISFIT_STRETCH_S`] seconds.
const MISFIT_RMS: f64 = 4e-4;
const MISFIT_PEAK: f64 = 1e-3;
const MISFIT_STRETCH_S: f64 = 0.02;
/// Noise of the current makes the modelled output wander slowly. This share of the wandering is left after the fit.
const FITTED_SHARE: f64 = 0.3;
/// Largest accepted delay \[s\]. A delay below this many of its standard deviations is accepted too. A soft drive
/// (5e6 N/m) delays the toe by 1 to 2 ms, play of 0.1 mm by 3.3 ms.
const LARGEST_DELAY_S: f64 = 3.2e-3;
const DELAY_SIGMAS: f64 = 5.0;
/// Relative error of the common scale of b0, a1 and a0 for each second by which the toe starts late: the inrush, which
/// determines the scale, takes 50 ms.
const SCALE_PER_S: f64 = 20.0;
/// Relative error of this scale for each millimetre of slow departure from the model: the toe moves about one
/// millimetre in the inrush.
const SCALE_PER_MM: f64 = 3.0;
/// Relative error of this scale if the rise of the current departs from that of an armature by the peak of the current.
const SCALE_PER_RISE: f64 = 2.0;

/// An estimate, and the start of its movement if the samples show it.
pub(super) type StartedEstimate = (Estimate, Option<Start>);

/// Rejects a solution that is unsound, or has a coefficient that is not positive.
fn accept(solution: &Solution<2, 1, 3>, settings: &Settings) -> Result<(), Rejection> {
    let [b0, a1, a0] = solution.parameters;
    let positive = b0 > 0.0 && a1 > 0.0 && a0 > 0.0;
    match solution.sound(settings.fit_floor_pct) {
        Err(reason @ (Rejection::Singular | Rejection::NotConverged { .. })) => Err(reason),
        _ if !positive => Err(Rejection::NotPositive { b0, a1, a0 }),
        sound => sound,
    }
}

/// Rejects a movement that departs from the model by more than noise and usual dry friction explain. Returns the root
/// mean square of the slow departure, without that from noise \[mm\].
fn misfit(
    window: &Window,
    model: &[f64],
    [b0, a1, a0]: [f64; 3],
    travel_mm: f64,
    radians_per_mm: f64,
) -> Result<f64, Rejection> {
    let output = &window.output;
    let travel = travel_mm * radians_per_mm;
    // Variance of the modelled output, in steady state, for white noise of variance 1 on the input.
    let settled = b0 * b0 / (2.0 * a1 * a0) * window.interval_s;
    let scale = if window.input_scale().is_some() { 4.0 * window.running * window.running } else { 1.0 };
    let through = FITTED_SHARE * FITTED_SHARE * settled * scale * window.input_noise;
    let stretch = samples_in(MISFIT_STRETCH_S, window.interval_s).clamp(1, output.len());
    let (mut squares, mut slow, mut peak, mut at) = (0.0, 0.0, 0.0_f64, 0);
    for (block, (y, x)) in output.chunks(stretch).zip(model.chunks(stretch)).enumerate() {
        squares += sum([y, x], |[y, x]| (y - x) * (y - x));
        let mean = (sum([y, x], |[y, x]| y - x) / y.len() as f64).abs();
        slow += mean * mean * y.len() as f64;
        if y.len() == stretch && mean > peak {
            (peak, at) = (mean, block * stretch);
        }
    }
    // The variance of the noise comes from few samples, so it may be larger by five of its own standard deviations.
    let factor = 1.0 + 5.0 * (2.0 / window.noise_samples.max(MIN_QUIET) as f64).sqrt();
    let excess = (squares / output.len() as f64 - factor * window.output_noise - through).max(0.0).sqrt();
    let wander = 5.0 * (window.output_noise / stretch as f64 + through).sqrt();
    if excess > (MISFIT_RMS * travel).hypot(3.0 * through.sqrt()) || peak > (MISFIT_PEAK * travel).hypot(wander) {
        let at_s = (window.from + at) as f64 * window.interval_s;
        return Err(Rejection::Misfit { peak_mm: peak / radians_per_mm, at_s });
    }
    let slow = slow / output.len() as f64 - window.output_noise / stretch as f64;
    Ok((slow - 2.0 * through).max(0.0).sqrt() / radians_per_mm)
}

/// The start of the movement, with its delay behind the current; `None` if the samples do not show it. A brake, play,
/// lost motion or a time shift between the channels causes a delay.
///
/// The first 50 ms of a throw determine the common scale of b0, a1 and a0: later the machine runs at nearly constant
/// speed, which determines only the ratios a1/b0 and a0/b0. A delay of 1 ms changes the scale by about 2 %.
///
/// # Errors
/// When the delay is too large.
fn start(window: &Window, [b0, a1, a0]: [f64; 3], brakes: &mut brake::Buffers) -> Result<Option<Start>, Rejection> {
    match start::find(window, [a1 / b0, a0 / b0], &mut brakes.free) {
        Some(Start { delay_s, delay_sd_s, .. }) if delay_s.abs() > LARGEST_DELAY_S.max(DELAY_SIGMAS * delay_sd_s) => {
            Err(Rejection::LateStart { delay_ms: 1e3 * delay_s })
        }
        found => Ok(found),
    }
}

/// The estimate with its covariance, and the start of the movement; rejects a solution that does not describe the
/// movement, or is too uncertain. `workspace` has the instruments and the output of the solution.
pub(super) fn estimate(
    (model, solution): (&Sriv<2, 1, 3>, Solution<2, 1, 3>),
    window: &Window,
    load: Option<&Load>,
    movement: &Movement<'_>,
    settings: &Settings,
    workspace: &mut Workspace<3>,
    brakes: &mut brake::Buffers,
) -> Result<StartedEstimate, Rejection> {
    accept(&solution, settings)?;
    let slow_mm =
        misfit(window, &workspace.model_output, solution.parameters, movement.travel_mm, settings.radians_per_mm())?;
    let start = start(window, solution.parameters, brakes)?;
    let delay_s = start.map_or(0.0, |start| start.delay_s);
    let brake_sd = brake::scale_sd(window, solution.parameters, brakes)?;
    let scale_sd =
        (SCALE_PER_S * delay_s).hypot(SCALE_PER_MM * slow_mm).hypot(SCALE_PER_RISE * window.rise).hypot(brake_sd);
    let problem = window.problem();
    let noise = Noise {
        output: window.output_noise,
        inputs: [window.input_noise],
        scale: window.input_scale(),
        offsets: window.offsets,
    };
    let refined = settings.refined.then(|| model.refine(&problem, &solution, &noise, workspace));
    let solution = refined.transpose().map_err(|_| Rejection::Singular)?.flatten().unwrap_or(solution);
    accept(&solution, settings)?;
    let covariance = Matrix3::from(model.covariance(&problem, &solution, &noise, workspace));
    let errors = load.and_then(|load| Errors::of(load, window, &solution, workspace)).ok_or(Rejection::Singular)?;
    let ends_moving = settings.stroke_mm.is_none() && movement.ends_moving();
    let parameters = solution.parameters;
    for (i, name) in ["b0", "a1", "a0"].into_iter().enumerate() {
        let sd_pct = 100.0 * covariance[(i, i)].sqrt() / parameters[i];
        if ends_moving && (sd_pct.is_nan() || sd_pct > MAX_SD_CUT_PCT) {
            return Err(Rejection::EndMissing { travel_mm: movement.travel_mm });
        } else if sd_pct.is_nan() {
            return Err(Rejection::Singular);
        } else if sd_pct > MAX_SD_PCT[i] {
            return Err(Rejection::Uncertain { name, sd_pct, limit_pct: MAX_SD_PCT[i] });
        }
    }
    let [b0, a1, a0] = parameters;
    let (Errors { load, dry, offset }, parameters) = (errors, Vector3::from(parameters));
    let estimate = Estimate {
        grade: Grade::Good,
        b0,
        a1,
        a0,
        ratios_only: false,
        covariance: (covariance + covariance.transpose()) * 0.5,
        systematic: load + dry * dry.transpose() + parameters * (scale_sd * scale_sd) * parameters.transpose(),
        offset: offset.into(),
        reason: None,
        running: None,
        fit: Some(Fit { pct: 100.0 * solution.fit, iterations: solution.iterations }),
        start_s: window.from as f64 * window.interval_s,
        end_s: (window.from + window.output.len() - 1) as f64 * window.interval_s,
    };
    Ok((estimate, start))
}
