//! The counters of the operational alarms, and the alarms about throws that are incomplete, slow or not evaluated.

use std::mem;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::run_on::RunOn;
use crate::{
    diagnose::{
        AlarmEvent, Blindness, Cause, Observation, Severity,
        alarm::{Rule, Step},
        gauges::Gauges,
        statistics::{is_default, streak, to_f32},
        text,
    },
    estimate::{Features, LONGEST_STALL_S, Rejection},
    throw::Direction,
};

/// Consecutive slow throws that raise the alarm: one may be an animal between the rails or a dip of the supply.
const SLOW_IN_A_ROW: u32 = 3;
/// Evaluated throws among the last eight of a direction that end the alarm: one now and then is no monitoring.
const EVALUATED_OF_EIGHT: u32 = 4;
/// Consecutive throws that contradict the direction named by the logger until a caveat says so.
const CONTRADICTED_IN_A_ROW: u32 = 5;
/// Number of throws of a direction within which the other direction must show exchanged names too.
const EXCHANGED_WITHIN: u8 = 2;
/// See [`Operation::alike`].
const EXCHANGED: [u8; 2] = [u8::MAX; 2];
/// Largest distance from the end of a throw to the start of the next, as part of the travel: the rails spring back.
const LARGEST_SHIFT: f64 = 0.1;
/// Consecutive throws with unused fields until a caveat says so.
const UNUSED_IN_A_ROW: u32 = 5;
/// Rejected throws among the last 32 of a direction until a caveat says so: a quarter, which delays a detection.
const OFTEN_REJECTED: u32 = 8;
/// Consecutive throws with a too short travel until a caveat says so.
const SHORT_IN_A_ROW: u32 = 5;
/// Consecutive throws with the same named direction until a caveat says so. Between two throws to one side, there is one
/// to the other side, but some throws may be lost.
const SAME_DIRECTION_IN_A_ROW: u8 = 12;
/// Consecutive throws without coefficients, on a machine without toe sensor that had them, until a caveat says so.
const WITHOUT_COEFFICIENTS_IN_A_ROW: u32 = 20;

/// Liveliness of the logger.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Logger {
    /// The logger has never declared a token, or its throws arrive without one.
    #[default]
    Unannounced,
    /// The token exists.
    There,
    /// The token existed, and is gone.
    Gone {
        /// Time since the loss of the token \[s\].
        for_s: f64,
        /// Time of the loss; `None` in snapshots of early versions.
        since: Option<Timestamp>,
    },
}

/// Numbers of consecutive throws of each direction, and of the machine. The directions alternate, so a fault that
/// concerns one direction never shows in consecutive throws of the machine.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Streaks([u32; 3]);

impl Streaks {
    /// Counts a throw in which something `holds` or does not. If the direction is unknown, a throw in which it holds
    /// may be one of either direction: it counts for both.
    fn count(&mut self, direction: Option<Direction>, holds: bool) {
        let [.., machine] = &mut self.0;
        streak(machine, holds);
        for own in sides_of(direction).filter(|_| direction.is_some() || holds) {
            streak(&mut self.0[own.side()], holds);
        }
    }

    /// The number of a direction; for `None`, that of the machine.
    fn of(self, direction: Option<Direction>) -> u32 {
        self.0[direction.map_or(Direction::BOTH.len(), Direction::side)]
    }

    pub(super) fn longest(self) -> u32 {
        self.0.into_iter().max().unwrap_or_default()
    }
}

/// Counts of consecutive throws of one direction.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
struct DirectionCounts {
    slow: u32,
    very_slow: u32,
    /// The last 32 throws as bits, 1 for a throw that was not evaluated.
    #[serde(rename = "lost")]
    rejections: u32,
    /// Code of the reason for the last rejection.
    #[serde(skip_serializing_if = "Option::is_none")]
    rejected: Option<String>,
}

