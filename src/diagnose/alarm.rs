//! The life cycle of alarms, in the words of ISA-18.2 / IEC 62682 and OPC UA Part 9.
//!
//! ```text
//!                 raise                       acknowledge
//!   normal ---------------> active_           ----------> active_
//!     ^  ^                  unacknowledged                acknowledged
//!     |  |                   |   ^  ^                      |   |
//!     |  |             clear |   |  '---- gets critical ---'   | clear
//!     |  |                   v   | raise                       |
//!     |  '--- acknowledge -- cleared_                          |
//!     |                      unacknowledged                    |
//!     '--------------------------------------------------------'
//!
//!   shelve: any state -> shelved, until the time, `unshelve` or rebaseline; then the state it would have without
//!   maintenance: any state -> out_of_service, until its end; then the state it had
//! ```
//!
//! One alarm per cause: raised again while `cleared_unacknowledged` it goes on; after `normal` it is a new one. An
//! occurrence is known by its `raised_at`, which no other occurrence of the cause shares, whatever the clock does.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::{
    correlation::Correlation,
    event::{AlarmEvent, AlarmState, Cause, RunnerUp, Severity},
    trend::LimitForecast,
};
use crate::throw::{Direction, ThrowRef};

/// What speaks for an alarm.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Evidence {
    pub(super) severity: Severity,
    pub(super) change_pct: Option<f64>,
    pub(super) change_pct_sd: Option<f64>,
    pub(super) direction: Option<Direction>,
    pub(super) runner_up: Option<RunnerUp>,
    pub(super) correlation: Option<Correlation>,
    pub(super) first_throw: Option<ThrowRef>,
    pub(super) last_throw: Option<ThrowRef>,
    pub(super) limit_in_throws: Option<LimitForecast>,
    pub(super) text: String,
}

impl Evidence {
    /// Of an alarm that is not about a drift.
    pub(super) fn plain(severity: Severity, throw: Option<&ThrowRef>, text: String) -> Self {
        Self {
            severity,
            change_pct: None,
            change_pct_sd: None,
            direction: None,
            runner_up: None,
            correlation: None,
            first_throw: throw.cloned(),
            last_throw: throw.cloned(),
            limit_in_throws: None,
            text,
        }
    }
}

/// Who acted, and why.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Actor<'a> {
    pub(super) by: Option<&'a str>,
    pub(super) why: Option<&'a str>,
}

/// One occurrence of an alarm: not yet back to normal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Alarm {
    active: bool,
    acknowledged_by: Option<String>,
    shelved_until: Option<Timestamp>,
    /// Its latest event, which also holds cause, severity and identity.
    last: AlarmEvent,
}

/// The alarms of one machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Board {
    alarms: Vec<Alarm>,
    /// Latest time of raising that was ever given.
    latest: Option<Timestamp>,
    /// Occurrences of any alarm so far.
    occurrences: u64,
    out_of_service: bool,
}

impl Alarm {
    fn state(&self, out_of_service: bool) -> AlarmState {
        match (out_of_service, self.shelved_until, self.active, &self.acknowledged_by) {
            (true, ..) => AlarmState::OutOfService,
            (_, Some(_), ..) => AlarmState::Shelved,
            (_, _, true, None) => AlarmState::ActiveUnacknowledged,
            (_, _, true, Some(_)) => AlarmState::ActiveAcknowledged,
            (_, _, false, None) => AlarmState::ClearedUnacknowledged,
            (_, _, false, Some(_)) => AlarmState::Normal,
        }
    }
}

impl Board {
    fn find(&self, cause: Cause) -> Option<usize> {
        self.alarms.iter().position(|alarm| alarm.last.cause == cause)
    }

    /// Notes an event of the alarm at `at`; an alarm that is normal again leaves the board.
    fn note(&mut self, index: usize, at: Timestamp, actor: Actor, text: Option<String>) -> AlarmEvent {
        let alarm = &mut self.alarms[index];
        let state = alarm.state(self.out_of_service);
        alarm.last.event_no += 1;
        alarm.last.event_at = at;
        alarm.last.state = state;
        alarm.last.by = actor.by.map(str::to_owned);
        alarm.last.why = actor.why.map(str::to_owned);
        if let Some(text) = text {
            alarm.last.text = text;
        }
        if state == AlarmState::Normal { self.alarms.remove(index).last } else { alarm.last.clone() }
    }

