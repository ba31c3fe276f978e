//! The drift alarms of a machine: their events, and the present drifts.

use std::{mem, ops::Range};

use jiff::Timestamp;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{
    AlarmEvidence, Attribution, Claim, Condition, Course, Departure, Drift, During, Explanation, History, Intermittent,
    Known, LEVELS_FOLLOW, LatestThrow, LimitForecast, MotorEvidence, Naming, Origin, TOO_CLOSE_PATIENCE, Transition,
    Window, explained, friction_of_sound_motor,
};
use crate::{
    diagnose::{
        AlarmEvent, Cause, Drifting, RunnerUp, Settings, Severity,
        alarm::{Alarms, Rule, RuleResult, Step},
        baseline::Suspicion,
        gauges::Gauges,
        statistics::{LONGEST_WINDOW, Level, percent, to_f32},
        text,
    },
    throw::{Direction, ThrowRef},
};

/// Part of the limit of T from which a drift is suspected. Its throws are evidence, and are not added to a baseline.
const SUSPECTED_FROM: f64 = 0.5;
/// Factor on [`SUSPECTED_FROM`] and [`FORGOTTEN_BELOW`] while a baseline fills: its few throws make the limit high, and
/// a fault must not be learned.
const SUSPECTED_EARLIER: f64 = 0.8;
/// Part of the limit of T below which a suspicion ends.
const FORGOTTEN_BELOW: f64 = 0.25;

/// Rise of the friction when wet rails dry, as a logarithm: rain lowers the friction by hardly more than 30 %.
const DRYING: Range<f64> = 0.0..0.36;
/// Number of consecutive throws that must show that a drift is in one direction only, before its alarm says so: three
/// throws of each direction.
const ONE_SIDED_THROWS: u8 = 6;

/// Least present size of a part that is named, in standard deviations, so that its 95 % interval excludes 0.
const SHOWN_SD: f64 = 1.96;
/// The same for a part beside another one, whose misfit it may be.
const SHOWN_BESIDE_SD: f64 = 3.0;
/// Part of the limit from which the present size of a drift may be above it, as the size scatters.
const PRESENT_PART: f64 = 0.75;

/// Plausible range of the size from the course as part of the size without the error of the model.
const MODEL_ERROR: Range<f64> = 0.5..2.0;

/// Part of a warning limit from which a change that the machine shares with its site is reported.
const SHARED_FROM: f64 = 0.5;

/// Rules about the end of the stroke and the time after it, which do not change the coefficients.
const OF_END: [Rule; 2] = [Rule::End, Rule::RunOn];

/// The first throw of a suspected drift.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Onset {
    pub(crate) first: ThrowRef,
    /// Number of the throw among those of the machine.
    pub(crate) order: u64,
}

/// State of the drift alarms between throws.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct DriftAlarms {
    pub(crate) history: History,
    pub(crate) onset: Option<Onset>,
    /// For each of [`Cause::DRIFTS`].
    pub(crate) conditions: [Condition; 5],
    /// The drifts with an active alarm, with their present size; named parts first, then the most severe.
    pub(crate) now: Vec<Drifting>,
    /// Number of throws since the last one that was judged.
    pub(crate) unjudged: u32,
    pub(crate) intermittent: Intermittent,
    /// Time and number of the first throw of a fall of friction that still lasts.
    pub(crate) fallen: Option<(Timestamp, u64)>,
    /// Whether the two directions had opposite changes, and since then a drift that they do not share.
    pub(crate) opposite: bool,
    /// A slow change of the friction \[%\] that raises no alarm, as it may come from the season.
    pub(crate) season_pct: Option<f64>,
    /// The change of (ln b0, ln a1, ln a0) at the last throw that the other machines of the site have too; it is
    /// subtracted from the throw.
    pub(crate) shared: [f32; 3],
    /// For each cause, the number of consecutive throws in which its drift was known to be in one direction only.
    pub(crate) one_sided: [u8; 5],
}