/// Counters of the operational alarms; without another unit, they count consecutive throws of the machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Operation {
    sides: [DirectionCounts; 2],
    incomplete_in_a_row: Streaks,
    complete: u32,
    fast_enough: u32,
    pub(super) unevaluated_in_a_row: Streaks,
    /// Evaluated throws in which the temperature or the scatter hides faults.
    pub(super) blind_in_a_row: Streaks,
    /// Throws whose movement contradicts the direction that the logger names, and throws whose movement agrees.
    contradicted: u32,
    agreed: u32,
    /// Whether the movement usually contradicts the named direction, by the first throws; `None` until known.
    #[serde(skip_serializing_if = "Option::is_none")]
    usually_contradicted: Option<bool>,
    /// Position at the end of the last throw with a measured and a named direction \[mm\].
    #[serde(skip_serializing_if = "Option::is_none")]
    ended_mm: Option<f32>,
    /// Positions at the start and the end of the last throw \[mm\], if the toe did not stay closed or stopped at an
    /// obstruction.
    #[serde(skip_serializing_if = "Option::is_none")]
    left_open_mm: Option<[f32; 2]>,
    /// The sentence about the unused fields of the last throw, and the number of throws with unused fields.
    #[serde(skip_serializing_if = "Option::is_none")]
    unused_fields: Option<(String, u32)>,
    /// Travel and configured stroke \[mm\] of the last throw, if its travel was too short; number of such throws.
    #[serde(skip_serializing_if = "Option::is_none")]
    short: Option<([f32; 2], u32)>,
    pub(crate) run_on: RunOn,
    /// Throws with features of the current only.
    without_coefficients: u32,
    /// Direction that the logger names for the last throw, if no position shows the movement, and the number of throws
    /// before it with the same name.
    #[serde(skip_serializing_if = "Option::is_none")]
    named: Option<Direction>,
    #[serde(skip_serializing_if = "is_default")]
    same_direction: u8,
    /// Numbers of consecutive throws of each direction, without a position, that are like those of the other direction;
    /// [`EXCHANGED`] while the names of the directions are exchanged.
    #[serde(skip_serializing_if = "is_default")]
    alike: [u8; 2],
    /// For temperature and voltage: throws with a plausible value, or, negative, throws with an implausible one.
    pub(super) plausible: [i32; 2],
    /// The last eight throws as bits, 1 for unusable values of the current, of the position, and of the logger's clock.
    pub(super) unusable_in: [u8; 3],
    /// Throws in which all three are usable.
    pub(super) usable: u32,
    /// Throws received since the last gap or irregularity.
    pub(super) since_gap: u32,
    /// Time when the last gap was noticed \[s since 1970\]. A throw received before may have been made before the gap.
    pub(super) gap_at_s: u32,
    /// Missing throws since the alarm was raised.
    #[serde(rename = "lost")]
    pub(super) missing: u64,
    /// Number of them whose messages were refused.
    #[serde(skip_serializing_if = "is_default")]
    pub(super) refused: u64,
    /// Time without a throw of the machine, or for a site without a known common change \[s\].
    pub(super) silence_s: f64,
    pub(super) ticked_at: Option<Timestamp>,
    pub(super) logger: Logger,
    /// Time without failures of the daemon \[s\].
    pub(super) calm_s: f64,
}

/// Updates the value of the last throw, and the number of consecutive throws with a value.
fn follow<T>(last: &mut Option<(T, u32)>, now: Option<T>) {
    let before = last.take().map_or(0, |(_, throws)| throws);
    *last = now.map(|now| (now, before.saturating_add(1)));
}

/// The directions that a throw may have.
fn sides_of(direction: Option<Direction>) -> impl Iterator<Item = Direction> {
    Direction::BOTH.into_iter().filter(move |own| direction.is_none_or(|direction| direction == *own))
}

/// A time in seconds since 1970, in half the memory of a [`Timestamp`].
pub(super) fn unix_s(at: Timestamp) -> u32 {
    u32::try_from(at.as_second().clamp(0, u32::MAX.into())).unwrap_or_default()
}

