//! One throw through all stages: checks, decimation, course of the movement, window, estimation, acceptance.

use nalgebra::Matrix3;

use super::{
    Features, Hold, Motor, Rejection, Settings,
    checks::{self, quantum, second_difference_noise},
    covariance::Noise,
    decimate,
    movement::{Level, MIN_QUIET, Movement},
    rejection::Channel,
    release,
    sriv::{Failure, Problem, Signal, Solution, Sriv, Unsound, Workspace},
};
use crate::throw::{Direction, Throw};

/// Fewest samples and shortest time in which three coefficients can be told.
const MIN_SAMPLES: usize = 30;
const MIN_DURATION_S: f64 = 0.3;
/// Quiet samples kept in the window before the motor's start.
const LEAD_IN: usize = 2;
/// Fewest samples in the rise of an unfiltered current.
const MIN_RISE_SAMPLES: usize = 4;
/// Largest standard deviations of b0, a1 and a0 that are of use \[%\]; a0 may be small.
const MAX_SD_PCT: [f64; 3] = [6.0, 12.0, 30.0];
/// The same for a trace that ends in the middle of the movement.
const MAX_SD_CUT_PCT: f64 = 1.2;
/// What dry friction, rails and a soft drive make the movement depart from a linear model, as a share of the travel:
/// root mean square, and averaged over 20 ms.
const MISFIT_RMS: f64 = 4e-4;
const MISFIT_PEAK: f64 = 1e-3;
const MISFIT_STRETCH_S: f64 = 0.02;
/// How much of the wandering that noise in the current causes is left beside a fitted model.
const FITTED_SHARE: f64 = 0.3;
/// Equivalent noise bandwidth of a fourth-order Butterworth low-pass over its cut-off.
const NOISE_BANDWIDTH: f64 = 1.026;

/// The coefficients of equation (12) for one throw, with their covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// KT / J \[rad s⁻² A⁻¹\] (rad s⁻² A⁻² for a series motor).
    pub b0: f64,
    /// Kf / J \[s⁻¹\].
    pub a1: f64,
    /// Kspr / J \[s⁻²\].
    pub a0: f64,
    /// Covariance of (b0, a1, a0), in their units.
    pub covariance: Matrix3<f64>,
    /// `R²_T` \[%\].
    pub fit_pct: f64,
    /// SRIV iterations.
    pub iterations: usize,
    /// First sample used, from the start of the trace \[s\].
    pub start_s: f64,
    /// Last sample used, from the start of the trace \[s\].
    pub end_s: f64,
}

/// All that one throw tells.
#[derive(Debug, Clone, PartialEq)]
pub struct Identification {
    /// The direction of the movement: from the position; the declared one when the position does not tell.
    pub direction: Option<Direction>,
    /// The logger declared the other direction than the toe moved.
    pub direction_contradicted: bool,
    /// What maintainers know of a throw.
    pub features: Features,
    /// The estimate, or why there is none.
    pub outcome: Result<Estimate, Rejection>,
}

/// Identifies throws one after the other, reusing its work buffers.
#[derive(Debug, Default)]
pub struct Identifier {
    current: Vec<f64>,
    position: Vec<f64>,
    input: Vec<f64>,
    input_scale: Vec<f64>,
    output: Vec<f64>,
    equilibrium: Vec<f64>,
    scratch: Vec<f64>,
    workspace: Workspace<3>,
}

/// The model of equation (12): two poles, one input, three parameters.
type ThrowModel = Sriv<2, 1, 3>;

/// The part of a trace that is identified, as the estimator sees it.
struct Window {
    from: usize,
    to: usize,
    interval_s: f64,
    shifted: bool,
    /// Variances of white noise on input (per unit scale) and output.
    input_noise: f64,
    output_noise: f64,
    /// Quiet samples behind the output's noise.
    noise_samples: usize,
    /// Variances of the offsets that were removed from input and output.
    offsets: [f64; 2],
    /// The input is I |I|, and its mean magnitude of I.
    series: bool,
    running: f64,
}