impl DriftAlarms {
    /// Applies the latest throw, with its residual. After all rules, [`Self::renew`] must follow.
    pub(crate) fn judge(&mut self, latest: LatestThrow, residual: &Vector3<f64>, step: &mut Step) {
        self.unjudged = 0;
        self.history.push(residual, latest.order);
        self.follow_onset(latest, step);
        let LatestThrow { drift, settings, .. } = latest;
        self.opposite = drift.is_opposite() || self.opposite && drift.matters() && !drift.is_in_both(settings);
        let weather = self.beside_weather(latest);
        for (index, cause) in Cause::DRIFTS.into_iter().enumerate() {
            let active = severity_of_drift(cause, step.alarms);
            let evidence = self.evidence(cause, weather, active, latest, step.alarms);
            let direction = if evidence.claim == Claim::Named { latest.direction(cause) } else { None };
            let transition = self.conditions[index].step(evidence, active, latest.settings);
            let becomes_one_sided = self.becomes_one_sided(index, direction, step.alarms);
            self.apply(cause, transition, becomes_one_sided, latest, step);
        }
    }

    /// The evidence of the latest throw for an alarm about `cause`. `weather`: the strongest claim beside the weather;
    /// `active`: the severity of an active alarm about a lasting change of this cause.
    fn evidence(
        &self,
        cause: Cause,
        weather: Claim,
        active: Option<Severity>,
        latest: LatestThrow,
        alarms: &Alarms,
    ) -> AlarmEvidence {
        let LatestThrow { drift, settings, .. } = latest;
        let raised_pct = alarms.find_active(cause).and_then(|alarm| alarm.last.change_pct);
        // That of a drift without a name is the size of one of its parts.
        let sense = raised_pct.filter(|_| cause != Cause::Unattributed).unwrap_or_default();
        let mut evidence = drift.evidence(cause, sense, settings);
        evidence.claim = evidence.claim.min(self.new_part(cause, latest).unwrap_or(weather));
        if self.opposite && cause == Cause::Stiffness {
            // Later the throws of one direction may give no estimate, and those of the other look like a spring.
            (evidence.claim, evidence.certain_size) = (evidence.claim.min(Claim::Counts), 0.0);
        }
        let names_spring = drift.attribution.as_ref().is_some_and(|found| found.cause() == Cause::Stiffness);
        evidence.other_name &= !(self.opposite && cause == Cause::Unattributed && names_spring);
        // A change that may be the weather's gets no alarm of its own, so it must not end another one.
        evidence.other_name &= weather == Claim::Named || drift.origin.is_instrument() || drift.is_alarmed();
        if self.intermittent.is_rising() || alarms.rule(cause) == Some(Rule::Intermittent) {
            // Two faulty throws in a row are no drift yet, so an alarm waits longer.
            evidence.patience += LEVELS_FOLLOW;
        }
        evidence.unchecked = alarms.find_active(cause).is_some_and(|alarm| alarm.is_unchecked);
        let is_of_cause = drift.attribution.as_ref().is_some_and(|attribution| attribution.cause() == cause);
        let now = is_of_cause.then(|| latest.named_part(latest.direction(cause), &self.history)).flatten();
        let now = now.map(|(now, _)| (now, now.relevance(settings)));
        if let Some((now, size)) = now {
            // The window may contain throws with a larger drift, or with one of the opposite sign.
            evidence.certain_size = evidence.certain_size.min(size / PRESENT_PART);
            // Nor may a critical alarm be about a size whose interval contains 0.
            if now.size.abs() < SHOWN_SD * now.size_sd {
                evidence.certain_size = 0.0;
            }
        }
        if let (Claim::Named, Some((now, size))) = (evidence.claim, now) {
            evidence.turned = size > 1.0 && active.is_some() && raised_pct.is_some_and(|pct| pct * now.size < 0.0);
            let least = 1.0 - settings.deadband_pct / 100.0;
            // A part is named only if its change is significant.
            let has_changed =
                now.cause == Cause::Kt && drift.attribution.as_ref().is_some_and(Attribution::has_changed_motor);
            let is_of_one = drift.attribution.as_ref().is_some_and(Attribution::is_of_one);
            let least_sd = if is_of_one { SHOWN_SD } else { SHOWN_BESIDE_SD };
            let is_shown = active.is_some() || has_changed || now.size.abs() > least_sd * now.size_sd;
            evidence.claim = if size > least && is_shown { Claim::Named } else { Claim::Counts };
        }
        let is_open = |cause| alarms.find_active(cause).is_some();
        let attribution = drift.attribution.as_ref().filter(|_| active.is_none());
        let beside = attribution.and_then(|found| found.beside_open(is_open));
        if beside.is_some_and(|part| part.size.abs() < SHOWN_BESIDE_SD * part.size_sd) {
            evidence.claim = evidence.claim.min(Claim::Counts);
        }
        let is_intermittent = alarms.rule(cause) == Some(Rule::Intermittent) && !self.intermittent.is_over();
        if is_intermittent && evidence.certain_size <= settings.critical_factor {
            // Its text says more than a mean of faulty and sound throws.
            evidence.claim = evidence.claim.min(Claim::Counts);
        }
        evidence
    }

