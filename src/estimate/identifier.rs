//! The stages of the estimator: checks, decimation, course of the movement, window, estimation, acceptance.

use super::{
    acceptance::{self, StartedEstimate, brake, start},
    armature::{Armature, LEAST_RATE_HZ},
    current_only,
    features::Features,
    identification::{Estimate, Fit, Grade, Identification},
    load::{Integrals, Load},
    ratios::{self, Ratios},
    rejection::{MIN_RISE_SAMPLES, Rejection},
    settings::{Motor, Settings},
    sriv::{Sriv, Workspace},
    trace::{
        completeness, damage, decimate,
        held::{self, Resampled},
        hum, missing,
        movement::{INRUSH_S, MIN_QUIET, Movement, start_of_motor},
        noise, release,
        samples::{Level, every, has_rate, median_of, peak, second_difference_noise},
        window::{Window, long_enough},
    },
};
use crate::throw::{Channel, Direction, Throw, Trace};

/// The iteration ends at this relative change of the parameters. Each iteration divides the change by 200 or more, so
/// the remaining error is below a thousandth of a standard deviation of the estimate.
const TOLERANCE: f64 = 1e-4;
/// Least rate at which an unfiltered current with an unresolved rise still gives the ratios \[Hz\]. They agree with those
/// at 1 kHz within 0.3 % on an independent drive. At 200 Hz and slower rates the ripple of rectified mains (100 Hz and
/// its multiples) becomes a constant current.
const LEAST_RATIOS_HZ: f64 = 250.0;
/// Largest relative standard deviation of a usable ratio if the full model fails. After a long unlocking stroke it is 2
/// to 4 %; with a position that has nothing to do with the current it is 70 %.
const LARGEST_RATIO_ERROR: f64 = 0.2;
/// Hum is searched if the standard deviation of the current before the start of the motor is above this multiple of the
/// noise that its second differences show.
const HUM_FACTOR: f64 = 1.3;
/// Longest time of a motor in a throw without a toe position \[s\]. A motor that does not stop at the end runs until its
/// time-out, some seconds or tens of seconds; with a longer time the sampling rate is wrong.
const LONGEST_RUN_S: f64 = 300.0;
/// Duration of the start of the motor \[s\], in which the toe moves by 1.5 mm.
const START_S: f64 = 0.05;

/// The estimator with its buffers, which are reused from throw to throw.
#[derive(Debug, Default)]
pub struct Identifier {
    current: Vec<f64>,
    position: Vec<f64>,
    buffers: Buffers,
}

/// The window and the buffers of its estimation.
#[derive(Debug, Default)]
struct Buffers {
    window: Window,
    scratch: Vec<f64>,
    integrals: Integrals,
    workspace: Workspace<3>,
    brakes: brake::Buffers,
}

impl Identifier {
    /// Estimates coefficients and features of a throw. Does not panic for any trace.
    pub fn identify(&mut self, throw: &Throw, settings: &Settings) -> Identification {
        let rate_hz = throw.trace.sample_rate_hz();
        let mut found = if let Some(Resampled { trace, first, every, position_every }) = held::resampled(&throw.trace) {
            let mut found = self.identify_sampled(&Throw { trace, ..throw.clone() }, position_every, settings);
            // The reader of a result has the trace of the logger, not the resampled one.
            let first_s = first as f64 / rate_hz;
            let reason = match &mut found.outcome {
                Ok(estimate) => {
                    estimate.start_s += first_s;
                    estimate.end_s += first_s;
                    estimate.reason.as_mut()
                }
                Err(reason) => Some(reason),
            };
            if let Some(reason) = reason {
                reason.refer_to_logger(first_s, first, every);
            }
            found
        } else {
            self.identify_sampled(throw, 1.0, settings)
        };
        found.unused_fields = throw.unused_fields();
        if let Err(Rejection::TooSlow { rate_hz: sent_hz, .. }) = &mut found.outcome {
            *sent_hz = rate_hz;
        }
        found
    }

