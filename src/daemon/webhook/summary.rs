//! The summary of many alarm events in one message.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::Serialize;

use crate::{
    diagnose::{AlarmState, Cause, Severity},
    throw::{MachineId, Name},
    wire::Alarm,
};

/// Largest number of machines named in a group.
const NAMED: usize = 20;

/// Many alarm events as one message.
#[derive(Debug, Serialize)]
pub(super) struct Summary {
    schema: &'static str,
    /// Name of the daemon.
    monitor: String,
    events: usize,
    first_event_at: Timestamp,
    last_event_at: Timestamp,
    /// Events of the same kind, the most frequent first.
    groups: Vec<Group>,
    /// The whole summary as one sentence.
    text: String,
}

/// Events with the same cause, severity and state at one site.
#[derive(Debug, Serialize)]
struct Group {
    cause: Cause,
    severity: Severity,
    state: AlarmState,
    site: Name,
    events: usize,
    /// The first machines by name, at most 20.
    machines: Vec<Name>,
}

impl Summary {
    /// The summary of some alarm events, of at least one.
    pub(super) fn of(alarms: Vec<&Alarm>, monitor: &MachineId) -> Self {
        let mut kinds: BTreeMap<_, Vec<&Alarm>> = BTreeMap::new();
        let events = alarms.len();
        let (first, last) = alarms.iter().fold((Timestamp::MAX, Timestamp::MIN), |(first, last), alarm| {
            (first.min(alarm.event_at), last.max(alarm.event_at))
        });
        for alarm in alarms {
            let kind = (alarm.machine.site.as_str(), alarm.cause.as_str(), alarm.severity, alarm.state.as_str());
            kinds.entry(kind).or_default().push(alarm);
        }
        let mut groups: Vec<Group> = kinds.into_values().filter_map(|of| Group::of(&of)).collect();
        groups.sort_by_key(|group| std::cmp::Reverse((group.severity, group.events)));
        let kinds: Vec<String> = groups.iter().take(NAMED).map(Group::sentence).collect();
        let more = if groups.len() > NAMED { ", and others" } else { "" };
        Self {
            schema: "points.alarm_summary/1",
            monitor: monitor.to_string(),
            events,
            first_event_at: first,
            last_event_at: last,
            text: format!("{events} alarm events: {}{more}.", kinds.join(", ")),
            groups,
        }
    }
}

impl Group {
    fn of(alarms: &[&Alarm]) -> Option<Self> {
        let first = alarms.first()?;
        let mut machines: Vec<Name> = alarms.iter().map(|alarm| alarm.machine.machine.clone()).collect();
        machines.sort();
        machines.dedup();
        machines.truncate(NAMED);
        Some(Self {
            cause: first.cause,
            severity: first.severity,
            state: first.state,
            site: first.machine.site.clone(),
            events: alarms.len(),
            machines,
        })
    }

    /// A part of the text, as "480 not monitored at north (critical, active unacknowledged)".
    fn sentence(&self) -> String {
        let state = self.state.as_str().replace('_', " ");
        format!("{} {} at {} ({}, {state})", self.events, self.cause, self.site, self.severity.as_str())
    }
}
