//! The alarm message (JSON) on `points/v1/{site}/{machine}/alarm`: one event of an alarm.

use std::ops::Deref;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::json_bytes;
use crate::{
    diagnose::{AlarmEvent, Cause, without_operator},
    throw::{MachineId, without_digits},
};

/// An alarm event with its alarm and machine. Consumers deduplicate on (`alarm_id`, `event_no`, `event_at`): after a
/// backup was restored, an event number may be used again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// Always [`Alarm::SCHEMA`].
    pub schema: String,
    /// Identity of the alarm, from [`alarm_id`].
    pub alarm_id: String,
    /// The machine: `site` and `machine` in JSON.
    #[serde(flatten)]
    pub machine: MachineId,
    /// The event with its evidence.
    #[serde(flatten)]
    pub event: AlarmEvent,
}

/// Direct access to the fields of the event, which are fields of the alarm in JSON too.
impl Deref for Alarm {
    type Target = AlarmEvent;

    fn deref(&self) -> &AlarmEvent {
        &self.event
    }
}

impl Alarm {
    /// Name and version of the message.
    pub const SCHEMA: &str = "points.alarm/1";

    /// The message of an event of an alarm of `machine`.
    pub fn new(machine: &MachineId, event: &AlarmEvent) -> Self {
        Self {
            schema: Self::SCHEMA.to_owned(),
            alarm_id: alarm_id(machine, event.cause, event.raised_at),
            machine: machine.clone(),
            event: event.clone(),
        }
    }

    /// The message without the operators' names and reasons and without boots: these stay in the database.
    #[must_use]
    pub fn published(mut self) -> Self {
        self.event.text = without_operator(&self.event.text);
        (self.event.by, self.event.why, self.event.acknowledged_by) = (None, None, None);
        for throw in [&mut self.event.first_throw, &mut self.event.last_throw].into_iter().flatten() {
            throw.boot_id.clear();
        }
        self
    }

    /// The published message as JSON.
    pub fn into_message(self) -> Vec<u8> {
        json_bytes(&self.published())
    }
}

/// The identity of an alarm: machine, cause, and the time at which it was raised. A daemon that judges a throw again
/// after a crash makes the same identity.
pub fn alarm_id(machine: &MachineId, cause: Cause, raised_at: Timestamp) -> String {
    format!("{}.{}.{}.{}", machine.site, machine.machine, cause.as_str(), raised_at.as_microsecond())
}

/// The text of an alarm without its subject, such as "Machine north/21B, normal to reverse: ".
pub fn without_subject(text: &str) -> &str {
    text.split_once(": ").map_or(text, |(_, rest)| rest)
}

/// The text of an alarm without its subject and its numbers. Lists group the alarms of many machines by it, as one
/// cause may have several kinds of alarms: lost throws and a wrong clock have the same cause.
pub fn kind_of(text: &str) -> String {
    without_digits(without_subject(text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        diagnose::{AlarmState, Correlation, LimitForecast, RunnerUp, Severity},
        throw::{Direction, ThrowRef},
        wire::json,
    };

    #[test]
    fn the_message_has_exactly_the_fields_of_the_contract() {
        let at: Timestamp = "2026-05-04T10:11:12Z".parse().unwrap();
        let event = AlarmEvent {
            cause: Cause::IncompleteThrow,
            raised_at: at,
            event_no: 2,
            severity: Severity::Critical,
            state: AlarmState::ActiveUnacknowledged,
            event_at: at,
            change_pct: Some(18.0),
            change_pct_sd: None,
            direction: Some(Direction::NormalToReverse),
            channel: None,
            runner_up: Some(RunnerUp { cause: Cause::Kt, margin: 3.5 }),
            correlation: Some(Correlation { b0_a1: 0.1, b0_a0: 0.2, a1_a0: 0.3 }),
            first_throw: Some(ThrowRef { boot_id: "b".into(), throw_no: 7 }),
            last_throw: None,
            text: "Machine north/21B: a new baseline is being taken (somebody: some reason).".into(),
            text_at: Some(at),
            over: false,
            acknowledged_by: Some("somebody".into()),
            limit_in_throws: Some(LimitForecast { low: 1.0, mid: 2.0, high: 3.0 }),
            by: Some("somebody".into()),
            why: None,
        };
        let alarm = Alarm::new(&MachineId::new("north", "21B").unwrap(), &event);
        assert_eq!(serde_json::from_str::<Alarm>(&json(&alarm)).unwrap(), alarm, "the database keeps all of it");
        let message = alarm.into_message();
        let expected = serde_json::json!({
            "schema": "points.alarm/1", "alarm_id": "north.21B.incomplete_throw.1777889472000000", "event_no": 2,
            "site": "north", "machine": "21B", "cause": "incomplete_throw", "severity": "critical",
            "state": "active_unacknowledged", "raised_at": "2026-05-04T10:11:12Z", "event_at": "2026-05-04T10:11:12Z",
            "change_pct": 18.0, "change_pct_sd": null, "direction": "normal_to_reverse",
            "runner_up": {"cause": "kt", "margin": 3.5}, "correlation": {"b0_a1": 0.1, "b0_a0": 0.2, "a1_a0": 0.3},
            "first_throw_no": 7, "last_throw_no": null, "text": "Machine north/21B: a new baseline is being taken.", "text_at": "2026-05-04T10:11:12Z",
            "limit_in_throws": {"low": 1.0, "mid": 2.0, "high": 3.0},
        });
        assert_eq!(serde_json::from_slice::<serde_json::Value>(&message).unwrap(), expected);
    }
}