    /// Identifies a throw whose current has a new value in each sample, and whose position has a new value in one of
    /// `position_every` samples. Leaves `unused_fields` to [`Self::identify`].
    fn identify_sampled(&mut self, throw: &Throw, position_every: f64, settings: &Settings) -> Identification {
        let trace = &throw.trace;
        let Self { current, position, buffers } = self;
        let scratch = &mut buffers.scratch;
        let has_position = trace.has_position();
        let raw_interval_s = 1.0 / trace.sample_rate_hz();
        let factor = decimate::factor(trace.sample_rate_hz());
        let interval_s = raw_interval_s * factor as f64;
        let raw_current = missing::bridged(trace.current_a(), raw_interval_s);
        copy_finite(current, &raw_current);
        let at_rest = if factor > 1 { level_before(current, scratch) } else { 0.0 };
        let filter_hz = throw.possible_anti_alias_hz(trace.sample_rate_hz());
        let linear = settings.motor == Motor::PermanentMagnet && filter_hz.is_none();
        // A slower filter than that of the decimation rounds the foot of the current.
        let has_foot = filter_hz.is_none_or(|hz| hz * interval_s >= decimate::CUT_OFF_SHARE);
        let released = (factor > 1 && has_position && has_foot)
            .then(|| release::at_full_rate(current, raw_interval_s, linear, scratch))
            .flatten();
        decimate::decimate(current, factor, at_rest);
        if !has_position {
            position.clear();
            position.resize(current.len(), 0.0);
            let start = start_of_motor(current, interval_s, scratch);
            let mut movement = Movement::of(current, position, interval_s, start, scratch);
            movement.near_end = movement.motor_off.unwrap_or(current.len() - 1);
            let raw = (raw_current.as_ref(), raw_interval_s, factor);
            return identify_current(throw, &movement, raw, settings, scratch);
        }
        let raw_position = missing::bridged(trace.position_mm(), raw_interval_s);
        let raw_checks = damage::values(&raw_current, &raw_position, raw_interval_s)
            .and_then(|()| damage::clipping(&raw_current, raw_interval_s));
        copy_finite(position, &raw_position);
        let first = position[0];
        decimate::decimate(position, factor, first);

        let mut start = start_of_motor(current, interval_s, scratch);
        if let Some(foot) = start {
            let noise = second_difference_noise(&current[..=foot], scratch);
            if Level::of(&current[..=foot]).sd > HUM_FACTOR * noise {
                hum::remove(current, foot + 1, interval_s);
                start = start_of_motor(current, interval_s, scratch);
            }
        }
        let mut movement = Movement::of(current, position, interval_s, start, scratch);
        movement.measure_position_every(position_every / factor as f64, settings.position_noise_mm);
        let estimated = raw_checks
            .and_then(|()| usable(&movement, settings))
            .and_then(|()| completeness::course(&movement, settings, scratch))
            .and_then(|()| damage::sticking(&movement, Channel::Current, &raw_current, raw_interval_s, factor))
            .and_then(|()| damage::sticking(&movement, Channel::Position, &raw_position, raw_interval_s, factor))
            .and_then(|()| match settings.motor {
                Motor::ThreePhase => Err(Rejection::NoPosition {
                    sent: THREE_PHASE,
                    why: "its current does not show its torque".to_owned(),
                }),
                _ => buffers.estimate(throw, settings, &movement, factor, released),
            });
        let start = estimated.as_ref().ok().and_then(|(_, start)| *start);
        let outcome = estimated.map(|(estimate, _)| estimate);
        let moved = direction_moved(&movement, &outcome);
        let (start_delay_s, start_gain) = start.map(|start| (start.delay_s, start.gain)).unzip();
        let features = Features { start_delay_s, start_gain, ..features_of(throw, &movement, &outcome, settings) };
        let short_of_stroke_mm = settings.stroke_mm.filter(|stroke_mm| {
            outcome.is_ok() && completeness::is_short(movement.travel_mm, *stroke_mm, movement.position_noise_mm)
        });
        Identification {
            direction: moved.or(throw.direction),
            direction_contradicted: moved.zip(throw.direction).map(|(moved, named)| moved != named),
            features,
            outcome,
            unused_fields: None,
            short_of_stroke_mm,
        }
    }
}

