//! One throw through all stages: checks, decimation, course of the movement, window, estimation, acceptance.

use nalgebra::Matrix3;

use super::{
    Features, Hold, Motor, Rejection, Settings,
    checks::{self, quantum, second_difference_noise},
    covariance::Noise,
    decimate,
    movement::{MIN_QUIET, Movement},
    rejection::Channel,
    release,
    sriv::{Failure, Problem, Signal, Solution, Sriv, Termination, Workspace},
};
use crate::throw::{Direction, Throw};

/// Fewest samples and shortest time in which three coefficients can be told.
const MIN_SAMPLES: usize = 30;
const MIN_DURATION_S: f64 = 0.3;
/// Quiet samples kept in the window before the motor's start.
const LEAD_IN: usize = 2;
/// Fewest samples in the rise of an unfiltered current.
const MIN_RISE_SAMPLES: usize = 4;
/// Least reciprocal condition of the normal matrix: below it rounding reaches the third digit.
const MIN_RCOND: f64 = 1e-12;
/// Largest standard deviation of b0 that is of use \[%\].
const MAX_SD_PCT: f64 = 20.0;
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
    /// R²_T \[%\].
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
    /// Quiet samples behind the offsets that were removed from input and output.
    offset_samples: [usize; 2],
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
        decimate::decimate(&mut self.current, factor, at_rest);
        let first = self.position[0];
        decimate::decimate(&mut self.position, factor, first);

        let movement = Movement::of(&self.current, &self.position, &mut self.scratch);
        let outcome = raw_checks
            .and_then(|()| checks_of(settings))
            .and_then(|()| {
                checks::course(&movement, &self.current, &self.position, interval_s, settings, &mut self.scratch)
            })
            .and_then(|()| checks::noise(&movement, settings))
            .and_then(|()| self.estimate(throw, settings, &movement, interval_s, factor));
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
    ) -> Result<Estimate, Rejection> {
        let rate_hz = 1.0 / interval_s;
        let filter_hz = throw.anti_alias_hz.filter(|hz| *hz > 0.0 && *hz <= 0.5 * rate_hz * 1.0001);
        let rise_samples = checks::rise_samples(movement, &self.current);
        if factor == 1 && filter_hz.is_none() && rise_samples < MIN_RISE_SAMPLES {
            return Err(Rejection::Undersampled { rise_samples });
        }
        let filter_hz = filter_hz.or((factor > 1).then_some(decimate::CUT_OFF_SHARE * rate_hz));
        let window = self.window(settings, movement, interval_s, filter_hz)?;
        let model = ThrowModel::new([0]).map_err(|_| Rejection::Singular)?;
        let problem = Problem {
            interval_s: window.interval_s,
            output: &self.output,
            inputs: [Signal::Sampled(&self.input, Hold::First)],
            equilibrium: window.shifted.then_some(self.equilibrium.as_slice()),
        };
        let solution = model.identify(&problem, &mut self.workspace).map_err(|failure| match failure {
            Failure::Singular | Failure::UnequalLengths => Rejection::Singular,
            Failure::TooFewSamples => too_short(&window),
        })?;
        accept(&solution, settings)?;
        let noise = Noise {
            output: window.output_noise,
            inputs: [window.input_noise],
            scale: (settings.motor == Motor::Series).then_some(self.input_scale.as_slice()),
            offset_samples: window.offset_samples,
        };
        let covariance = model.covariance(&problem, &solution, &noise, &self.workspace);
        finish(&solution, &covariance, &window)
    }

    /// Cuts the window out of the trace and brings it into the model's terms: input positive when it drives the throw,
    /// output in radians of the screw from the start of the throw.
    fn window(
        &mut self,
        settings: &Settings,
        movement: &Movement,
        interval_s: f64,
        filter_hz: Option<f64>,
    ) -> Result<Window, Rejection> {
        let from = movement.start().saturating_sub(LEAD_IN);
        let to = movement.end(&self.position).max(from) + 1;
        let radians_per_mm = std::f64::consts::TAU / settings.lead_mm;
        let offset = movement.current.mean;
        let drive = self.current[from..to].iter().map(|i| i - offset).sum::<f64>().signum();
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
        let released = release::time(&self.current[from..to], offset, movement.start() - from, interval_s, filter_hz);
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
            offset_samples: [movement.current.samples, movement.position.samples],
        };
        let samples = to - from;
        if samples < MIN_SAMPLES || (samples as f64) * interval_s < MIN_DURATION_S {
            return Err(too_short(&window));
        }
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

/// The settings that the estimate divides by.
fn checks_of(settings: &Settings) -> Result<(), Rejection> {
    for (name, value) in [("lead_mm", settings.lead_mm), ("stroke_mm", settings.stroke_mm.unwrap_or(1.0))] {
        if !(value.is_finite() && value > 0.0) {
            return Err(Rejection::Settings { name, value });
        }
    }
    Ok(())
}

/// "Converged" alone is not acceptance: on data that the model cannot describe, SRIV converges to nonsense.
fn accept(solution: &Solution<2, 1, 3>, settings: &Settings) -> Result<(), Rejection> {
    let [b0, a1, a0] = solution.parameters;
    if solution.rcond < MIN_RCOND {
        return Err(Rejection::Singular);
    }
    if solution.termination != Termination::Converged {
        return Err(Rejection::NotConverged { iterations: solution.iterations });
    }
    if b0 <= 0.0 || a1 <= 0.0 || a0 <= 0.0 {
        return Err(Rejection::NotPositive { b0, a1, a0 });
    }
    if solution.reflected {
        return Err(Rejection::Unstable { a1, a0 });
    }
    let fit_pct = 100.0 * solution.fit;
    // Written so that a NaN is refused.
    if !(fit_pct >= settings.fit_floor_pct) {
        return Err(Rejection::PoorFit { fit_pct, floor_pct: settings.fit_floor_pct });
    }
    Ok(())
}

fn finish(solution: &Solution<2, 1, 3>, covariance: &[[f64; 3]; 3], window: &Window) -> Result<Estimate, Rejection> {
    let [b0, a1, a0] = solution.parameters;
    let sd_pct = 100.0 * covariance[0][0].sqrt() / b0;
    if !(sd_pct <= MAX_SD_PCT) {
        return Err(Rejection::Uncertain { sd_pct, limit_pct: MAX_SD_PCT });
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

fn too_short(window: &Window) -> Rejection {
    let samples = window.to - window.from;
    Rejection::TooShort { samples, duration_s: samples as f64 * window.interval_s }
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