    /// Applies the transition of a condition to the alarm about `cause`. `becomes_one_sided`: see
    /// [`Self::becomes_one_sided`].
    fn apply(
        &self,
        cause: Cause,
        transition: Transition,
        becomes_one_sided: Option<Severity>,
        latest: LatestThrow,
        step: &mut Step,
    ) {
        let name = step.name;
        let severity = match transition {
            Transition::Stay => becomes_one_sided,
            Transition::Raise(severity) | Transition::Turn(severity) => Some(severity),
            Transition::Escalate => Some(Severity::Critical),
            _ => None,
        };
        let event = severity.and_then(|severity| self.event(cause, severity, latest, step));
        match (transition, event) {
            (Transition::Stay, Some(event)) => {
                let text = text::one_direction(&event.text);
                step.alarms.update(AlarmEvent { text, ..event });
            }
            (Transition::Raise(_), Some(event)) => _ = step.raise(event),
            (Transition::Turn(_), Some(event)) => step.alarms.raise_anew(Rule::Usual, event),
            (Transition::Escalate, Some(event)) => _ = step.alarms.escalate(Rule::Usual, event),
            (Transition::Clear(left), _) => {
                let raised_pct = step.alarms.find_active(cause).and_then(|alarm| alarm.last.change_pct);
                // A smaller change that the site shares, or one in the other sense, does not hide a repair.
                let explains = |pct: f64| raised_pct.is_none_or(|raised| pct / raised > 0.5);
                let shared = self.shared_changes().find(|(of, pct)| *of == cause && explains(*pct));
                let text = match shared {
                    Some((_, pct)) => text::cleared_as_shared(name, cause, pct),
                    None => text::cleared(name, cause, left, raised_pct.is_some_and(|pct| pct > 0.0)),
                };
                step.clear(cause, |_| text);
            }
            (Transition::Withdraw, _) => {
                let other = match latest.drift.origin {
                    Origin::Sensor(fault) => fault.cause,
                    Origin::Supply => Cause::Supply,
                    _ => latest.drift.attribution.as_ref().map_or(Cause::Unattributed, Attribution::cause),
                };
                step.clear(cause, |name| text::withdrawn(name, cause, other));
            }
            _ => {}
        }
    }

    /// Stores the change `shared` of this throw, which the machine shares with its site; 0 for a coefficient whose
    /// change is too small for a warning.
    pub(crate) fn share(&mut self, shared: &Vector3<f64>, settings: &Settings) {
        let matters = |i: usize| settings.relevance(Cause::OF_COEFFICIENTS[i], shared[i]) > SHARED_FROM;
        let kept = |i: usize| if matters(i) { to_f32(shared[i]) } else { 0.0 };
        self.shared = [0, 1, 2].map(kept);
    }

    /// The changes of the machine that are shared with the site, with their size \[%\].
    pub(crate) fn shared_changes(&self) -> impl Iterator<Item = (Cause, f64)> {
        let is_change = |(_, log): &(Cause, f32)| *log != 0.0;
        Cause::OF_COEFFICIENTS
            .into_iter()
            .zip(self.shared)
            .filter(is_change)
            .map(|(cause, log)| (cause, percent(log.into())))
    }