impl Buffers {
    /// Checks the samples of a complete movement. `filter_hz` is the cut-off of the logger's anti-alias filter. If the
    /// start is disturbed, only the ratios may be known: then it returns the reason.
    fn check_samples(
        &mut self,
        trace: &Trace,
        settings: &Settings,
        movement: &Movement<'_>,
        factor: usize,
        filter_hz: Option<f64>,
    ) -> Result<Option<Rejection>, Rejection> {
        let interval_s = movement.interval_s;
        let filtered = filter_hz.is_some();
        let is_raw = factor == 1 && !filtered;
        let mut doubt = completeness::motor_start(movement).and_then(|()| completeness::early(movement)).err();
        let rise_samples = completeness::rise_samples(movement);
        if is_raw && rise_samples < MIN_RISE_SAMPLES {
            let undersampled = Rejection::Undersampled { interval_s, rise_samples };
            if !has_rate(interval_s, LEAST_RATIOS_HZ) {
                return Err(undersampled);
            }
            doubt = doubt.or(Some(undersampled));
        }
        // A disturbance of the start falsifies only the common scale; a later one falsifies the ratios too.
        let start_s = movement.start() as f64 * interval_s;
        let released_s = movement.released().unwrap_or(0) as f64 * interval_s;
        let inrush = start_s - interval_s..(start_s + INRUSH_S).max(released_s + START_S);
        doubt = doubt.or_else(|| missing::within(trace, inrush.start, inrush.end));
        let mut or_doubt = |verdict: Result<(), Rejection>| match verdict {
            Err(reason) if reason.is_between(start_s, start_s.max(released_s) + START_S) => {
                doubt.get_or_insert(reason);
                Ok(())
            }
            verdict => verdict,
        };
        or_doubt(damage::spikes(movement, Channel::Current, filtered))?;
        or_doubt(damage::spikes(movement, Channel::Position, filtered))?;
        if is_raw {
            let noise_a = second_difference_noise(&movement.current_a[..=movement.near_end], &mut self.scratch);
            or_doubt(damage::steps(movement, Channel::Current, noise_a, &mut self.scratch))?;
            if movement.position_every <= 1.0 {
                let noise_mm = movement.position_noise_mm;
                or_doubt(damage::steps(movement, Channel::Position, noise_mm, &mut self.scratch))?;
            }
            noise::noise_level(movement, noise_a, settings, &mut self.scratch)?;
        }
        Ok(doubt)
    }