impl Operation {
    /// Applies a throw, complete or not, before the `gauges`. A throw shows that the logger is alive, unless it was
    /// received before the loss of the logger.
    pub(crate) fn on_throw(&mut self, observation: &Observation, gauges: &Gauges, step: &mut Step) {
        let &Observation { direction, received_at, temperature_c, ref features, ref unused_fields, .. } = observation;
        let incomplete = observation.is_incomplete();
        let enough = step.settings.off_delay_throws;
        self.silence_s = 0.0;
        self.logger = match self.logger {
            gone @ Logger::Gone { since: Some(since), .. } if received_at.is_some_and(|at| at < since) => gone,
            // The logger publishes without a token: from now on, only silence shows its loss.
            Logger::Gone { .. } if is_silence(step) => Logger::Unannounced,
            Logger::Gone { since, .. } => Logger::Gone { for_s: 0.0, since },
            as_before => as_before,
        };
        // A trace that shows nothing neither completes a throw nor fails.
        let shows_movement = observation.estimate().is_some() || observation.features.duration_s.is_some();
        let is_known = incomplete || observation.faulty_sensor().is_none() && shows_movement;
        if is_known {
            self.incomplete_in_a_row.count(direction, incomplete);
            streak(&mut self.complete, !incomplete);
        }
        let [of_machine, own] = [None, direction].map(|of| self.incomplete_in_a_row.of(of));
        let (in_a_row, in_direction) = (of_machine.max(own), direction.filter(|_| own > of_machine));
        for own in sides_of(direction) {
            let own = &mut self.sides[own.side()];
            match &observation.outcome {
                Some(Err(rejection)) => own.rejected = Some(rejection.code().to_owned()),
                Some(Ok(_)) => {}
                None => own.rejected = None,
            }
        }
        follow(&mut self.unused_fields, unused_fields.clone());
        let short = features.travel_mm.zip(observation.short_of_stroke_mm);
        follow(&mut self.short, short.map(|(travel_mm, stroke_mm)| [travel_mm, stroke_mm].map(to_f32)));
        streak(&mut self.without_coefficients, observation.has_features_only());
        let is_named = observation.is_without_position() || observation.unusual_run_s.is_some();
        let named = direction.filter(|_| is_named);
        let is_same = named.is_some() && named == self.named;
        self.same_direction = if is_same { self.same_direction.saturating_add(1) } else { 0 };
        self.named = named;
        if received_at.is_none_or(|received_at| unix_s(received_at) > self.gap_at_s) {
            self.since_gap = self.since_gap.saturating_add(1);
        }
        if incomplete {
            let rejection = observation.rejection();
            let is_usual = |direction| gauges.is_usual_current(direction, features, temperature_c);
            let text = if let Some(run_s) = observation.unusual_run_s {
                text::unusual_run(step.name, in_direction, in_a_row, run_s)
            } else {
                let seems = (direction.is_some_and(is_usual), gauges.normal_travel_mm().is_none());
                text::incomplete(step.name, in_direction, in_a_row, rejection, seems)
            };
            // Without the toe sensor, points that open again seem closed.
            let is_open = matches!(rejection, Some(Rejection::Reopened { .. }));
            let severity = if in_a_row == 1 && !is_open { Severity::Warning } else { Severity::Critical };
            step.alarms.raise_or_escalate(step.event(Cause::IncompleteThrow, severity, text));
        } else if is_known && self.complete >= enough {
            step.clear(Cause::IncompleteThrow, |name| text::complete_again(name, self.complete));
        }
        if self.since_gap >= enough {
            step.clear(Cause::DataLoss, |name| text::no_gap(name, self.since_gap));
            (self.missing, self.refused) = (0, 0);
        }
    }