impl Identifier {
    /// Identifies one throw. Never panics, whatever the trace holds.
    pub fn identify(&mut self, throw: &Throw, settings: &Settings) -> Identification {
        let trace = &throw.trace;
        let raw_interval_s = 1.0 / trace.sample_rate_hz();
        let factor = decimate::factor(trace.sample_rate_hz());
        let interval_s = raw_interval_s * factor as f64;
        let raw_checks = checks::values(trace.current_a(), trace.position_mm(), raw_interval_s)
            .and_then(|()| checks::clipping(trace.current_a(), raw_interval_s));

        copy_finite(&mut self.current, trace.current_a());
        copy_finite(&mut self.position, trace.position_mm());
        let at_rest = if factor > 1 { level_before(&self.current) } else { 0.0 };
        let linear = settings.motor == Motor::PermanentMagnet && throw.anti_alias_hz.is_none();
        let released = (factor > 1)
            .then(|| release::at_full_rate(&mut self.current, raw_interval_s, linear, &mut self.scratch))
            .flatten();
        decimate::decimate(&mut self.current, factor, at_rest);
        let first = self.position[0];
        decimate::decimate(&mut self.position, factor, first);

        let movement = Movement::of(&self.current, &self.position, &mut self.scratch);
        let outcome = raw_checks
            .and_then(|()| checks_of(settings))
            .and_then(|()| long_enough(self.current.len(), interval_s))
            .and_then(|()| {
                checks::course(&movement, &self.current, &self.position, interval_s, settings, &mut self.scratch)
            })
            .and_then(|()| checks::noise(&movement, settings))
            .and_then(|()| checks::inrush(&movement, &self.current, &mut self.scratch))
            .and_then(|()| checks::sticking(&movement, Channel::Current, trace.current_a(), raw_interval_s, factor))
            .and_then(|()| checks::sticking(&movement, Channel::Position, trace.position_mm(), raw_interval_s, factor))
            .and_then(|()| self.estimate(throw, settings, &movement, interval_s, factor, released));
        let moved = direction_moved(&movement, &outcome);
        Identification {
            direction: moved.or(throw.direction),
            direction_contradicted: moved.is_some() && throw.direction.is_some() && moved != throw.direction,
            features: movement.features(interval_s),
            outcome,
        }
    }

    fn estimate(
        &mut self,
        throw: &Throw,
        settings: &Settings,
        movement: &Movement,
        interval_s: f64,
        factor: usize,
        released: Option<f64>,
    ) -> Result<Estimate, Rejection> {
        let rate_hz = 1.0 / interval_s;
        let filter_hz = throw.anti_alias_hz.filter(|hz| *hz > 0.0 && *hz <= 0.5 * rate_hz * 1.0001);
        let rise_samples = checks::rise_samples(movement, &self.current);
        if factor == 1 && filter_hz.is_none() && rise_samples < MIN_RISE_SAMPLES {
            return Err(Rejection::Undersampled { rise_samples });
        }
        let filtered = filter_hz.is_some();
        checks::spikes(movement, Channel::Current, &self.current, interval_s, filtered)?;
        checks::spikes(movement, Channel::Position, &self.position, interval_s, filtered)?;
        if factor == 1 && filter_hz.is_none() {
            checks::steps(movement, Channel::Current, &self.current, interval_s, &mut self.scratch)?;
            checks::steps(movement, Channel::Position, &self.position, interval_s, &mut self.scratch)?;
            checks::noise_level(movement, &self.current, interval_s, settings, &mut self.scratch)?;
        }
        let filter_hz = filter_hz.or((factor > 1).then_some(decimate::CUT_OFF_SHARE * rate_hz));
        let window = self.window(settings, movement, interval_s, filter_hz, released)?;
        let model = ThrowModel::new([0]).map_err(|_| Rejection::Singular)?;
        let problem = Problem {
            interval_s: window.interval_s,
            output: &self.output,
            inputs: [Signal::Sampled(&self.input, Hold::First)],
            equilibrium: window.shifted.then_some(self.equilibrium.as_slice()),
        };
        let solution = model.identify(&problem, &mut self.workspace).map_err(|failure| match failure {
            Failure::Singular | Failure::UnequalLengths => Rejection::Singular,
            Failure::TooFewSamples => {
                let samples = window.to - window.from;
                Rejection::TooShort { samples, duration_s: samples as f64 * window.interval_s }
            }
        })?;
        accept(&solution, settings)?;
        let noise = Noise {
            output: window.output_noise,
            inputs: [window.input_noise],
            scale: (settings.motor == Motor::Series).then_some(self.input_scale.as_slice()),
            offsets: window.offsets,
        };
        let travel = movement.travel_mm * std::f64::consts::TAU / settings.lead_mm;
        misfit(&self.output, self.workspace.model_output(), &solution, &window, travel, settings.lead_mm)?;
        let refined = if settings.refined {
            model.refine(&problem, &solution, &noise, &mut self.workspace).map_err(|_| Rejection::Singular)?
        } else {
            None
        };
        let solution = refined.map_or(solution, |refined| refined.solution);
        accept(&solution, settings)?;
        let covariance = model.covariance(&problem, &solution, &noise, &self.workspace);
        let cut = settings.stroke_mm.is_none() && movement.ends_moving(&self.position);
        finish(&solution, &covariance, &window, cut.then_some(movement.travel_mm))
    }

