//! The operational alarms: throws that are incomplete, slow, not evaluated or lost, and silence.

use std::mem;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::Implausible;
use crate::{
    diagnose::{
        AlarmEvent, Blindness, Cause, Irregularity, Missing, Observation, SensorChannel, Settings, Severity,
        alarm::{Rule, Step},
        observation::Unusable,
        statistics::streak,
        text,
    },
    estimate::Features,
    throw::{Direction, without_digits},
};

/// Consecutive slow throws that raise the alarm: one may be an animal between the rails or a dip of the supply.
const SLOW_IN_A_ROW: u32 = 3;
/// Consecutive rejected temperatures or voltages that raise the alarm: one is a disturbance.
const IMPLAUSIBLE_IN_A_ROW: u32 = 3;
/// Throws with an unusable channel among the last eight that raise the alarm: one or two are disturbances.
const UNUSABLE_OF_EIGHT: u32 = 3;
/// Evaluated throws among the last eight of a direction that end the alarm: one now and then is no monitoring.
const EVALUATED_OF_EIGHT: u32 = 4;
/// Longest time between two ticks that counts as silence \[s\]; a longer one is a jump of the clock or a restart.
const LONGEST_TICK_S: f64 = 3600.0;
/// Longest time between two ticks that counts for delays of minutes \[s\]. After a start of the daemon, loggers thus
/// have the whole delay to connect again.
const USUAL_TICK_S: f64 = 60.0;
/// Time without failures of the daemon after which its alarm clears \[s\]: a disk at its limit must not let it flap.
const CALM_S: f64 = 600.0;
/// Consecutive throws that contradict the direction named by the logger until a caveat says so.
const CONTRADICTED_IN_A_ROW: u32 = 5;
/// Largest distance from the end of a throw to the start of the next, as part of the travel: the rails spring back.
const LARGEST_SHIFT: f64 = 0.1;
/// Consecutive throws with unused fields until a caveat says so.
const UNUSED_IN_A_ROW: u32 = 5;
/// Rejected throws among the last 32 of a direction until a caveat says so: a quarter, which delays a detection.
const OFTEN_REJECTED: u32 = 8;
/// Consecutive throws with a too short travel until a caveat says so.
const SHORT_IN_A_ROW: u32 = 5;
/// Consecutive throws without coefficients, on a machine without toe sensor that had them, until a caveat says so.
const WITHOUT_COEFFICIENTS_IN_A_ROW: u32 = 20;

/// Liveliness of the logger.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Logger {
    /// The logger has never declared a token, or its throws arrive without one.
    #[default]
    Unannounced,
    /// The token exists.
    There,
    /// The token existed, and is gone.
    Gone {
        /// Time since the loss of the token \[s\].
        for_s: f64,
        /// Whether the loss has raised an alarm.
        alarmed: bool,
        /// Time of the loss.
        since: Option<Timestamp>,
    },
}

/// Counts of consecutive throws of one direction. The directions alternate, so a fault that concerns one direction
/// never shows in consecutive throws of the machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
struct Streaks {
    incomplete: u32,
    slow: u32,
    very_slow: u32,
    unevaluated: u32,
    /// Throws while the temperature hides faults at their warning limit.
    blind: u32,
    /// The last 32 throws as bits, 1 for a throw that was not evaluated.
    lost: u32,
    /// Code of the reason for the last rejection.
    #[serde(skip_serializing_if = "Option::is_none")]
    rejected: Option<String>,
}

/// Counters of the operational alarms; without another unit, they count consecutive throws of the machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Operation {
    sides: [Streaks; 2],
    incomplete: u32,
    complete: u32,
    fast_enough: u32,
    unevaluated: u32,
    blind: u32,
    /// Throws whose movement contradicts the direction that the logger names, and throws whose movement agrees.
    contradicted: u32,
    agreed: u32,
    /// Whether the movement usually contradicts the named direction, by the first throws; `None` until known.
    #[serde(skip_serializing_if = "Option::is_none")]
    usually_contradicted: Option<bool>,
    /// Position at the end of the last throw \[mm\].
    #[serde(skip_serializing_if = "Option::is_none")]
    ended_mm: Option<f32>,
    /// The sentence about the unused fields of the last throw, and the number of throws with unused fields.
    #[serde(skip_serializing_if = "Option::is_none")]
    unused_fields: Option<(String, u32)>,
    /// Travel and configured stroke \[mm\] of the last throw, if its travel was too short; number of such throws.
    #[serde(skip_serializing_if = "Option::is_none")]
    short: Option<([f64; 2], u32)>,
    /// Throws with features of the current only.
    without_coefficients: u32,
    /// Throws with an implausible temperature or voltage, and throws without.
    disbelieved: u32,
    believed: u32,
    /// The sensor with unusable values, and its last eight throws as bits, 1 for unusable.
    unusable: Option<(SensorChannel, u8)>,
    usable: u32,
    /// Throws received since the last gap or irregularity.
    since_gap: u32,
    /// Time when the last gap was noticed \[s since 1970\]. A throw received before may have been made before the gap.
    gap_at_s: u32,
    /// Missing throws since the alarm was raised.
    lost: u64,
    /// Number of them whose messages were refused.
    #[serde(skip_serializing_if = "is_zero")]
    refused: u64,
    silence_s: f64,
    ticked_at: Option<Timestamp>,
    logger: Logger,
    /// Time without failures of the daemon \[s\].
    calm_s: f64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference to the field")]
fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// A time in seconds since 1970, in half the memory of a [`Timestamp`].
fn unix_s(at: Timestamp) -> u32 {
    u32::try_from(at.as_second().clamp(0, u32::MAX.into())).unwrap_or_default()
}

impl Operation {
    /// Applies a throw, complete or not. A throw shows that the logger is alive, unless it was received before the loss
    /// of the logger. `is_usual_current`: the current is that of a complete throw.
    pub(crate) fn on_throw(&mut self, observation: &Observation, is_usual_current: bool, step: &mut Step) {
        let &Observation { incomplete, direction, received_at, rejected, ref unused_fields, .. } = observation;
        let enough = step.settings.off_delay_throws;
        self.silence_s = 0.0;
        self.logger = match self.logger {
            gone @ Logger::Gone { since: Some(since), .. } if received_at.is_some_and(|at| at < since) => gone,
            // The logger publishes without a token: from now on, only silence shows its loss.
            Logger::Gone { alarmed: true, .. } => Logger::Unannounced,
            Logger::Gone { since, .. } => Logger::Gone { for_s: 0.0, alarmed: false, since },
            as_before => as_before,
        };
        streak(&mut self.incomplete, incomplete);
        let (mut in_a_row, mut in_direction) = (self.incomplete, None);
        if let Some(direction) = direction {
            let own = &mut self.sides[direction.side()];
            streak(&mut own.incomplete, incomplete);
            if own.incomplete > in_a_row {
                (in_a_row, in_direction) = (own.incomplete, Some(direction));
            }
            if let Some(code) = rejected {
                own.rejected = Some(code.to_owned());
            }
        }
        let before = self.unused_fields.take().map_or(0, |(_, throws)| throws);
        self.unused_fields = unused_fields.clone().map(|sentence| (sentence, before.saturating_add(1)));
        let before = self.short.take().map_or(0, |(_, throws)| throws);
        self.short = observation
            .features
            .travel_mm
            .zip(observation.short_of_stroke_mm)
            .map(|(travel_mm, stroke_mm)| ([travel_mm, stroke_mm], before.saturating_add(1)));
        streak(&mut self.without_coefficients, observation.features_only);
        streak(&mut self.complete, !incomplete);
        if received_at.is_none_or(|received_at| unix_s(received_at) > self.gap_at_s) {
            self.since_gap = self.since_gap.saturating_add(1);
        }
        if incomplete {
            let text = text::incomplete(step.name, in_direction, in_a_row, is_usual_current);
            if in_a_row == 1 {
                step.raise(step.warning(Cause::IncompleteThrow, text));
            } else {
                step.alarms.escalate(Rule::Usual, step.critical(Cause::IncompleteThrow, text));
            }
        } else if self.complete >= enough {
            step.clear(Cause::IncompleteThrow, text::complete_again(step.name, self.complete));
        }
        if self.since_gap >= enough {
            step.clear(Cause::DataLoss, text::no_gap(step.name, self.since_gap));
            (self.lost, self.refused) = (0, 0);
        }
    }

