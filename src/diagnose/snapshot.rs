//! Snapshots of earlier versions of the program, and their conversion to the present form.
//!
//! Snapshots of version 1 have no version number. They store the state of an alarm as flags and all counters of a
//! condition together, and allow a maintenance window without end.

use jiff::Timestamp;
use serde::Deserialize;

use super::{
    AlarmEvent,
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

/// The version of a snapshot.
#[derive(Debug, Deserialize)]
pub(super) struct Header {
    pub(super) version: Option<u32>,
}