    /// Cuts the window out of the trace and brings it into the model's terms: input positive when it drives the throw,
    /// output in radians of the screw from the start of the throw.
    fn window(
        &mut self,
        settings: &Settings,
        movement: &Movement,
        interval_s: f64,
        filter_hz: Option<f64>,
        released: Option<f64>,
    ) -> Result<Window, Rejection> {
        let from = movement.start().saturating_sub(LEAD_IN);
        let to = movement.end(&self.position).max(from) + 1;
        let radians_per_mm = std::f64::consts::TAU / settings.lead_mm;
        let offset = movement.current.mean;
        let drive = movement.drive(&self.current);
        let start_mm = movement.position.mean;
        self.output.clear();
        self.output.extend(self.position[from..to].iter().map(|x| movement.sign * (x - start_mm) * radians_per_mm));
        self.input.clear();
        self.input.extend(self.current[from..to].iter().map(|i| drive * (i - offset)));
        self.input_scale.clear();
        if settings.motor == Motor::Series {
            self.input_scale.extend(self.input.iter().map(|i| 2.0 * i.abs()));
            for i in &mut self.input {
                *i *= i.abs();
            }
        }
        if filter_hz.is_none() && settings.motor == Motor::PermanentMagnet {
            let foot = movement.start() - from;
            match release::onset(&self.input, 0.0, foot) {
                Some(onset) => {
                    if let Some(missing) = onset.missing() {
                        return Err(Rejection::OnsetMissing { missing_s: missing * interval_s });
                    }
                    onset.complete(&mut self.input, foot);
                }
                None if movement.quiet < MIN_QUIET || self.input[foot + 1] > 0.5 * movement.peak_a => {
                    return Err(Rejection::StartMissing { current_a: self.input[foot + 1] });
                }
                None => {}
            }
        }
        let released = released.map_or_else(
            || release::time(&self.current[from..to], offset, movement.start() - from, interval_s, filter_hz),
            |released| released - from as f64 * interval_s,
        );
        let equilibrium = movement.sign * (settings.neutral_mm - start_mm) * radians_per_mm;
        release::course(&mut self.equilibrium, to - from, released, interval_s, filter_hz);
        for shift in &mut self.equilibrium {
            *shift *= equilibrium;
        }
        let (current_sd, position_sd) = self.sensor_noise(settings, movement);
        // White noise that passed a filter has more power below its cut-off than its variance at this rate says.
        let colour = filter_hz.map_or(1.0, |hz| (0.5 / (interval_s * NOISE_BANDWIDTH * hz)).max(1.0));
        let window = Window {
            from,
            to,
            interval_s,
            shifted: equilibrium != 0.0,
            input_noise: current_sd * current_sd * colour,
            output_noise: (position_sd * radians_per_mm).powi(2) * colour,
            noise_samples: movement.position.samples,
            offsets: [
                offset_variance(movement.current, &self.current),
                offset_variance(movement.position, &self.position) * radians_per_mm * radians_per_mm,
            ],
            series: settings.motor == Motor::Series,
            running: movement.mean_a,
        };
        let samples = to - from;
        long_enough(samples, interval_s)?;
        Ok(window)
    }