    /// If the active alarm of a cause is about both directions, and the drift is now known to be in one direction only,
    /// the severity of the alarm. The first throws of a drift do not show this.
    fn becomes_one_sided(&mut self, index: usize, direction: Option<Direction>, alarms: &Alarms) -> Option<Severity> {
        let cause = Cause::DRIFTS[index];
        let count = &mut self.one_sided[index];
        *count = if direction.is_some() { count.saturating_add(1) } else { 0 };
        let of_both =
            alarms.find_active(cause).filter(|alarm| alarm.rule == Rule::Usual && alarm.last.direction.is_none());
        of_both.filter(|_| *count >= ONE_SIDED_THROWS).map(|alarm| alarm.last.severity)
    }

    /// Applies the departure of a throw from the previous throws, for the alarm about intermittent faults. `excused`: a
    /// sensor explains the drift.
    pub(crate) fn judge_departure(&mut self, departure: &Departure, excused: bool, step: &mut Step) {
        let settings = step.settings;
        let is_active = step.alarms.owned_by(Rule::Intermittent);
        let during = During { suspicion: self.is_suspicious(step.alarms), alarm: is_active.is_some() };
        self.intermittent.push(departure, during, settings);
        let found = if is_active.is_some() {
            // A fault that became permanent is no longer intermittent: the usual rule takes over its alarm.
            let becomes_permanent = is_active.is_some_and(|cause| self.counts_for(cause, settings));
            let is_over = self.intermittent.is_over() && !becomes_permanent;
            if is_over { RuleResult::Nothing } else { RuleResult::Unclear }
        } else {
            let found = self.intermittent.found(&departure.of_one_throw, settings);
            found.filter(|_| !excused).map_or(RuleResult::Unclear, |found| {
                let event = step.warning(found.cause, text::intermittent(step.name, &found));
                RuleResult::Fault(Box::new(event.of_size(found.explanation.level())))
            })
        };
        if found == RuleResult::Nothing {
            self.intermittent.end();
        }
        found.apply(Rule::Intermittent, step);
    }

    /// Counts a throw whose departure is not known, as that of a rough throw on a machine with complete ones. After 50
    /// of them in a row the alarm about an intermittent fault cannot end by its own rule.
    pub(crate) fn on_unknown_departure(&mut self, step: &mut Step) {
        if self.intermittent.on_unknown()
            && let Some(cause) = step.alarms.owned_by(Rule::Intermittent)
        {
            self.intermittent.end();
            self.now.retain(|drifting| drifting.cause != cause);
            step.clear(cause, |name| text::intermittent_unknown(name, cause));
        }
    }

    /// Whether the last throws speak for an alarm of the usual rule about `cause`. After more throws than an alarm waits
    /// for, the drift may be the season's or near its limit, and raises none.
    fn counts_for(&self, cause: Cause, settings: &Settings) -> bool {
        let counts = 1..=settings.on_delay_throws + 2 * TOO_CLOSE_PATIENCE + LEVELS_FOLLOW;
        Cause::DRIFTS.iter().zip(&self.conditions).any(|(own, condition)| {
            matches!(condition, Condition::Quiet { onset, .. } if *own == cause && counts.contains(&onset.named))
        })
    }

    /// The suspicion of a drift, as a reason not to add the last throw to a baseline. What happens at the end of the
    /// stroke and after it does not change the coefficients.
    pub(crate) fn suspicion(&self, drift: Option<&Drift>, alarms: &Alarms) -> Suspicion {
        let is_of_movement = |event: &AlarmEvent| {
            let alarm = alarms.find_active(event.cause);
            alarm.is_none_or(|alarm| [&alarm.rule].into_iter().chain(&alarm.added).any(|rule| !OF_END.contains(rule)))
        };
        if alarms.active().any(|event| event.cause.is_drift() && is_of_movement(event)) {
            Suspicion::Alarmed
        } else if drift.is_some_and(Drift::matters) {
            Suspicion::AboveLimit
        } else if self.onset.is_some() {
            Suspicion::Suspected
        } else {
            Suspicion::None
        }
    }

