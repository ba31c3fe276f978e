//! Alarm events about the daemon itself that wait until the database accepts them.

use std::{collections::VecDeque, time::Instant};

use crate::{diagnose::AlarmEvent, store::Outcome};

/// An alarm event about the daemon itself that is not stored yet.
pub(super) struct PendingDaemonAlarm {
    pub(super) outcome: Outcome,
    pub(super) raised: Instant,
    /// Whether it was published already.
    pub(super) published: bool,
}

impl PendingDaemonAlarm {
    /// Adds itself to the queue. It replaces the event before it, if that is of the same alarm and not its raise: in a
    /// long outage the text of an alarm may change every ten minutes.
    pub(super) fn queue(self, queue: &mut VecDeque<Self>) {
        let is_replaced = |event: &AlarmEvent| {
            let is_same = |new: &AlarmEvent| (new.cause, new.raised_at) == (event.cause, event.raised_at);
            event.event_no > 1 && self.outcome.events.iter().any(is_same)
        };
        if queue.back().is_some_and(|last| last.outcome.events.iter().all(is_replaced)) {
            queue.pop_back();
        }
        queue.push_back(self);
    }
}

#[cfg(test)]
mod tests {
    use jiff::{SignedDuration, Timestamp};

    use super::*;
    use crate::{
        daemon::{clock, judge::monitors::Monitors},
        diagnose::{MachineMonitor, Settings, Severity},
        throw::MachineId,
    };

    #[test]
    fn a_long_outage_leaves_the_raise_and_the_last_event_of_an_alarm() {
        let (mut monitors, mut queue) = (Monitors::default(), VecDeque::new());
        let own = MachineId::new("north", "pointsd").unwrap();
        let mut now = Timestamp::UNIX_EPOCH;
        for text in ["a", "b", "c", "d"] {
            now += SignedDuration::from_mins(11);
            let trouble = Some((Severity::Critical, text));
            let update = |monitor: &mut MachineMonitor| monitor.trouble(trouble, now, &Settings::default());
            let outcome = monitors.update(&own, now, update).unwrap();
            PendingDaemonAlarm { outcome, raised: clock::monotonic(), published: true }.queue(&mut queue);
        }
        let events = queue.iter().flat_map(|pending| &pending.outcome.events);
        let left: Vec<_> = events.map(|event| (event.event_no, event.text.as_str())).collect();
        assert_eq!(left, [(1, "a"), (4, "d")]);
    }
}