    /// Standard deviations of current \[A\] and position \[mm\] noise: measured while nothing happens, else what the
    /// trace's roughness or the settings say, and never below what the converter's step leaves open.
    fn sensor_noise(&mut self, settings: &Settings, movement: &Movement) -> (f64, f64) {
        let current =
            if movement.current.samples >= MIN_QUIET { movement.current.sd } else { settings.current_noise_a };
        let position = if movement.position.samples >= MIN_QUIET {
            movement.position.sd
        } else {
            second_difference_noise(&self.position, &mut self.scratch).min(settings.position_noise_mm)
        };
        let rounding = |values: &[f64]| quantum(values) / 12.0_f64.sqrt();
        (current.max(rounding(&self.current)), position.max(rounding(&self.position)))
    }
}

/// Variance of a mean over quiet samples; with less noise than half a step of the converter averaging does not help.
fn offset_variance(level: Level, values: &[f64]) -> f64 {
    let step = quantum(values);
    let rounding = if level.sd < 0.5 * step { step * step / 12.0 } else { 0.0 };
    if level.samples == 0 { 0.0 } else { level.sd * level.sd / level.samples as f64 + rounding }
}

/// The settings that the estimate divides by.
fn checks_of(settings: &Settings) -> Result<(), Rejection> {
    for (name, value) in [("lead_mm", settings.lead_mm), ("stroke_mm", settings.stroke_mm.unwrap_or(1.0))] {
        if !(value.is_finite() && value > 0.0) {
            return Err(Rejection::Settings { name, value });
        }
    }
    Ok(())
}

fn accept(solution: &Solution<2, 1, 3>, settings: &Settings) -> Result<(), Rejection> {
    let [b0, a1, a0] = solution.parameters;
    let sound = solution.sound(settings.fit_floor_pct / 100.0);
    let positive = b0 > 0.0 && a1 > 0.0 && a0 > 0.0;
    match sound {
        Err(Unsound::NearlySingular { .. }) => Err(Rejection::Singular),
        Err(Unsound::NotConverged { iterations }) => Err(Rejection::NotConverged { iterations }),
        Ok(()) | Err(_) if !positive => Err(Rejection::NotPositive { b0, a1, a0 }),
        Err(Unsound::Unstable) => Err(Rejection::Unstable { a1, a0 }),
        Err(Unsound::PoorFit { fit }) => {
            Err(Rejection::PoorFit { fit_pct: 100.0 * fit, floor_pct: settings.fit_floor_pct })
        }
        Ok(()) => Ok(()),
    }
}