    /// The drifts with an active alarm. Their level is the mean of throws between the raise of the latest alarm and the
    /// last throws, which may contain a new fault. Left out are the last 48 throws, the longest window of each
    /// direction, or the last 24 if there are too few throws.
    pub(crate) fn known<'a>(&self, alarms: &Alarms, gauges: &'a Gauges) -> Known<'a> {
        let raised = self.conditions.iter().filter_map(Condition::since_raised).min();
        let before = |last: u32| self.history.mean(last..raised?);
        let level = before(2 * LONGEST_WINDOW).or_else(|| before(LONGEST_WINDOW));
        let causes = alarms.drifts().map(|event| event.cause).collect();
        Known { causes, level, gauges: Some(gauges), ..Known::default() }
    }

    /// Whether anything about the drive is suspected or alarmed, so that throws do not count as healthy.
    pub(crate) fn is_suspicious(&self, alarms: &Alarms) -> bool {
        !self.suspicion(None, alarms).is_none() || OF_END.iter().any(|rule| alarms.owned_by(*rule).is_some())
    }

    /// Counts a throw that cannot be judged. Returns whether the present is unknown, after 24 of them in a row.
    pub(crate) fn on_unjudged(&mut self) -> bool {
        self.unjudged = self.unjudged.saturating_add(1);
        let is_unknown = self.unjudged >= LONGEST_WINDOW;
        if is_unknown {
            self.now.clear();
            (self.shared, self.season_pct) = Default::default();
        }
        is_unknown
    }

    /// Discards the history after a new baseline, as its residuals are from the old one.
    pub(crate) fn forget_history(&mut self) {
        self.history = History::default();
        self.onset = None;
        self.fallen = None;
        self.opposite = false;
        self.season_pct = None;
    }

    /// Resets the state after a rebaseline or maintenance, except the numbers of throws since the last raises.
    pub(crate) fn reset(&mut self) {
        self.conditions.iter_mut().for_each(Condition::reset);
        self.intermittent.reset();
        let (conditions, intermittent) = (mem::take(&mut self.conditions), mem::take(&mut self.intermittent));
        *self = Self { conditions, intermittent, ..Self::default() };
    }

    /// Updates the first throw of the suspected drift.
    fn follow_onset(&mut self, LatestThrow { drift, order, .. }: LatestThrow, step: &Step) {
        let earlier = if drift.provisional { SUSPECTED_EARLIER } else { 1.0 };
        if drift.excess() < earlier * FORGOTTEN_BELOW {
            self.onset = None;
        } else if drift.excess() > earlier * SUSPECTED_FROM && self.onset.is_none() {
            self.onset = step.throw.map(|first| Onset { first: first.clone(), order });
        }
    }

    /// Updates the present drifts after a throw.
    pub(crate) fn renew(&mut self, latest: LatestThrow, alarms: &Alarms) {
        let LatestThrow { drift, settings, .. } = latest;
        let mut now: Vec<(Severity, f64, Drifting)> = Vec::new();
        let has_sound_motor = drift.attribution.as_ref().is_some_and(Attribution::has_sound_motor);
        let evidence = drift.attribution.map_or(MotorEvidence::NONE, |attribution| attribution.evidence);
        let physical = alarms.active().map(|event| event.cause).filter(|cause| cause.is_part());
        let pair: Option<[Cause; 2]> = physical.collect::<Vec<_>>().try_into().ok();
        for alarm in alarms.drifts() {
            if alarms.rule(alarm.cause) == Some(Rule::Intermittent) {
                now.push((alarm.severity, 0.0, self.of_faulty_throws(alarm, latest)));
                continue;
            }
            let size = |cause: Cause, window: &Window| {
                if has_sound_motor && cause == Cause::Friction {
                    return friction_of_sound_motor(window);
                }
                let pair = pair.filter(|pair| pair.contains(&cause));
                let together = pair.map(|pair| explained(pair, window, evidence, settings));
                let part = together.and_then(|fit| fit.part(cause));
                part.unwrap_or_else(|| explained([cause], window, evidence, settings).parts[0])
            };
            // The size of a single cause that does not explain the drift means nothing, so a drift without a name is
            // fitted with three causes.
            let parts = drift.windows().flat_map(|window| match alarm.cause {
                Cause::Unattributed => window.fit(Cause::OF_COEFFICIENTS, settings).parts.to_vec(),
                cause if window.shows(cause) => vec![size(cause, window)],
                _ => Vec::new(),
            });
            let named = drift.attribution.as_ref().filter(|_| alarm.cause == Cause::Unattributed);
            let named = named.and_then(Attribution::main).copied();
            let largest =
                named.or_else(|| parts.max_by(|a, b| a.relevance(settings).total_cmp(&b.relevance(settings))));
            let Some(largest) = largest else {
                // The last throws do not show this cause, so its last known size stays.
                now.extend(self.present(alarm.cause).map(|known| (alarm.severity, 0.0, *known)));
                continue;
            };
            let direction = latest.direction(alarm.cause);
            let (size, course) = latest.size(&largest, direction, &self.history);
            let drifting = Drifting {
                cause: alarm.cause,
                change_pct: size.level().pct(),
                change_pct_sd: size.level().sd_pct(),
                direction,
                limit_in_throws: course.and_then(|course| forecast(&size, &course, alarm.severity, settings)),
            };
            now.push((alarm.severity, size.relevance(settings), drifting));
        }
        self.now = worst_first(now);
    }

    /// The drift of the faulty throws behind an alarm about an intermittent fault. The mean of all throws would say
    /// that the fault is small.
    fn of_faulty_throws(
        &self,
        alarm: &AlarmEvent,
        LatestThrow { drift, tracks, settings, .. }: LatestThrow,
    ) -> Drifting {
        let of_one_throw = tracks.of_one_throw(Direction::BOTH[drift.latest.0]);
        let size = of_one_throw.and_then(|of_one| self.intermittent.size(alarm.cause, &of_one, settings));
        Drifting {
            cause: alarm.cause,
            change_pct: size.map(Level::pct).or(alarm.change_pct).unwrap_or_default(),
            change_pct_sd: size.map(Level::sd_pct).or(alarm.change_pct_sd).unwrap_or_default(),
            direction: alarm.direction,
            limit_in_throws: None,
        }
    }

    /// The present drift of an active alarm.
    fn present(&self, cause: Cause) -> Option<&Drifting> {
        self.now.iter().find(|drifting| drifting.cause == cause)
    }

    fn event(&self, cause: Cause, severity: Severity, latest: LatestThrow, step: &Step) -> Option<AlarmEvent> {
        let LatestThrow { drift, order, at, tracks, settings, .. } = latest;
        let direction = latest.direction(cause);
        let attribution = *drift.attribution.as_ref()?;
        let mut attribution = if direction.is_some() { attribution.in_one_direction() } else { attribution };
        let throws = self.onset.as_ref().map_or(1, |onset| order - onset.order + 1);
        let mut limit_in_throws = None;
        if let Some((now, course)) = latest.named_part(direction, &self.history)
            && let Naming::One(main) | Naming::Another { new: main, .. } = &mut attribution.naming
        {
            limit_in_throws = course.and_then(|course| forecast(&now, &course, severity, settings));
            *main = now;
        }
        let alike = match drift.origin {
            Origin::Either { channel, waits } => Some((channel, waits)),
            _ => None,
        };
        if let (Some(_), Naming::One(_)) = (alike, attribution.naming) {
            attribution.runner_up = Some(RunnerUp { cause: Cause::Sensor, margin: 0.0 });
        }
        let main = attribution.main();
        let subject = text::subject(step.name, direction);
        let mut text = text::drift(&subject, &attribution, alike, throws, limit_in_throws.as_ref());
        let is_drying = |main: &Explanation| main.cause == Cause::Friction && DRYING.contains(&main.size);
        if tracks.may_have_learned_rain(at) && main.is_some_and(is_drying) {
            text += text::RAIN_IN_BASELINE;
        }
        if latest.gauges.is_without_toe_sensor()
            && main.is_some_and(|main| main.cause == Cause::Inertia && main.size < 0.0)
        {
            text += text::OR_FILTER;
        }
        Some(AlarmEvent {
            change_pct: main.map(|main| main.level().pct()),
            change_pct_sd: main.map(|main| main.level().sd_pct()),
            direction,
            runner_up: attribution.runner_up,
            correlation: Some(attribution.correlation),
            first_throw: self.onset.as_ref().map(|onset| onset.first.clone()),
            limit_in_throws,
            ..step.event(cause, severity, text)
        })
    }
}