    /// Applies the duration of a completed throw, `longer_pct` above the baseline. `has_position`: it ends with the arrival
    /// of the toe. `explained`: an active alarm already names the reason; then only a critical duration raises an alarm.
    pub(crate) fn on_duration(
        &mut self,
        (longer_pct, has_position): (f64, bool),
        direction: Direction,
        explained: bool,
        step: &mut Step,
    ) {
        let settings = step.settings;
        let own = &mut self.sides[direction.side()];
        streak(&mut own.slow, longer_pct > settings.slow_throw_pct);
        streak(&mut own.very_slow, longer_pct > settings.slow_throw_critical_pct);
        let (slow, very_slow) = (own.slow, own.very_slow);
        streak(&mut self.fast_enough, longer_pct < settings.slow_throw_pct * (1.0 - settings.deadband_pct / 100.0));
        let other_is_slow = self.sides[1 - direction.side()].slow > 0;
        let direction = (!other_is_slow).then_some(direction);
        let event = |severity| {
            let event =
                step.event(Cause::SlowThrow, severity, text::slow(step.name, direction, longer_pct, has_position));
            AlarmEvent { change_pct: Some(longer_pct), direction, ..event }
        };
        if very_slow >= SLOW_IN_A_ROW {
            let event = event(Severity::Critical);
            step.alarms.raise_or_escalate(event);
        } else if slow >= SLOW_IN_A_ROW && !explained {
            let event = event(Severity::Warning);
            step.raise(event);
        } else if self.fast_enough >= settings.off_delay_throws && !other_is_slow {
            step.clear(Cause::SlowThrow, |name| text::machine(name, text::FAST_AGAIN));
        }
    }

    /// Applies whether a throw was evaluated, and which faults it cannot show (`blind`).
    pub(crate) fn on_evaluation(
        &mut self,
        evaluated: bool,
        observation: &Observation,
        blind: Option<&Blindness>,
        step: &mut Step,
    ) {
        let Step { name, settings, .. } = *step;
        let direction = observation.direction;
        let enough = settings.not_monitored_throws;
        self.unevaluated_in_a_row.count(direction, !evaluated);
        if evaluated {
            self.blind_in_a_row.count(direction, blind.is_some());
        }
        for own in sides_of(direction) {
            let own = &mut self.sides[own.side()];
            own.rejections = own.rejections << 1 | u32::from(!evaluated);
        }
        let is_seen = self.sides.iter().all(|side| (side.rejections | !0xff).count_zeros() >= EVALUATED_OF_EIGHT);
        let is_blind = self.blind_in_a_row.longest() >= enough;
        // All throws of one direction may be rejected, as with a wrong `neutral_mm`, while the other is evaluated.
        let [normal, reverse] = Direction::BOTH.map(Some);
        let unseen = [None, normal, reverse].into_iter().find(|own| self.unevaluated_in_a_row.of(*own) >= enough);
        // After throws that cannot be evaluated, a single evaluated one changes nothing.
        let may_change = is_seen || step.alarms.rule(Cause::NotMonitored) != Some(Rule::Usual);
        let is_gone = matches!(self.logger, Logger::Gone { .. }) && is_silence(step);
        if let Some(unseen) = unseen {
            let of_side = |side: Direction| self.sides[side.side()].rejected.as_deref();
            let code = unseen.map_or_else(|| observation.rejection().map(Rejection::code), of_side);
            let text = text::unevaluated(name, unseen, self.unevaluated_in_a_row.of(unseen), code);
            not_monitored(Rule::Usual, unseen, text, step);
        } else if let Some(blind) = blind.filter(|_| is_blind && may_change) {
            not_monitored(Rule::Blind, None, text::blind(name, blind), step);
        } else if evaluated && is_seen && !is_blind && !is_gone {
            step.clear(Cause::NotMonitored, |name| text::machine(name, text::MONITORED_AGAIN));
        }
    }