/// Refuses an output that departs from the model's by more than noise and the usual dry friction explain.
fn misfit(
    output: &[f64],
    model: &[f64],
    solution: &Solution<2, 1, 3>,
    window: &Window,
    travel: f64,
    lead_mm: f64,
) -> Result<(), Rejection> {
    let [b0, a1, a0] = solution.parameters;
    // White noise of unit variance on the input makes this variance at the model's output once it has settled.
    let settled = b0 * b0 / (2.0 * a1 * a0) * window.interval_s;
    let scale = if window.series { 4.0 * window.running * window.running } else { 1.0 };
    let through = FITTED_SHARE * FITTED_SHARE * settled * scale * window.input_noise;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of the samples")]
    let stretch = ((MISFIT_STRETCH_S / window.interval_s) as usize).clamp(1, output.len());
    let (mut squares, mut peak, mut at) = (0.0, 0.0_f64, 0);
    for (block, (y, x)) in output.chunks(stretch).zip(model.chunks(stretch)).enumerate() {
        let sum: f64 = y.iter().zip(x).map(|(y, x)| y - x).sum();
        squares += y.iter().zip(x).map(|(y, x)| (y - x) * (y - x)).sum::<f64>();
        let mean = (sum / y.len() as f64).abs();
        if y.len() == stretch && mean > peak {
            (peak, at) = (mean, block * stretch);
        }
    }
    // The noise itself is known from a few samples only: leave room for five standard deviations of its variance.
    let room = 1.0 + 5.0 * (2.0 / window.noise_samples.max(MIN_QUIET) as f64).sqrt();
    let excess = (squares / output.len() as f64 - room * window.output_noise - through).max(0.0).sqrt();
    let wander = 5.0 * (window.output_noise / stretch as f64 + through).sqrt();
    if excess > (MISFIT_RMS * travel).hypot(3.0 * through.sqrt()) || peak > (MISFIT_PEAK * travel).hypot(wander) {
        let at_s = (window.from + at) as f64 * window.interval_s;
        return Err(Rejection::Misfit { peak_mm: peak * lead_mm / std::f64::consts::TAU, at_s });
    }
    Ok(())
}

fn finish(
    solution: &Solution<2, 1, 3>,
    covariance: &[[f64; 3]; 3],
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
            _ if sd_pct.is_nan() || sd_pct > MAX_SD_PCT[i] => {
                return Err(Rejection::Uncertain { name, sd_pct, limit_pct: MAX_SD_PCT[i] });
            }
            _ => {}
        }
    }
    Ok(Estimate {
        b0,
        a1,
        a0,
        covariance: Matrix3::from_fn(|i, j| 0.5 * (covariance[i][j] + covariance[j][i])),
        fit_pct: 100.0 * solution.fit,
        iterations: solution.iterations,
        start_s: window.from as f64 * window.interval_s,
        end_s: (window.to - 1) as f64 * window.interval_s,
    })
}

/// A whole trace, or the window of it, in samples.
fn long_enough(samples: usize, interval_s: f64) -> Result<(), Rejection> {
    let duration_s = samples as f64 * interval_s;
    if samples < MIN_SAMPLES || duration_s < MIN_DURATION_S {
        return Err(Rejection::TooShort { samples, duration_s });
    }
    Ok(())
}

/// The way the toe went, where the position is to be trusted with that.
fn direction_moved(movement: &Movement, outcome: &Result<Estimate, Rejection>) -> Option<Direction> {
    let untrusted = matches!(
        outcome,
        Err(Rejection::NoMovement
            | Rejection::NotFinite { channel: Channel::Position, .. }
            | Rejection::Implausible { channel: Channel::Position, .. }
            | Rejection::Noisy { channel: Channel::Position, .. }
            | Rejection::PositionJump { .. })
    );
    match movement.sign {
        _ if untrusted => None,
        sign if sign > 0.0 => Some(Direction::NormalToReverse),
        sign if sign < 0.0 => Some(Direction::ReverseToNormal),
        _ => None,
    }
}

/// Copies a channel; values that are no number repeat the one before, so that the rest can still be described.
fn copy_finite(to: &mut Vec<f64>, from: &[f64]) {
    let mut last = from.iter().copied().find(|v| v.is_finite()).unwrap_or(0.0);
    to.clear();
    to.extend(from.iter().map(|v| {
        if v.is_finite() {
            last = *v;
        }
        last
    }));
}

/// The current before the trace: its first value when that is small, as a filter at rest needs it; else none.
fn level_before(current: &[f64]) -> f64 {
    let peak = current.iter().fold(0.0, |peak: f64, i| peak.max(i.abs()));
    if current[0].abs() < 0.05 * peak { current[0] } else { 0.0 }
}