/// Forecast of the number of throws until the critical limit; `None` for an alarm that is critical already.
fn forecast(now: &Explanation, course: &Course, severity: Severity, settings: &Settings) -> Option<LimitForecast> {
    let limit_pct = settings.limit_pct(now.cause).filter(|_| severity == Severity::Warning)?;
    let limit = now.size.signum() * settings.critical_factor * limit_pct / 100.0;
    if limit <= -1.0 || now.size == 0.0 {
        return None;
    }
    // The course contains the error of the model in proportion to the size, so the limit is scaled as much.
    let (size, sd) = course.now();
    let of_course = size.ln_1p() / now.size;
    let scaled = if MODEL_ERROR.contains(&of_course) { (of_course * limit.ln_1p()).exp_m1() } else { limit };
    // The size has uncertainties that the course does not have, and that grow with it.
    let more_sd = (now.size_sd.powi(2) - (sd / (1.0 + size)).powi(2)).max(0.0).sqrt();
    course.reaches(scaled, more_sd / now.size.abs() * scaled.abs())
}

/// Sorts drifts, with their severity and size relative to the limit, into the order in which they are shown: named
/// parts before `unattributed`, then the most severe, then the largest.
fn worst_first(mut drifts: Vec<(Severity, f64, Drifting)>) -> Vec<Drifting> {
    let is_named = |drifting: &Drifting| drifting.cause != Cause::Unattributed;
    drifts.sort_by(|(severity, size, one), (other_severity, other_size, other)| {
        let order = (is_named(other), other_severity).cmp(&(is_named(one), severity));
        order.then(other_size.total_cmp(size))
    });
    drifts.into_iter().map(|(.., drifting)| drifting).collect()
}