    /// Applies whether the movement of a throw contradicts the direction that the logger names. Returns whether the
    /// axis of the position may be reversed: the contradiction is unusual, and the first throw with it did not begin
    /// where the last throw ended. If it did begin there, only the names of the directions were exchanged.
    pub(crate) fn on_direction(&mut self, contradicted: bool, features: &Features) -> bool {
        streak(&mut self.contradicted, contradicted);
        streak(&mut self.agreed, !contradicted);
        let is_known = self.contradicted.max(self.agreed) >= CONTRADICTED_IN_A_ROW;
        if self.usually_contradicted.is_none() && is_known {
            self.usually_contradicted = Some(contradicted);
        }
        let Features { start_position_mm: start, end_position_mm: end, travel_mm: travel, .. } = *features;
        let before = mem::replace(&mut self.ended_mm, end.map(to_f32));
        let is_unusual = self.usually_contradicted.is_some_and(|usual| usual != contradicted);
        // Only the first throw can show this: later throws with a reversed axis begin where the last one ended, too.
        let is_first = if contradicted { self.contradicted } else { self.agreed } == 1;
        let shift = before.zip(start).map(|(before, start)| (f64::from(before) - start).abs());
        let is_next = shift.zip(travel).is_some_and(|(shift, travel)| shift < LARGEST_SHIFT * travel);
        if is_unusual && is_first && is_next {
            self.usually_contradicted = Some(contradicted);
            return false;
        }
        is_unusual
    }

    /// Whether the throw moves the toe from where the last one left it open to where that one began. Its short travel
    /// then shows neither an obstruction nor a fault of the position sensor. `ends_short`: the duration shows too that
    /// the throw ends short of its usual end.
    pub(crate) fn begins_open(&mut self, throw: &Observation, ends_short: bool) -> bool {
        let Features { start_position_mm: start, end_position_mm: end, .. } = throw.features;
        let before = self.left_open_mm.take();
        let ends = start.zip(end).map(|(start, end)| [start, end].map(to_f32));
        let is_back = |([from, to], [start, end]): ([f32; 2], [f32; 2])| {
            let near = to_f32(LARGEST_SHIFT) * (to - from).abs();
            (start - to).abs() < near && (end - from).abs() < near
        };
        let is_stalled = throw.features.run_on_s.is_some_and(|run_on_s| run_on_s > LONGEST_STALL_S);
        let is_incomplete = matches!(throw.rejection(), Some(Rejection::Incomplete { .. }));
        let is_short = throw.estimate().is_some() || is_incomplete && !is_stalled;
        let begins_open = is_short && before.zip(ends).is_some_and(is_back);
        // Only the motor shows an obstruction: with a wrong gain of the position, each throw would excuse the next one.
        let is_open = matches!(throw.rejection(), Some(Rejection::Reopened { .. } | Rejection::Obstructed { .. }));
        self.left_open_mm = ends.filter(|_| is_open || ends_short || is_incomplete && is_stalled);
        begins_open
    }

    /// Applies whether a throw without a position is like those of the other direction (`None`: unknown).
    pub(crate) fn on_likeness(&mut self, direction: Direction, of_other: Option<bool>) {
        if self.is_exchanged() {
            // A throw that fits both directions or neither shows nothing new.
            if of_other == Some(false) {
                self.alike = [0; 2];
            }
            return;
        }
        let alike = &mut self.alike[direction.side()];
        *alike = if of_other == Some(true) { (*alike + 1).min(EXCHANGED_WITHIN + 1) } else { 0 };
        // Exchanged names change both directions at once. Wear and adjustments make one direction like the other for a
        // longer time.
        if self.alike.iter().all(|throws| (1..=EXCHANGED_WITHIN).contains(throws)) {
            self.alike = EXCHANGED;
        }
    }

    /// Forgets the likeness, as the position shows the direction.
    pub(crate) fn on_position(&mut self) {
        self.alike = [0; 2];
    }

    /// Whether the logger has exchanged the names of the directions, as throws without a position show.
    pub(crate) fn is_exchanged(&self) -> bool {
        self.alike == EXCHANGED
    }

    /// Whether the movement contradicts the direction that the logger names: names exchanged, or always the same name.
    pub(crate) fn is_contradicted(&self) -> bool {
        self.contradicted >= CONTRADICTED_IN_A_ROW
    }