    /// Estimates the coefficients of a complete movement, or their ratios if its start is unusable; and the start.
    fn estimate(
        &mut self,
        throw: &Throw,
        settings: &Settings,
        movement: &Movement<'_>,
        factor: usize,
        released: Option<f64>,
    ) -> Result<StartedEstimate, Rejection> {
        let rate_hz = 1.0 / movement.interval_s;
        let filter_hz = throw.possible_anti_alias_hz(rate_hz);
        noise::resolved(movement)?;
        let noisy = noise::plausible(movement, settings).err();
        let no_inrush = completeness::inrush(movement, &mut self.scratch);
        let doubt = self.check_samples(&throw.trace, settings, movement, factor, filter_hz)?;
        let filter_hz = filter_hz.or((factor > 1).then_some(decimate::CUT_OFF_SHARE * rate_hz));
        let start_doubt = self.window.cut(settings, movement, filter_hz, released)?;
        if settings.stroke_mm.is_none() && movement.ends_moving() && movement.ends_driven() {
            return Err(Rejection::EndMissing { travel_mm: movement.travel_mm });
        }
        let mut doubt = doubt.or(start_doubt);
        // In a slow recording, it is chance how much of the inrush the first samples have.
        let is_late = |reason: &mut Rejection| matches!(reason, Rejection::StartMissing { .. });
        if !has_rate(movement.interval_s, LEAST_RATIOS_HZ)
            && let Some(reason) = doubt.take_if(is_late)
        {
            return Err(reason);
        }
        let load = ratios::load(&self.window, &mut self.integrals, &mut self.scratch);
        let (full, fitted) = self.fit(settings, movement, load.as_ref());
        let ratios = load.and_then(|load| ratios::of(&self.window, &load, &self.integrals));
        if fitted.is_err() || doubt.is_some() {
            // A controlled drive has no inrush either, but its throws fit the model. A throw that
            // has no inrush and does not fit is rejected.
            no_inrush?;
        }
        let refuted = fitted.as_ref().is_err_and(Rejection::refutes_the_model);
        let reason = match (fitted, doubt) {
            (Ok((estimate, start)), None) => {
                let grade = if noisy.is_some() { Grade::Rough } else { Grade::Good };
                let running = ratios.as_ref().map(Ratios::running);
                return Ok((Estimate { grade, reason: noisy, running, ..estimate }, start));
            }
            (Err(reason), None) if !reason.leaves_ratios() => return Err(reason),
            (_, Some(reason)) | (Err(reason), None) => reason,
        };
        // The noise may be the reason that is stated. The start is missing nevertheless.
        let has_start = !matches!(reason, Rejection::StartMissing { .. });
        let reason = noisy.unwrap_or(reason);
        let ratios = ratios.ok_or_else(|| reason.clone())?;
        let estimate = ratios.estimate(&self.window, full, Some(reason.clone()));
        let is_known = |(ratio, sd): (f64, f64)| sd < LARGEST_RATIO_ERROR * ratio;
        let are_known = estimate.ratios().into_iter().zip(estimate.ratios_sd()).all(is_known);
        if !are_known && refuted {
            return Err(reason);
        }
        let start = has_start.then(|| start::find(&self.window, estimate.ratios(), &mut self.brakes.free));
        Ok((estimate, start.flatten()))
    }

    /// Fits the full model to the window. Returns the fit of its solution, `None` without one, and the estimate with the
    /// start of the movement, or the reason why the solution is not accepted.
    fn fit(
        &mut self,
        settings: &Settings,
        movement: &Movement<'_>,
        load: Option<&Load>,
    ) -> (Option<Fit>, Result<StartedEstimate, Rejection>) {
        let Self { window, workspace, brakes, .. } = self;
        // The model of equation (12): two poles, one input, three parameters.
        let model = Sriv::<2, 1, 3>::new([0]).map(|model| Sriv { tolerance: TOLERANCE, ..model });
        let found = model.and_then(|model| Some((model.identify(&window.problem(), workspace).ok()?, model)));
        let Some((solution, model)) = found else { return (None, Err(Rejection::Singular)) };
        let fit = Fit { pct: 100.0 * solution.fit, iterations: solution.iterations };
        (Some(fit), acceptance::estimate((&model, solution), window, load, movement, settings, workspace, brakes))
    }
}