    /// Applies the duration of a completed throw, `longer_pct` above the baseline. `explained`: an active alarm already
    /// names the reason; then only a critical duration raises an alarm.
    pub(crate) fn on_duration(&mut self, longer_pct: f64, direction: Direction, explained: bool, step: &mut Step) {
        let settings = step.settings;
        let own = &mut self.sides[direction.side()];
        streak(&mut own.slow, longer_pct > settings.slow_throw_pct);
        streak(&mut own.very_slow, longer_pct > settings.slow_throw_critical_pct);
        let (slow, very_slow) = (own.slow, own.very_slow);
        streak(&mut self.fast_enough, longer_pct < settings.slow_throw_pct * (1.0 - settings.deadband_pct / 100.0));
        let is_of_one = self.sides[1 - direction.side()].slow == 0;
        let direction = is_of_one.then_some(direction);
        let event = |severity| {
            let event = step.event(Cause::SlowThrow, severity, text::slow(step.name, direction, longer_pct));
            AlarmEvent { change_pct: Some(longer_pct), direction, ..event }
        };
        if very_slow >= SLOW_IN_A_ROW {
            let event = event(Severity::Critical);
            step.alarms.raise_or_escalate(event);
        } else if slow >= SLOW_IN_A_ROW && !explained {
            let event = event(Severity::Warning);
            step.raise(event);
        } else if self.fast_enough >= settings.off_delay_throws {
            step.clear(Cause::SlowThrow, text::machine(step.name, text::FAST_AGAIN));
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
        let Observation { direction, rejected, .. } = *observation;
        let enough = settings.not_monitored_throws;
        streak(&mut self.unevaluated, !evaluated);
        if evaluated {
            streak(&mut self.blind, blind.is_some());
        }
        for own in Direction::BOTH.into_iter().filter(|own| direction.is_none_or(|direction| direction == *own)) {
            let own = &mut self.sides[own.side()];
            own.lost = own.lost << 1 | u32::from(!evaluated);
            if direction.is_some() {
                streak(&mut own.unevaluated, !evaluated);
            }
            if evaluated {
                streak(&mut own.blind, blind.is_some());
            }
        }
        let is_seen = self.sides.iter().all(|side| (side.lost | !0xff).count_zeros() >= EVALUATED_OF_EIGHT);
        let is_blind = self.blind >= enough || self.sides.iter().any(|side| side.blind >= enough);
        // All throws of one direction may be rejected, as with a wrong `neutral_mm`, while the other is evaluated.
        let unseen = Direction::BOTH.into_iter().find(|own| self.sides[own.side()].unevaluated >= enough);
        let text = if let Some(blind) = blind.filter(|_| is_blind) {
            text::blind(name, blind)
        } else if self.unevaluated >= enough {
            text::unevaluated(name, None, self.unevaluated, rejected)
        } else if let Some(unseen) = unseen {
            let Streaks { unevaluated, ref rejected, .. } = self.sides[unseen.side()];
            text::unevaluated(name, Some(unseen), unevaluated, rejected.as_deref())
        } else {
            if evaluated && is_seen && !is_blind && !matches!(self.logger, Logger::Gone { alarmed: true, .. }) {
                step.clear(Cause::NotMonitored, text::machine(name, text::MONITORED_AGAIN));
            }
            return;
        };
        step.raise(step.warning(Cause::NotMonitored, text));
    }

    /// Whether the last throw was not evaluated.
    pub(crate) fn is_rejecting(&self) -> bool {
        self.unevaluated > 0
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
        #[expect(clippy::cast_possible_truncation, reason = "a position needs no more digits")]
        let before = mem::replace(&mut self.ended_mm, end.map(|end| end as f32));
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

    /// Whether the movement contradicts the direction that the logger names: names exchanged, or always the same name.
    pub(crate) fn is_contradicted(&self) -> bool {
        self.contradicted >= CONTRADICTED_IN_A_ROW
    }

    /// Sentences about frequent rejections, about lost coefficients of a machine that `had_coefficients`, and about
    /// unused fields and a short travel. With `of_sensor`, an alarm about a sensor reports the last two already.
    pub(crate) fn caveats(&self, name: &str, of_sensor: bool, had_coefficients: bool) -> Vec<String> {
        let unused = self.unused_fields.as_ref().filter(|(_, throws)| *throws >= UNUSED_IN_A_ROW && !of_sensor);
        let often = Direction::BOTH.into_iter().filter_map(|direction| {
            let Streaks { lost, rejected, .. } = &self.sides[direction.side()];
            let count = Some(lost.count_ones()).filter(|count| *count >= OFTEN_REJECTED)?;
            Some(text::often_rejected(name, direction, count, u32::BITS, rejected.as_ref()?))
        });
        let short = self.short.filter(|(_, throws)| *throws >= SHORT_IN_A_ROW && !of_sensor);
        let lost = had_coefficients && self.without_coefficients >= WITHOUT_COEFFICIENTS_IN_A_ROW;
        let sentences = [
            unused.map(|(sentence, _)| text::unused_fields(name, sentence)),
            short.map(|([travel_mm, stroke_mm], _)| text::short_of_stroke(name, travel_mm, stroke_mm)),
            lost.then(|| text::lost_coefficients(name, self.without_coefficients)),
        ];
        sentences.into_iter().flatten().chain(often).collect()
    }

    /// Applies an implausible temperature or supply voltage of a throw; `None` if both are plausible.
    pub(crate) fn on_sensors(&mut self, implausible: Option<Implausible>, step: &mut Step) {
        streak(&mut self.disbelieved, implausible.is_some());
        streak(&mut self.believed, implausible.is_none());
        if let Some(implausible) = implausible.filter(|_| self.disbelieved >= IMPLAUSIBLE_IN_A_ROW) {
            let channel = match implausible {
                Implausible::Supply(_) => SensorChannel::Supply,
                Implausible::Impossible(_)
                | Implausible::Jump(..)
                | Implausible::Missing(_)
                | Implausible::Stuck(..) => SensorChannel::Temperature,
            };
            let event = step.sensor(channel, text::sensor_implausible(step.name, implausible));
            step.alarms.raise_another(Rule::Usual, event, self.disbelieved == IMPLAUSIBLE_IN_A_ROW);
        } else if self.believed >= step.settings.off_delay_throws
            && step.alarms.rule(Cause::Sensor) == Some(Rule::Usual)
            && matches!(step.alarms.faulty_sensor(), None | Some(SensorChannel::Temperature | SensorChannel::Supply))
        {
            step.clear(Cause::Sensor, text::machine(step.name, text::SENSOR_PLAUSIBLE));
        }
    }

    /// Applies the channel that is unusable in a throw; `None` if all are usable.
    pub(crate) fn on_channel(&mut self, found: Option<Unusable>, step: &mut Step) {
        let faulty = found.map(Unusable::channel);
        streak(&mut self.usable, faulty.is_none());
        let before = self.unusable;
        if let Some((channel, throws)) = &mut self.unusable {
            *throws = *throws << 1 | u8::from(faulty == Some(*channel));
        }
        let over = self.unusable.is_none_or(|(_, throws)| throws == 0);
        if let Some(channel) = faulty.filter(|_| over) {
            self.unusable = Some((channel, 1));
        }
        let Some((channel, throws)) = self.unusable else { return };
        if throws.count_ones() >= UNUSABLE_OF_EIGHT {
            let found = found.filter(|found| found.channel() == channel).unwrap_or(Unusable::Values(channel));
            let event = step.sensor(channel, text::sensor_unusable(step.name, found));
            let is_new = before.is_none_or(|(of, throws)| of != channel || throws.count_ones() < UNUSABLE_OF_EIGHT);
            step.alarms.raise_another(Rule::Usual, event, is_new);
        } else if self.usable >= step.settings.off_delay_throws.max(u8::BITS) {
            self.unusable = None;
            if step.alarms.faulty_sensor() == Some(channel) && step.alarms.rule(Cause::Sensor) == Some(Rule::Usual) {
                step.clear(Cause::Sensor, text::sensor_usable(step.name, channel));
            }
        }
    }

    /// Advances the time. Silence is the sum of the times between ticks, so that a jump of the clock is not silence.
    pub(crate) fn on_tick(&mut self, in_service: bool, step: &mut Step) {
        let Step { name, at, settings, .. } = *step;
        let passed = self.ticked_at.replace(at).map_or(0.0, |before| at.duration_since(before).as_secs_f64());
        // The time of the last gap can be in the future only if the clock was set back.
        self.gap_at_s = self.gap_at_s.min(unix_s(at));
        self.calm_s += passed.clamp(0.0, USUAL_TICK_S);
        if !in_service {
            return;
        }
        self.silence_s += passed.clamp(0.0, LONGEST_TICK_S);
        if let Logger::Gone { for_s, alarmed, .. } = &mut self.logger {
            // A longer time is that of a restart of the daemon, after which the loggers connect again.
            *for_s += if passed <= USUAL_TICK_S { passed.max(0.0) } else { 0.0 };
            if *for_s >= 60.0 * settings.logger_gone_minutes {
                *alarmed |= step.raise(step.warning(Cause::NotMonitored, text::logger_gone(name, *for_s / 60.0)));
                return;
            }
        }
        if self.is_silent(settings) {
            step.raise(step.warning(Cause::NotMonitored, text::silent(name, self.silence_s / 3600.0)));
        }
    }

    fn is_silent(&self, settings: &Settings) -> bool {
        self.silence_s >= 3600.0 * settings.not_monitored_hours
    }

    /// Applies the liveliness of the logger, `there`: whether its token exists. No alarm without an earlier token.
    pub(crate) fn on_liveliness(&mut self, there: bool, step: &mut Step) {
        let before = self.logger;
        self.logger = match before {
            _ if there => Logger::There,
            Logger::There => Logger::Gone { for_s: 0.0, alarmed: false, since: Some(step.at) },
            absent => absent,
        };
        let alarmed = matches!(before, Logger::Gone { alarmed: true, .. });
        let enough = step.settings.not_monitored_throws;
        let monitored = self.unevaluated < enough
            && self.sides.iter().all(|side| side.unevaluated.max(side.blind) < enough)
            && !self.is_silent(step.settings);
        if there && alarmed && monitored {
            step.clear(Cause::NotMonitored, text::machine(step.name, text::LOGGER_BACK));
        }
    }

    /// Whether the logger has declared a token, even if the token is gone now.
    pub(crate) fn is_announced(&self) -> bool {
        self.logger != Logger::Unannounced
    }

    /// Applies a failure of the daemon to store data; `None` without one. A changed text is a new event, unless only
    /// its numbers differ or the last event is younger than ten minutes.
    pub(crate) fn on_daemon_trouble(&mut self, trouble: Option<(Severity, &str)>, step: &mut Step) {
        if let Some((severity, text)) = trouble {
            self.calm_s = 0.0;
            let before = step.alarms.active().find(|event| event.cause == Cause::DataLoss);
            // A disk at its limit must not make many events.
            let is_new = before.is_some_and(|event| {
                let quiet_s = step.at.duration_since(event.event_at).as_secs_f64().abs();
                quiet_s >= CALM_S && without_digits(&event.text) != without_digits(text)
            });
            let event = step.event(Cause::DataLoss, severity, text.to_owned());
            if !step.alarms.raise_or_escalate(event) && is_new {
                step.remark(Cause::DataLoss, text.to_owned());
            }
        } else if self.calm_s >= CALM_S {
            step.clear(Cause::DataLoss, text::DAEMON_CALM.to_owned());
        }
    }

    /// Applies a gap. The alarm states the sum of the gaps since its raise.
    pub(crate) fn on_gap(&mut self, missing: Missing, step: &mut Step) {
        if missing.throws == 0 {
            return;
        }
        (self.since_gap, self.gap_at_s) = (0, unix_s(step.at));
        let before = self.lost;
        self.lost = before.saturating_add(missing.throws);
        self.refused = self.refused.saturating_add(missing.refused);
        let all = Missing { throws: self.lost, refused: self.refused, ..missing };
        let text = text::gap(step.name, &all, step.at);
        if !step.alarms.is_active(Cause::DataLoss) {
            step.raise(step.warning(Cause::DataLoss, text));
        } else if before == 0 || before.ilog2() != self.lost.ilog2() {
            // A flapping link must not make an event of each gap: the sum is reported at each power of two.
            step.remark(Cause::DataLoss, text);
        }
    }

    pub(crate) fn on_irregularity(&mut self, irregularity: Irregularity, step: &mut Step) {
        self.since_gap = 0;
        let text = match irregularity {
            Irregularity::RepeatedTrace => text::machine(step.name, text::REPEATED_TRACE),
            Irregularity::RepeatedNumber => text::machine(step.name, text::REPEATED_NUMBER),
            Irregularity::Invalid { count, reason } => text::invalid(step.name, count, reason),
        };
        step.raise(step.warning(Cause::DataLoss, text));
    }

    /// Forgets the unusable sensor and the usual direction, after a rebaseline.
    pub(crate) fn forget_channel(&mut self) {
        (self.unusable, self.usable, self.usually_contradicted) = (None, 0, None);
    }

    /// Resets the counters after maintenance; keeps the gaps and the logger.
    pub(crate) fn reset(&mut self) {
        *self = Self {
            ticked_at: self.ticked_at,
            usually_contradicted: self.usually_contradicted,
            ended_mm: self.ended_mm,
            since_gap: self.since_gap,
            gap_at_s: self.gap_at_s,
            lost: self.lost,
            refused: self.refused,
            logger: self.logger,
            ..Self::default()
        };
    }
}

/// Applies a change of the watched daemons; `away`: a text about unreachable ones, `None` without any.
pub(crate) fn on_peers(away: Option<String>, step: &mut Step) {
    let cause = Cause::NotMonitored;
    match away {
        None => step.clear(cause, text::PEERS_BACK.to_owned()),
        Some(text) if step.alarms.is_active(cause) => step.remark(cause, text),
        Some(text) => _ = step.raise(step.critical(cause, text)),
    }
}