    /// Sentences about frequent rejections, about lost coefficients of a machine that `had_coefficients`, and about
    /// unused fields and a short travel. With `of_sensor`, an alarm about a sensor reports the last two already.
    pub(crate) fn caveats(&self, name: &str, of_sensor: bool, had_coefficients: bool) -> Vec<String> {
        let unused = self.unused_fields.as_ref().filter(|(_, throws)| *throws >= UNUSED_IN_A_ROW && !of_sensor);
        let often = Direction::BOTH.into_iter().filter_map(|direction| {
            let DirectionCounts { rejections, rejected, .. } = &self.sides[direction.side()];
            let count = Some(rejections.count_ones()).filter(|count| *count >= OFTEN_REJECTED)?;
            Some(text::often_rejected(name, direction, count, u32::BITS, rejected.as_ref()?))
        });
        let short = self.short.filter(|(_, throws)| *throws >= SHORT_IN_A_ROW && !of_sensor);
        let lost_coefficients = had_coefficients && self.without_coefficients >= WITHOUT_COEFFICIENTS_IN_A_ROW;
        let sentences = [
            unused.map(|(sentence, _)| text::unused_fields(name, sentence)),
            short.map(|(mm, _)| text::short_of_stroke(name, mm.map(f64::from))),
            lost_coefficients.then(|| text::lost_coefficients(name, self.without_coefficients)),
            self.named
                .filter(|_| self.same_direction >= SAME_DIRECTION_IN_A_ROW)
                .map(|direction| text::same_direction(name, direction, u32::from(self.same_direction) + 1)),
        ];
        sentences.into_iter().flatten().chain(often).collect()
    }

    /// Forgets what is normal, after a rebaseline: the usual values, and the counters of the alarms that it ends.
    pub(crate) fn forget_normal(&mut self) {
        (self.unusable_in, self.usable, self.usually_contradicted) = ([0; 3], 0, None);
        (self.plausible, self.blind_in_a_row, self.fast_enough) = ([0; 2], Streaks::default(), 0);
        for own in &mut self.sides {
            (own.slow, own.very_slow) = (0, 0);
        }
        (self.run_on, self.alike) = (RunOn::default(), [0; 2]);
    }

    /// Lets an alarm about throws that are not evaluated stay until half of the next throws of each direction are.
    pub(crate) fn wait_for_evaluated(&mut self) {
        for own in &mut self.sides {
            // One rejection fewer than the caveat about frequent ones needs.
            own.rejections = (1 << (OFTEN_REJECTED - 1)) - 1;
        }
    }

    /// Resets the counters after maintenance or two loggers; keeps the gaps, the logger, and what is known about the
    /// directions: the first throw after it would look like one whose names were exchanged.
    pub(crate) fn reset(&mut self) {
        *self = Self {
            ticked_at: self.ticked_at,
            usually_contradicted: self.usually_contradicted,
            contradicted: self.contradicted,
            agreed: self.agreed,
            ended_mm: self.ended_mm,
            alike: self.alike,
            run_on: self.run_on.forget_recent(),
            since_gap: self.since_gap,
            gap_at_s: self.gap_at_s,
            missing: self.missing,
            refused: self.refused,
            logger: self.logger,
            ..Self::default()
        };
    }
}

/// Raises the alarm that the machine, or only a direction, is not monitored. An active alarm changes if its reason is
/// another, as silence instead of throws that cannot be evaluated, or if it concerns the other direction, alone or too.
/// Two loggers explain that throws are not evaluated.
pub(crate) fn not_monitored(rule: Rule, direction: Option<Direction>, text: String, step: &mut Step) {
    let event = AlarmEvent { direction, ..step.warning(Cause::NotMonitored, text) };
    match step.alarms.find_active(Cause::NotMonitored).map(|alarm| (alarm.rule, alarm.last.direction)) {
        Some((Rule::TwoLoggers, _)) if matches!(rule, Rule::Usual | Rule::Blind) => {}
        Some((before, of)) if before != rule || of.is_some() && of != direction => {
            step.alarms.raise_anew(rule, event);
        }
        _ => _ = step.alarms.raise(rule, event),
    }
}

/// Whether the machine is not monitored because of silence, or as its logger is gone.
pub(super) fn is_silence(step: &Step) -> bool {
    step.alarms.rule(Cause::NotMonitored) == Some(Rule::Silence)
}