/// Identifies a throw of a machine without a toe sensor. `raw`: the current before its decimation by a factor, with its
/// sampling interval \[s\].
fn identify_current(
    throw: &Throw,
    movement: &Movement<'_>,
    raw: (&[f64], f64, usize),
    settings: &Settings,
    scratch: &mut Vec<f64>,
) -> Identification {
    let (raw_current, raw_interval_s, factor) = raw;
    let values = damage::values(raw_current, &[], raw_interval_s);
    let mut features = if values.is_err() { Features::default() } else { current_only::features(movement) };
    let too_slow = features.duration_s.filter(|duration_s| *duration_s > LONGEST_RUN_S).map(|duration_s| {
        let (longest_s, rate_hz) = (completeness::LONGEST_MOVEMENT_S, 1.0 / movement.interval_s);
        Rejection::TooSlow { duration_s, longest_s, rate_hz }
    });
    if too_slow.is_some() {
        features = features.without_times();
    }
    let (trace, start_s) = (&throw.trace, movement.start() as f64 * movement.interval_s);
    let no_position = |why: String| Rejection::NoPosition { sent: sent_position(trace), why };
    let outcome = values
        .and_then(|()| missing::within(trace, start_s - movement.interval_s, start_s + INRUSH_S).map_or(Ok(()), Err))
        .and_then(|()| usable(movement, settings))
        .and_then(|()| too_slow.map_or(Ok(()), Err))
        .and_then(|()| completeness::begins_at_rest(movement, scratch))
        .and_then(|()| {
            let known = current_only::known(movement, throw, settings);
            // Without samples at rest the noise is that of differences, and in a slow recording these are the ripple.
            let shows_noise = movement.current.samples >= MIN_QUIET || known.is_ok();
            if shows_noise && completeness::motor(movement, scratch).is_err() {
                features = std::mem::take(&mut features).without(Channel::Current).without_times();
                return Err(no_position(current_only::NO_MOTOR.to_owned()));
            }
            let known = known.map_err(no_position)?;
            damage::clipping(raw_current, raw_interval_s)?;
            damage::sticking(movement, Channel::Current, raw_current, raw_interval_s, factor)?;
            noise::resolved(movement)?;
            let filtered = throw.possible_anti_alias_hz(1.0 / movement.interval_s).is_some();
            damage::spikes(movement, Channel::Current, filtered)?;
            completeness::motor_start(movement).map_err(|reason| no_position(reason.to_string()))?;
            if movement.ends_driven() {
                let Features { duration_s: driven_s, charge_as: driven_as, .. } = features;
                let (running_current_a, mean_current_a) = (None, None);
                let known = std::mem::take(&mut features).without_times();
                features = Features { running_current_a, mean_current_a, driven_s, driven_as, ..known };
                return Err(no_position(current_only::NOT_ENDED.to_owned()));
            }
            current_only::estimate(movement, throw.direction, known, settings, &mut features).map_err(no_position)
        });
    features = reliable(features, &outcome);
    add_supply(&mut features, throw);
    Identification {
        direction: throw.direction,
        direction_contradicted: None,
        features,
        outcome,
        unused_fields: None,
        short_of_stroke_mm: None,
    }
}

/// The features without those that a damaged channel shows.
fn reliable(features: Features, outcome: &Result<Estimate, Rejection>) -> Features {
    match outcome {
        // The start of the motor, from which all else follows, is unknown.
        Err(Rejection::ImplausibleValue { channel: Channel::Current, .. }) => Features::default(),
        Err(
            Rejection::Noisy { channel, .. }
            | Rejection::Stuck { channel, .. }
            | Rejection::NotFinite { channel, .. }
            | Rejection::ImplausibleValue { channel, .. },
        ) => features.without(*channel),
        Err(Rejection::WrongUnit { .. } | Rejection::PositionJump { .. }) => features.without(Channel::Position),
        // Without a motor there is no time from its start.
        Err(Rejection::NoCurrent { .. }) => features.without(Channel::Current).without_times(),
        Err(Rejection::TooSlow { .. }) => features.without_times(),
        Err(reason) if reason.never_arrived() => Features { duration_s: None, release_s: None, ..features },
        _ => features,
    }
}

/// The features of a throw with a toe position.
fn features_of(
    throw: &Throw,
    movement: &Movement<'_>,
    outcome: &Result<Estimate, Rejection>,
    settings: &Settings,
) -> Features {
    let mut features = reliable(movement.features(), outcome);
    add_supply(&mut features, throw);
    let is_damaged = outcome.as_ref().is_err_and(|reason| {
        let is_false = matches!(reason, Rejection::PositionJump { .. } | Rejection::TooSlow { .. });
        is_false || reason.never_arrived() || reason.faulty_channel().is_some()
    });
    if !is_damaged
        && settings.motor != Motor::ThreePhase
        && movement.sign != 0.0
        && has_rate(movement.interval_s, LEAST_RATE_HZ)
        && let Some(armature) = Armature::of(movement, settings.radians_per_mm())
    {
        armature.add_constants(&mut features, throw.possible_supply_v(), settings.motor);
    }
    features
}

