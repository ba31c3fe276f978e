//! Snapshots of earlier versions of the program, and their conversion to the present form.
//!
//! Early snapshots of version 2 store the owner of an alarm beside the alarm, as a flag of each rule.
//!
//! Snapshots of version 1 have no version number. They store the state of an alarm as flags and all counters of a
//! condition together, and allow a maintenance window without end.

use jiff::Timestamp;
use serde::Deserialize;

use super::{
    AlarmEvent, Cause, SensorChannel,
    alarm::{Acknowledgement, Alarm, Alarms, Maintenance, Rule, State},
    drift::{Beginning, Condition, Ending, History, Onset},
    operation::Operation,
    track::Tracks,
};

/// A snapshot of version 1.
#[derive(Debug, Deserialize)]
pub(super) struct VersionOne {
    pub(super) name: String,
    pub(super) order: u64,
    pub(super) tracks: Tracks,
    pub(super) history: History,
    pub(super) onset: Option<Onset>,
    pub(super) conditions: [ConditionOne; 5],
    pub(super) board: Board,
    pub(super) operation: Operation,
    pub(super) maintenance: Option<Box<Maintenance>>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
pub(super) struct ConditionOne {
    on: u32,
    critical: u32,
    since_raised: Option<u32>,
    #[serde(flatten)]
    ending: Ending,
}

#[derive(Debug, Deserialize)]
pub(super) struct Board {
    alarms: Vec<AlarmOne>,
    latest: Option<Timestamp>,
    occurrences: u64,
    out_of_service: bool,
}

#[derive(Debug, Deserialize)]
struct AlarmOne {
    active: bool,
    acknowledged_by: Option<String>,
    shelved_until: Option<Timestamp>,
    last: AlarmEvent,
}

impl From<Board> for Alarms {
    fn from(board: Board) -> Self {
        let open = board.alarms.into_iter().map(Alarm::from).collect();
        let Board { latest, occurrences, out_of_service, .. } = board;
        Self { open, latest, occurrences, out_of_service, ..Self::default() }
    }
}

impl From<AlarmOne> for Alarm {
    fn from(alarm: AlarmOne) -> Self {
        let acknowledged = alarm.acknowledged_by.map(|by| Acknowledgement { by });
        let state = match (alarm.active, acknowledged) {
            (true, acknowledged) => State::Active { acknowledged },
            (false, None) => State::Cleared,
            (false, Some(_)) => State::Normal,
        };
        let state = match alarm.shelved_until {
            Some(until) => State::Shelved { until, beneath: Box::new(state) },
            None => state,
        };
        Self { state, ..Self::cleared(Rule::Usual, alarm.last) }
    }
}

impl ConditionOne {
    /// Converts a condition; `active`: whether its alarm is active.
    pub(super) fn now(self, active: bool) -> Condition {
        let onset = Beginning { named: self.on, critical: self.critical };
        if !active {
            return Condition::Quiet { onset, since_raised: self.since_raised };
        }
        let since_raised = self.since_raised.unwrap_or_default();
        Condition::Raised { onset, since_raised, ending: Box::new(self.ending) }
    }
}

/// The version of a snapshot. For early snapshots of version 2 also the owners of the alarms: for each rule, the cause
/// or the sensor of the alarm that it owns; and the reason why the machine is not monitored.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Header {
    pub(super) version: Option<u32>,
    features: Flag<bool>,
    start: Flag<bool>,
    drift: OfDrift,
    instruments: Flag<Option<SensorChannel>>,
    operation: OfOperation,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct OfDrift {
    intermittent: Flag<Option<Cause>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct OfOperation {
    unmonitored: Option<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Flag<T> {
    alarmed: T,
}

impl Header {
    /// Sets the owners of the alarms.
    pub(super) fn give_owners(&self, alarms: &mut Alarms) {
        let of_sensor = self.instruments.alarmed.filter(|channel| alarms.faulty_sensor() == Some(*channel));
        let is_unmonitored =
            |reason: &str| (self.operation.unmonitored.as_deref() == Some(reason)).then_some(Cause::NotMonitored);
        let owners = [
            (self.start.alarmed.then_some(Cause::Unattributed), Rule::Start),
            (self.features.alarmed.then_some(Cause::Unattributed), Rule::Features),
            (self.drift.intermittent.alarmed, Rule::Intermittent),
            (of_sensor.map(|_| Cause::Sensor), Rule::Gauges),
            (is_unmonitored("silent"), Rule::Silence),
            (is_unmonitored("two_loggers"), Rule::TwoLoggers),
        ];
        for (cause, rule) in owners {
            if let Some(cause) = cause {
                alarms.set_rule(cause, rule);
            }
        }
    }
}