    /// A time of raising that no other occurrence has: the clock's, or, when that was set back behind an earlier
    /// one, the clock's millisecond with the count of occurrences for its microseconds.
    fn unique(&mut self, at: Timestamp) -> Timestamp {
        self.occurrences += 1;
        let unique = if self.latest.is_none_or(|latest| at > latest) {
            at
        } else {
            let count = i64::try_from(self.occurrences % 1000).unwrap_or_default();
            Timestamp::from_microsecond(at.as_millisecond() * 1000 + count).unwrap_or(at)
        };
        self.latest = self.latest.max(Some(unique));
        unique
    }

    /// The condition of `cause` began. Nothing happens to an alarm that is active already.
    pub(super) fn raise(&mut self, cause: Cause, evidence: Evidence, at: Timestamp) -> Option<AlarmEvent> {
        if self.is_active(cause) {
            return None;
        }
        let index = if let Some(index) = self.find(cause) {
            index
        } else {
            let raised_at = self.unique(at);
            self.alarms.push(Alarm {
                active: false,
                acknowledged_by: None,
                shelved_until: None,
                last: blank(cause, raised_at),
            });
            self.alarms.len() - 1
        };
        let alarm = &mut self.alarms[index];
        alarm.active = true;
        alarm.acknowledged_by = None;
        let text = take_evidence(&mut alarm.last, evidence);
        Some(self.note(index, at, Actor::default(), Some(text)))
    }

    /// The condition got worse: a higher severity of an active alarm, which has to be seen again.
    pub(super) fn escalate(&mut self, cause: Cause, evidence: Evidence, at: Timestamp) -> Option<AlarmEvent> {
        let index = self.find(cause)?;
        let alarm = &mut self.alarms[index];
        if !alarm.active || evidence.severity <= alarm.last.severity {
            return None;
        }
        alarm.acknowledged_by = None;
        let text = take_evidence(&mut alarm.last, evidence);
        Some(self.note(index, at, Actor::default(), Some(text)))
    }

    /// Something new about an active alarm, which stays as it is.
    pub(super) fn remark(&mut self, cause: Cause, text: String, at: Timestamp) -> Option<AlarmEvent> {
        let index = self.find(cause)?;
        Some(self.note(index, at, Actor::default(), Some(text)))
    }

    /// The condition of `cause` went away.
    pub(super) fn clear(&mut self, cause: Cause, text: String, actor: Actor, at: Timestamp) -> Option<AlarmEvent> {
        let index = self.find(cause)?;
        if !std::mem::replace(&mut self.alarms[index].active, false) {
            return None;
        }
        self.alarms[index].last.limit_in_throws = None;
        Some(self.note(index, at, actor, Some(text)))
    }

    /// Somebody has seen it. `Err` holds who did before; `None` when no such alarm is open.
    pub(super) fn acknowledge(&mut self, cause: Cause, by: &str, at: Timestamp) -> Option<Result<AlarmEvent, String>> {
        let index = self.find(cause)?;
        if let Some(before) = &self.alarms[index].acknowledged_by {
            return Some(Err(before.clone()));
        }
        self.alarms[index].acknowledged_by = Some(by.to_owned());
        Some(Ok(self.note(index, at, Actor { by: Some(by), why: None }, None)))
    }

    pub(super) fn shelve(&mut self, cause: Cause, until: Timestamp, actor: Actor, at: Timestamp) -> Option<AlarmEvent> {
        let index = self.find(cause)?;
        self.alarms[index].shelved_until = Some(until);
        Some(self.note(index, at, actor, None))
    }

