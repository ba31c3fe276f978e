//! Effects of a throw on the monitor of its machine. A throw with an estimate changes baseline and drift alarms, a
//! throw without one changes gauges and features. Both change the operational alarms.

use std::{borrow::Cow, mem};

use nalgebra::Vector3;

use super::{MachineMonitor, to_micros};
use crate::{
    diagnose::{
        AlarmEvent, Cause, Common, Observation, SensorChannel, Settings, Verdict,
        alarm::{Alarms, Rule, RuleResult, Step, rule_result},
        baseline::{BaselineRecord, Suspicion},
        drift::{Drift, KNOWN_AFTER, Known, LatestThrow, Origin},
        gauges::{judge_end, judge_travel},
        observation::{Evaluated, Unusable},
        operation::{Implausible, site},
        statistics::percent,
        text,
        track::{Courses, Tracks},
    },
    estimate::{Features, Motor, Rejection},
    throw::{Channel, Direction, POSSIBLE_SUPPLY_V},
};

impl MachineMonitor {
    /// Applies a throw, evaluated or not. Throws must come in the order in which the machine made them.
    pub fn observe(&mut self, observation: &Observation, settings: &Settings) -> Verdict {
        self.observe_beside(observation, &Common::default(), settings)
    }

    /// Takes note of a throw that was made before the last new baseline or the last end of maintenance. It shows
    /// nothing about the machine as it is now.
    pub fn observe_outdated(&mut self, observation: &Observation, settings: &Settings) -> Verdict {
        self.order += 1;
        let events = self.alarms.take_events();
        Verdict { events, ..self.verdict(observation, settings) }
    }

    /// Like [`Self::observe`], but subtracts the `common` change of the other machines of the site first.
    pub fn observe_beside(&mut self, observation: &Observation, common: &Common, settings: &Settings) -> Verdict {
        self.order += 1;
        let features = &observation.features;
        let reversed = observation.direction_contradicted.is_some_and(|now| self.operation.on_direction(now, features));
        let at = to_micros(observation.started_at);
        let temperature = self.thermometer.read(observation.temperature_c, at);
        let has_temperature = observation.temperature_c.is_some();
        let was_identified = observation.outcome.is_some();
        let observation = self.in_context(observation, reversed, temperature.celsius);
        let observation = &*observation;
        // Taken out of the monitor: the step borrows both while the rest of the monitor changes.
        let (name, mut alarms) = (mem::take(&mut self.name), mem::take(&mut self.alarms));
        let step = &mut Step { alarms: &mut alarms, name: &name, at, throw: Some(&observation.throw), settings };
        // A machine that lost its toe sensor cannot be compared with its baseline.
        let without_position = self.has_lost_position(observation);
        if observation.has_result() {
            let is_without = observation.is_without_position();
            self.has_position |= !is_without && !self.had_no_position;
            self.had_no_position |= is_without;
        }
        self.learn_neutral(observation);
        let mut evaluated = Evaluated::of(observation)
            .filter(|_| !self.differs_in_position(observation))
            .map(|throw| self.neutral.corrected(throw))
            .map(|throw| match self.instruments.gauges.shift(throw.direction, features) {
                Some(shift) => throw.without_shift(shift),
                None => throw,
            })
            .map(|throw| self.tracks.compared(throw));
        let residual = evaluated.as_ref().and_then(|throw| self.tracks.residual(throw));
        if self.instruments.learn_gain() {
            let first = self.order.saturating_sub(KNOWN_AFTER.into());
            self.tracks.take_out(|of_ratios| self.instruments.of_known_gain(of_ratios), first);
            self.drift.forget_history();
        }
        if let Some(throw) = &mut evaluated {
            let of_sensor = self.instruments.of_known_gain(throw.ratios_only);
            let residual = residual.map(|residual| residual - of_sensor);
            if self.maintenance.is_none()
                && let Some((residual, of_one_throw)) = residual.as_ref().zip(self.tracks.of_one_throw(throw.direction))
            {
                self.trail.push(at, residual, &of_one_throw);
            }
            let shared = residual.map_or_else(Vector3::zeros, |residual| site::shared_part(&residual, common));
            self.drift.share(&shared, settings);
            throw.log = (Vector3::from(throw.log) - shared - of_sensor).into();
        }
        let mut baselines_taken = Vec::new();
        if self.maintenance.is_none() {
            let supply_v = observation.features.supply_v;
            let impossible_v = supply_v.filter(|volts| !POSSIBLE_SUPPLY_V.contains(volts));
            let voltage = (supply_v.is_some(), impossible_v.map(Implausible::Supply));
            self.operation.on_sensors([(has_temperature, temperature.implausible), voltage], step);
            let unusable = observation.unusable();
            let unusable = unusable.or(without_position.then_some(Unusable::Missing));
            let unusable = unusable.or(reversed.then_some(Unusable::Reversed));
            // A trace that was not read, or withheld, shows no sensor.
            if was_identified || unusable.is_some() {
                self.operation.on_channel(unusable, step);
            }
            let taken = self.observe_in_service(observation, evaluated.as_ref(), step);
            baselines_taken = taken.into_iter().map(|record| self.neutral.as_estimated(record)).collect();
        }
        (self.name, self.alarms) = (name, alarms);
        let change_pct = residual.map(|residual| residual.map(percent).into());
        let events = self.alarms.take_events();
        Verdict { change_pct, baselines_taken, events, ..self.verdict(observation, settings) }
    }