/// The severity of the active alarm about a lasting change of `cause`; `None` without one, if its rule knows no part,
/// and if its fault is intermittent.
fn severity_of_drift(cause: Cause, alarms: &Alarms) -> Option<Severity> {
    alarms.find_active(cause).filter(|alarm| !alarm.rule.gives_way()).map(|alarm| alarm.last.severity)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::drift::Beginning;

    /// A slow change that may be the season's counts for ever.
    #[test]
    fn a_drift_that_counts_for_longer_than_an_alarm_waits_ends_an_intermittent_fault() {
        let settings = Settings::default();
        let counts_after = |named: u32| {
            let onset = Beginning { named, critical: 0 };
            let conditions = std::array::from_fn(|_| Condition::Quiet { onset, since_raised: None });
            DriftAlarms { conditions, ..DriftAlarms::default() }.counts_for(Cause::Friction, &settings)
        };
        assert_eq!([0, 1, 40, 62, 63, 500].map(counts_after), [false, true, true, true, false, false]);
    }

    #[test]
    fn a_motor_that_runs_on_stops_no_learning_of_the_movement() {
        let settings = Settings::default();
        for (rule, learns) in [(Rule::RunOn, true), (Rule::Travel, false)] {
            let mut alarms = Alarms::default();
            let at = Timestamp::UNIX_EPOCH;
            let step = Step { alarms: &mut alarms, name: "21B", at, throw: None, settings: &settings };
            let event = step.warning(Cause::Unattributed, "fault".to_owned());
            alarms.raise(rule, event);
            assert_eq!(DriftAlarms::default().suspicion(None, &alarms).is_none(), learns, "{rule:?}");
        }
    }

    #[test]
    fn a_named_part_comes_before_a_drift_without_a_name() {
        let drift = |cause: Cause, severity: Severity, size: f64| {
            let drifting =
                Drifting { cause, change_pct: size, change_pct_sd: 1.0, direction: None, limit_in_throws: None };
            (severity, size, drifting)
        };
        let drifts = vec![
            drift(Cause::Unattributed, Severity::Critical, 9.0),
            drift(Cause::Friction, Severity::Warning, 2.0),
            drift(Cause::Stiffness, Severity::Warning, 3.0),
            drift(Cause::Kt, Severity::Critical, 1.0),
        ];
        let causes: Vec<Cause> = worst_first(drifts).iter().map(|drift| drift.cause).collect();
        assert_eq!(causes, [Cause::Kt, Cause::Stiffness, Cause::Friction, Cause::Unattributed]);
    }
}