    /// Ends shelving. The inner `None`: it is not shelved.
    #[expect(clippy::option_option, reason = "no alarm, and an alarm that is not shelved, are answered differently")]
    pub(super) fn unshelve(&mut self, cause: Cause, actor: Actor, at: Timestamp) -> Option<Option<AlarmEvent>> {
        let index = self.find(cause)?;
        Some(self.alarms[index].shelved_until.take().map(|_| self.note(index, at, actor, None)))
    }

    /// Ends the shelving whose time has come.
    pub(super) fn unshelve_due(&mut self, now: Timestamp) -> Vec<AlarmEvent> {
        let is_due = |alarm: &&Alarm| alarm.shelved_until.is_some_and(|until| until <= now);
        let due: Vec<Cause> = self.alarms.iter().filter(is_due).map(|alarm| alarm.last.cause).collect();
        due.into_iter().filter_map(|cause| self.unshelve(cause, Actor::default(), now).flatten()).collect()
    }

    /// Takes the machine out of service or back: every open alarm shows it.
    pub(super) fn set_out_of_service(&mut self, out: bool, actor: Actor, at: Timestamp) -> Vec<AlarmEvent> {
        self.out_of_service = out;
        let open: Vec<Cause> = self.alarms.iter().map(|alarm| alarm.last.cause).collect();
        open.into_iter()
            .filter_map(|cause| {
                let index = self.find(cause)?;
                Some(self.note(index, at, actor, None))
            })
            .collect()
    }

    /// Closes an alarm for good, acknowledged by who ended its reason.
    pub(super) fn close(&mut self, cause: Cause, text: String, actor: Actor, at: Timestamp) -> Option<AlarmEvent> {
        let index = self.find(cause)?;
        let alarm = &mut self.alarms[index];
        alarm.active = false;
        alarm.shelved_until = None;
        alarm.acknowledged_by = Some(actor.by.unwrap_or_default().to_owned());
        Some(self.note(index, at, actor, Some(text)))
    }

    pub(super) fn is_active(&self, cause: Cause) -> bool {
        self.alarms.iter().any(|alarm| alarm.active && alarm.last.cause == cause)
    }

    /// Severity of an active alarm.
    pub(super) fn severity(&self, cause: Cause) -> Option<Severity> {
        self.alarms.iter().find(|alarm| alarm.active && alarm.last.cause == cause).map(|alarm| alarm.last.severity)
    }

    /// The direction of an active alarm: the inner `None` is both.
    #[expect(clippy::option_option, reason = "no alarm is not an alarm in both directions")]
    pub(super) fn direction(&self, cause: Cause) -> Option<Option<Direction>> {
        self.alarms.iter().find(|alarm| alarm.active && alarm.last.cause == cause).map(|alarm| alarm.last.direction)
    }

    /// The active alarms, oldest first.
    pub(super) fn active(&self) -> impl Iterator<Item = &AlarmEvent> {
        self.alarms.iter().filter(|alarm| alarm.active).map(|alarm| &alarm.last)
    }

    /// The latest event of every open alarm, oldest first.
    pub(super) fn open(&self) -> impl Iterator<Item = &AlarmEvent> {
        self.alarms.iter().map(|alarm| &alarm.last)
    }
}

fn blank(cause: Cause, raised_at: Timestamp) -> AlarmEvent {
    AlarmEvent {
        cause,
        raised_at,
        event_no: 0,
        severity: Severity::Warning,
        state: AlarmState::Normal,
        event_at: raised_at,
        change_pct: None,
        change_pct_sd: None,
        direction: None,
        runner_up: None,
        correlation: None,
        first_throw: None,
        last_throw: None,
        text: String::new(),
        limit_in_throws: None,
        by: None,
        why: None,
    }
}

fn take_evidence(event: &mut AlarmEvent, evidence: Evidence) -> String {
    event.severity = evidence.severity;
    event.change_pct = evidence.change_pct;
    event.change_pct_sd = evidence.change_pct_sd;
    event.direction = evidence.direction;
    event.runner_up = evidence.runner_up;
    event.correlation = evidence.correlation;
    event.first_throw = evidence.first_throw;
    event.last_throw = evidence.last_throw;
    event.limit_in_throws = evidence.limit_in_throws;
    evidence.text
}