/// Adds supply voltage and energy to the features. The voltage is that published, also if it is impossible, which the
/// diagnosis reports.
fn add_supply(features: &mut Features, throw: &Throw) {
    features.supply_v = throw.supply_v;
    features.energy_j = throw.possible_supply_v().zip(features.charge_as).map(|(volts, charge_as)| volts * charge_as);
}

/// Why a throw of a three-phase motor has no coefficients, as a clause for the text of the rejection.
const THREE_PHASE: &str = "the motor is configured as three-phase";

/// Describes the content of `position_mm` in a message without a toe position, for the text of the rejection.
fn sent_position(trace: &Trace) -> &'static str {
    let position = trace.position_mm();
    if position.iter().all(|x| *x == 0.0) {
        "position_mm is 0 in all samples, as without a toe sensor"
    } else if position.contains(&0.0) {
        "position_mm is 0 or missing in all samples, as without a toe sensor"
    } else {
        "there is no toe position (position_mm is absent, or no sample of it was measured)"
    }
}

/// Rejects settings out of range, and a trace that is too short.
fn usable(movement: &Movement<'_>, settings: &Settings) -> Result<(), Rejection> {
    settings.check_ranges().map_err(|error| Rejection::BadSettings { problem: error.to_string() })?;
    long_enough(movement.current_a.len(), movement.interval_s)
}

/// Direction of the toe's movement; `None` without movement, or if the position is too unreliable to show it.
fn direction_moved(movement: &Movement<'_>, outcome: &Result<Estimate, Rejection>) -> Option<Direction> {
    let untrusted = matches!(
        outcome,
        Err(Rejection::NoMovement
            | Rejection::MovedBackwards { returned: true, .. }
            | Rejection::NotFinite { channel: Channel::Position, .. }
            | Rejection::ImplausibleValue { channel: Channel::Position, .. }
            | Rejection::Noisy { channel: Channel::Position, .. }
            | Rejection::PositionJump { .. })
    );
    let moved = if movement.sign > 0.0 { Direction::NormalToReverse } else { Direction::ReverseToNormal };
    (!untrusted && movement.sign != 0.0).then_some(moved)
}

/// Copies a channel. A value that is not finite is replaced by the previous value, so that features can be computed.
pub(super) fn copy_finite(to: &mut Vec<f64>, from: &[f64]) {
    to.clear();
    if every(from.iter().map(|v| v.is_finite())) {
        return to.extend_from_slice(from);
    }
    let mut last = from.iter().copied().find(|v| v.is_finite()).unwrap_or(0.0);
    to.extend(from.iter().map(|v| {
        if v.is_finite() {
            last = *v;
        }
        last
    }));
}

/// Largest distance of the first current from 0, or from the current at the end of the trace, that counts as rest, as
/// share of the peak. A trace with a larger first value began during the inrush.
const REST_SHARE: f64 = 0.05;
/// Number of samples for the current at the end of a trace.
const LAST_SAMPLES: usize = 20;

/// The current before the trace \[A\], for the initial state of the decimation filter: the first value if it may be the
/// current at rest, else 0. A sensor with an offset shows it at the end too.
fn level_before(current: &[f64], scratch: &mut Vec<f64>) -> f64 {
    let last = median_of(&current[current.len().saturating_sub(LAST_SAMPLES)..], scratch);
    let largest = REST_SHARE * peak(current, 0.0);
    let is_rest = [0.0, last].iter().any(|rest| (current[0] - rest).abs() < largest);
    if is_rest { current[0] } else { 0.0 }
}