    /// The throw as the earlier throws of the machine show it: `reversed` if its position is wrong, with the temperature
    /// `celsius`, its real direction, and without what a throw that is no whole movement does not show.
    fn in_context<'a>(
        &mut self,
        observation: &'a Observation,
        reversed: bool,
        celsius: Option<f64>,
    ) -> Cow<'a, Observation> {
        let mut observation = Cow::Borrowed(observation);
        if reversed {
            // The position is wrong, so neither the estimate nor the direction is known.
            let observation = observation.to_mut();
            observation.direction = None;
            observation.outcome.take_if(|outcome| outcome.is_ok());
        }
        if self.follow_names(&observation) {
            let observation = observation.to_mut();
            observation.direction = observation.direction.map(Direction::other);
            if observation.estimate().is_some() {
                // The coefficients are those of a movement in the other direction.
                let why = "the logger has probably exchanged the names of the directions".to_owned();
                observation.outcome = Some(Err(Rejection::NoPosition { sent: "", why }));
            }
        }
        if self.runs_on_at_its_end(&observation) {
            // The points arrived, and only detection or switch-off failed. The current is not that of the movement
            // alone.
            let observation = observation.to_mut();
            observation.outcome = None;
            let Features { running_current_a, mean_current_a, charge_as, energy_j, .. } = &mut observation.features;
            for of_current in [running_current_a, mean_current_a, charge_as, energy_j] {
                *of_current = None;
            }
        }
        let short = self.short_of_usual_mm(&observation);
        if let Some((travel_mm, stroke_mm)) = short {
            observation.to_mut().outcome = Some(Err(Rejection::Incomplete { travel_mm, stroke_mm }));
        }
        if self.operation.begins_open(&observation, short.is_some()) {
            // Its travel and duration are those of a part of the stroke, which would look like a fault of a sensor.
            let observation = observation.to_mut();
            (observation.began_open, observation.short_of_stroke_mm) = (true, None);
            observation.outcome.take_if(|outcome| outcome.is_ok());
        }
        if observation.temperature_c != celsius {
            observation.to_mut().temperature_c = celsius;
        }
        if let Some(unusual_run_s) = self.unusual_run_s(&observation) {
            let observation = observation.to_mut();
            observation.unusual_run_s = Some(unusual_run_s);
            observation.outcome.take_if(|outcome| outcome.is_ok());
        }
        observation
    }

    /// Travel of a throw that ends short of its usual end, and the usual travel \[mm\]: a single such throw needs no
    /// configured stroke.
    fn short_of_usual_mm(&self, observation: &Observation) -> Option<(f64, f64)> {
        let Observation { direction, ref features, .. } = *observation;
        let is_judged = observation.has_result() && !observation.is_without_position();
        let usual_mm = self.instruments.gauges.longer_usual_travel_mm(direction.filter(|_| is_judged)?, features)?;
        Some((features.travel_mm?, usual_mm))
    }

    /// Whether the toe of an obstructed throw is where it always stops: its stroke is not configured.
    fn runs_on_at_its_end(&self, observation: &Observation) -> bool {
        let Observation { direction: Some(direction), ref features, .. } = *observation else { return false };
        matches!(observation.rejection(), Some(Rejection::Obstructed { .. }))
            && features.travel_mm.is_some_and(|mm| self.instruments.gauges.is_usual_travel(direction, mm))
    }

    /// Running time of the motor in this throw and its usual time \[s\], if they differ so much that the points may not
    /// have closed: an obstruction or a missing detection lets the motor run until its time-out, a limit switch or an
    /// overload trip stops it early. `None` if a toe position shows the movement.
    fn unusual_run_s(&self, observation: &Observation) -> Option<[f64; 2]> {
        let Observation { direction, ref features, temperature_c, .. } = *observation;
        let direction = direction.filter(|_| !self.has_position && observation.is_without_position())?;
        if features.driven_s.is_none() {
            return self.instruments.gauges.unusual_run_s(direction, features, temperature_c);
        }
        let least = Features { duration_s: features.driven_s, charge_as: features.driven_as, ..features.clone() };
        let unusual = self.instruments.gauges.unusual_run_s(direction, &least, temperature_c);
        unusual.filter(|[at_least_s, usual_s]| at_least_s > usual_s)
    }

    /// Applies the direction that the logger names. Returns whether it has exchanged the names of the directions, as the
    /// throws of a machine without a toe sensor show.
    fn follow_names(&mut self, observation: &Observation) -> bool {
        if self.has_position {
            self.operation.on_position();
        } else if let Some(direction) = observation.direction.filter(|_| observation.is_without_position()) {
            let Observation { features, temperature_c, .. } = observation;
            let of_other = self.instruments.gauges.is_of_other(direction, features, *temperature_c);
            self.operation.on_likeness(direction, of_other);
        }
        self.operation.is_exchanged()
    }

    /// Whether the throw has no toe position, and the machine had one before.
    fn has_lost_position(&self, observation: &Observation) -> bool {
        self.has_position && observation.is_without_position()
    }

    /// Whether the throw has a toe position, and the earlier throws of the machine had none.
    pub(super) fn has_new_position(&self, observation: &Observation) -> bool {
        let is_known_without = self.had_no_position && !self.has_position;
        is_known_without && observation.has_result() && !observation.is_without_position()
    }

    /// Whether only the throw or only its baseline has a toe position. Without one, the duration ends with the motor,
    /// which often runs on after the arrival of the toe.
    fn differs_in_position(&self, observation: &Observation) -> bool {
        self.has_lost_position(observation) || self.has_new_position(observation)
    }

    /// The verdict on a throw without effect: the present of the machine.
    fn verdict(&self, observation: &Observation, settings: &Settings) -> Verdict {
        let baseline = observation.direction.and_then(|direction| {
            if !observation.has_features_only() {
                return Some(self.baseline_progress(direction, settings));
            }
            // A machine that has only a current sensor learns its features.
            (!self.tracks.any_baseline()).then(|| self.instruments.gauges.progress(direction))
        });
        let has_trend = self.tracks.trend().is_some();
        Verdict { present: self.present(), blind: self.blind, has_trend, baseline, ..Verdict::default() }
    }

    /// Learns from the first throws whether the neutral position differs from the configured one. If it does, the
    /// baseline begins again after these throws.
    fn learn_neutral(&mut self, observation: &Observation) {
        if self.tracks.any_baseline() {
            self.neutral.settle();
        } else if self.maintenance.is_none() && self.neutral.learn(observation) {
            self.tracks = Tracks::default();
        }
    }

    /// Applies a throw outside maintenance. Returns the baselines that became usable or complete.
    fn observe_in_service(
        &mut self,
        observation: &Observation,
        evaluated: Option<&Evaluated>,
        step: &mut Step,
    ) -> Vec<BaselineRecord> {
        let Observation { direction, ref features, .. } = *observation;
        self.operation.on_throw(observation, &self.instruments.gauges, step);
        let mut baselines_taken = Vec::new();
        let has_gauges = if let Some(throw) = evaluated {
            let suspicious = self.drift.is_suspicious(step.alarms) || self.instruments.known_gain.is_some();
            self.instruments.gauges.push(throw.direction, features, throw.temperature_c, suspicious);
            baselines_taken = self.observe_evaluated(throw, step);
            true
        } else {
            if self.drift.on_unjudged() {
                self.blind = None;
            }
            self.observe_features(observation, step)
        };
        if has_gauges {
            for sensor in [Channel::Current, Channel::Position] {
                self.instruments.judge_offset(sensor, step);
            }
        }
        // No estimate shows the end of the stroke. This rule comes before that of the features, which names no place.
        if has_gauges && features.end_rise_a.is_some() {
            judge_end(&mut self.end, &self.instruments.gauges, step).apply(Rule::End, step);
        }
        if let (Some(direction), Some(run_on_s), true) = (direction, features.run_on_s, observation.is_whole()) {
            self.operation.run_on.judge(direction, run_on_s, step).apply(Rule::RunOn, step);
        }
        // Ratios show fewer faults than coefficients do, so a machine with ratios keeps the feature rule.
        let is_judged = evaluated.is_some_and(|throw| self.tracks.has_coefficients(throw.direction));
        if is_judged {
            judge_travel(&mut self.travel, &self.instruments.gauges, step).apply(Rule::Travel, step);
        }
        let watched = self.watch_features(observation, is_judged, step);
        rule_result::withdraw_explained(step);
        let is_monitored = evaluated.is_some() || watched;
        // The alarm about its running time says what is known of such a throw.
        if observation.unusual_run_s.is_none() {
            self.operation.on_evaluation(is_monitored, observation, self.blind.as_ref(), step);
        }
        let is_comparable = observation.covers_stroke() && !self.differs_in_position(observation);
        if let (Some(direction), Some(duration_s), true) = (direction, features.duration_s, is_comparable)
            && let Some(normal_s) = self.tracks.duration_s(direction)
        {
            let longer_pct = 100.0 * (duration_s / normal_s - 1.0);
            let explained = step.alarms.active().any(|event| may_lengthen(event, step.alarms));
            let longer = (longer_pct, !observation.is_without_position());
            // The duration of a cut-off recording is a lower bound.
            if observation.is_whole() || longer_pct > step.settings.slow_throw_pct {
                self.operation.on_duration(longer, direction, explained, step);
            }
        }
        baselines_taken
    }

    /// Adds a throw without an estimate to the gauges. A rejected throw adds only the gauges that need no model. In a
    /// direction without a baseline, the normal values are learned from these throws too. If they were not, a change
    /// during a long row of rejected throws would become normal unseen. Returns whether the throw was added.
    fn observe_features(&mut self, observation: &Observation, step: &mut Step) -> bool {
        let all = &observation.features;
        let without_position = observation.is_without_position();
        let is_usable = observation.is_whole() && observation.faulty_sensor().is_none();
        let Some(direction) = observation.direction.filter(|_| is_usable) else { return false };
        let features = if self.differs_in_position(observation) {
            without_duration(all)
        } else if observation.is_current_only() {
            all.clone()
        } else {
            Features {
                duration_s: all.duration_s,
                supply_v: all.supply_v,
                peak_current_a: all.peak_current_a,
                running_current_a: all.running_current_a,
                charge_as: all.charge_as,
                quiet_current_a: all.quiet_current_a,
                end_rise_a: all.end_rise_a,
                ..Features::default()
            }
        };
        let has_baseline = self.tracks.of_one_throw(direction).is_some();
        let unusual = self.drift.is_suspicious(step.alarms) || !without_position && has_baseline;
        self.instruments.gauges.push(direction, &features, observation.temperature_c, unusual);
        let circuit = self.instruments.gauges.circuit();
        self.instruments.judge_supply(None, circuit, step);
        true
    }

    /// Watches the features of a throw whose coefficients cannot be judged: it has no estimate, or there is no baseline
    /// yet, as on a machine whose every throw is rough. Returns whether the throw counts as monitored.
    fn watch_features(&mut self, observation: &Observation, is_judged: bool, step: &mut Step) -> bool {
        // The rule that raised an alarm also clears it: with a new baseline, the drift rule needs a far larger change.
        if is_judged && step.alarms.owned_by(Rule::Features).is_none() {
            self.features.on_estimate(observation.direction).apply(Rule::Features, step);
            return true;
        }
        let Some(direction) = observation.direction.filter(|_| observation.is_whole()) else { return false };
        let timed = &observation.features;
        let untimed = self.differs_in_position(observation).then(|| without_duration(timed));
        let features = (untimed.as_ref().unwrap_or(timed), observation.temperature_c);
        let found = self.features.on_features(direction, features, &self.instruments.gauges, step);
        // How much a known resistance slows a series-wound motor is unknown, so its alarm explains the features.
        let is_of_circuit = step.alarms.rule(Cause::Supply) == Some(Rule::Circuit);
        let is_explained = is_of_circuit && self.instruments.gauges.is_series_with_resistance();
        let sensor = step.alarms.distorting_sensor();
        if sensor.is_some_and(|sensor| self.features.is_explained_by(sensor)) {
            if let Some(unnamed) = step.alarms.owned_by(Rule::Features) {
                step.clear(unnamed, |name| text::explained(name, Cause::Sensor));
            }
        } else {
            let found = if is_explained { RuleResult::Nothing } else { found };
            found.apply(Rule::Features, step);
        }
        // A recording that is too slow may give an estimate by chance.
        let is_of_features = observation.is_current_only() && !self.has_lost_position(observation)
            || observation.is_undersampled() && !self.tracks.any_baseline();
        let has_features = is_of_features && timed.running_current_a.is_some();
        let may_show_end = timed.running_current_a.is_some() || timed.duration_s.is_some();
        is_judged || step.alarms.owned_by(Rule::Features).is_some() && may_show_end || has_features
    }

    /// Applies a throw with an estimate. Returns the baselines that became usable or complete.
    fn observe_evaluated(&mut self, throw: &Evaluated, step: &mut Step) -> Vec<BaselineRecord> {
        let settings = step.settings;
        let departure = self.tracks.departure(throw, settings);
        let suspicion = self.drift.suspicion(None, step.alarms);
        let residual = self.tracks.push(throw, self.order, suspicion, settings);
        let judged = residual.map(|residual| {
            let is_series = self.parameters.is_some_and(|parameters| parameters.motor == Motor::Series);
            let known = Known { is_series, ..self.drift.known(step.alarms, &self.instruments.gauges) };
            let heavy_tails = self.drift.intermittent.has_heavy_tails();
            let mut drift = self.tracks.drift(throw.direction, heavy_tails, &known, settings);
            drift.origin = self.instruments.origin(&drift, settings);
            let (tracks, gauges) = (&self.tracks, &self.instruments.gauges);
            let courses = Courses::new(tracks, drift.temperature_sd(), self.order);
            let latest = LatestThrow {
                drift: &drift,
                order: self.order,
                at: step.at,
                tracks,
                courses: &courses,
                gauges,
                settings,
            };
            self.drift.judge(latest, &residual, step);
            self.instruments.judge(&drift, step);
            (drift, courses)
        });
        let drift = judged.as_ref().map(|(drift, _)| drift);
        let origin = drift.map(|drift| drift.origin);
        let is_instrument = origin.is_some_and(Origin::is_instrument);
        let explained = drift.filter(|drift| drift.origin == Origin::Supply).map(Drift::matters);
        // A sensor explains a changed resistance only if the drift that it may explain is above its limit.
        let may_be_sensor = |drift: &&Drift| matches!(drift.origin, Origin::Either { .. }) && drift.matters();
        let alike = drift.filter(may_be_sensor).and_then(|drift| drift.strongest);
        let circuit = self.instruments.gauges.circuit();
        let circuit = circuit.map(|found| found.beside(alike.map_or(0.0, |alike| alike.window.mean.x)));
        self.instruments.judge_supply(explained, circuit, step);
        // The supply changes the inrush current, which accelerates the machine.
        let start_explained = is_instrument || step.alarms.is_active(Cause::Supply);
        self.start.judge(&self.instruments.gauges, start_explained, step).apply(Rule::Start, step);
        match departure {
            Some(departure) => self.drift.judge_departure(&departure, is_instrument, step),
            None => self.drift.on_unknown_departure(step),
        }
        if let Some((drift, courses)) = &judged {
            let (tracks, gauges) = (&self.tracks, &self.instruments.gauges);
            let latest = LatestThrow { drift, order: self.order, at: step.at, tracks, courses, gauges, settings };
            self.drift.renew(latest, step.alarms);
        }
        let by_temperature = drift.and_then(|drift| drift.hidden);
        self.blind = by_temperature.or_else(|| self.tracks.hidden_by_scatter(settings));
        // A baseline must not learn the values of a faulty sensor.
        let is_known = self.instruments.known_gain.is_some();
        let suspicion = if is_known { Suspicion::Alarmed } else { self.drift.suspicion(drift, step.alarms) };
        let taken = self.tracks.learn(throw, self.order, step.at, suspicion, settings);
        if !taken.is_empty() {
            self.drift.forget_history();
        }
        taken
    }
}

/// The features of a throw that [differs in its position](MachineMonitor::differs_in_position) from earlier ones: its
/// duration, and the back-EMF, which is from it, cannot be compared.
fn without_duration(all: &Features) -> Features {
    Features { duration_s: None, back_emf_v_s_per_rad: None, ..all.clone() }
}

/// Whether the alarm may explain that a throw takes longer.
fn may_lengthen(event: &AlarmEvent, alarms: &Alarms) -> bool {
    let is_up = event.change_pct.is_none_or(|pct| pct > 0.0);
    match event.cause {
        Cause::Kt => event.change_pct.is_none_or(|pct| pct < 0.0),
        Cause::Friction | Cause::Stiffness | Cause::Inertia => is_up,
        Cause::Unattributed => {
            let rule = alarms.rule(Cause::Unattributed);
            !matches!(rule, Some(Rule::Start | Rule::Travel | Rule::RunOn | Rule::Stroke))
        }
        Cause::Sensor => alarms.distorting_sensor() == Some(SensorChannel::Clock),
        cause => cause == Cause::Supply,
    }
}
