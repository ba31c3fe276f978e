//! The alarm message (JSON): one event in the life of an alarm, as `points/v1/{site}/{machine}/alarm` carries it.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::{
    diagnose::{AlarmEvent, AlarmState, Cause, Correlation, LimitForecast, RunnerUp, Severity},
    throw::{Direction, MachineId},
};

/// One alarm event. Consumers deduplicate on (`alarm_id`, `event_no`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// Always [`Alarm::SCHEMA`].
    pub schema: String,
    /// Which alarm; see [`alarm_id`].
    pub alarm_id: String,
    /// +1 per event of the alarm, from 1.
    pub event_no: u32,
    /// The site.
    pub site: String,
    /// The machine.
    pub machine: String,
    /// What it is about.
    pub cause: Cause,
    /// How bad.
    pub severity: Severity,
    /// The state that the event led to.
    pub state: AlarmState,
    /// When this occurrence of the alarm was raised.
    pub raised_at: Timestamp,
    /// When the event happened.
    pub event_at: Timestamp,
    /// Size of the drift \[% from baseline\].
    pub change_pct: Option<f64>,
    /// Its standard deviation \[%\].
    pub change_pct_sd: Option<f64>,
    /// The direction in which it shows; null for both.
    pub direction: Option<Direction>,
    /// The next best cause.
    pub runner_up: Option<RunnerUp>,
    /// The three cross-correlations of the inertia estimates.
    pub correlation: Option<Correlation>,
    /// First throw of the evidence.
    pub first_throw_no: Option<u64>,
    /// Last throw of the evidence.
    pub last_throw_no: Option<u64>,
    /// One plain sentence: what, how sure, what to look at.
    pub text: String,
    /// When it reaches the next limit, in throws.
    pub limit_in_throws: Option<LimitForecast>,
}

impl Alarm {
    /// The version of the message.
    pub const SCHEMA: &str = "points.alarm/1";

    /// The message for an event of this machine.
    #[must_use]
    pub fn new(machine: &MachineId, event: &AlarmEvent) -> Self {
        Self {
            schema: Self::SCHEMA.to_owned(),
            alarm_id: alarm_id(machine, event.cause, event.raised_at),
            event_no: event.event_no,
            site: machine.site.to_string(),
            machine: machine.machine.to_string(),
            cause: event.cause,
            severity: event.severity,
            state: event.state,
            raised_at: event.raised_at,
            event_at: event.event_at,
            change_pct: event.change_pct,
            change_pct_sd: event.change_pct_sd,
            direction: event.direction,
            runner_up: event.runner_up,
            correlation: event.correlation,
            first_throw_no: event.first_throw.as_ref().map(|throw| throw.throw_no),
            last_throw_no: event.last_throw.as_ref().map(|throw| throw.throw_no),
            text: event.text.clone(),
            limit_in_throws: event.limit_in_throws,
        }
    }

    /// The message as JSON.
    #[must_use]
    pub fn to_json(&self) -> Vec<u8> {
        // Texts and numbers into memory: nothing in it can fail.
        serde_json::to_vec(self).unwrap_or_default()
    }
}

/// The identity of one occurrence of an alarm: machine, cause and the moment it was raised, so that a monitor that
/// repeats its work after a crash gives the same alarm the same name.
#[must_use]
pub fn alarm_id(machine: &MachineId, cause: Cause, raised_at: Timestamp) -> String {
    let cause = serde_json::to_value(cause).ok();
    let word = cause.as_ref().and_then(serde_json::Value::as_str).unwrap_or_default();
    format!("{}.{}.{word}.{}", machine.site, machine.machine, raised_at.as_microsecond())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::throw::ThrowRef;

    #[test]
    fn the_message_has_exactly_the_promised_fields() {
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
            runner_up: Some(RunnerUp { cause: Cause::Kt, margin: 3.5 }),
            correlation: Some(Correlation { b0_a1: 0.1, b0_a0: 0.2, a1_a0: 0.3 }),
            first_throw: Some(ThrowRef { boot_id: "b".into(), throw_no: 7 }),
            last_throw: None,
            text: "what".into(),
            limit_in_throws: Some(LimitForecast { low: 1.0, mid: 2.0, high: 3.0 }),
            by: Some("somebody".into()),
            why: None,
        };
        let message = Alarm::new(&MachineId::new("north", "21B").unwrap(), &event).to_json();
        let expected = serde_json::json!({
            "schema": "points.alarm/1", "alarm_id": "north.21B.incomplete_throw.1777889472000000", "event_no": 2,
            "site": "north", "machine": "21B", "cause": "incomplete_throw", "severity": "critical",
            "state": "active_unacknowledged", "raised_at": "2026-05-04T10:11:12Z", "event_at": "2026-05-04T10:11:12Z",
            "change_pct": 18.0, "change_pct_sd": null, "direction": "normal_to_reverse",
            "runner_up": {"cause": "kt", "margin": 3.5}, "correlation": {"b0_a1": 0.1, "b0_a0": 0.2, "a1_a0": 0.3},
            "first_throw_no": 7, "last_throw_no": null, "text": "what",
            "limit_in_throws": {"low": 1.0, "mid": 2.0, "high": 3.0},
        });
        assert_eq!(serde_json::from_slice::<serde_json::Value>(&message).unwrap(), expected);
    }
}
