//! The life cycle of alarms, after ISA-18.2 / IEC 62682 and OPC UA Part 9.
//!
//! There is one alarm per cause. Raised again while `cleared_unacknowledged`, it continues; after `normal` a new
//! occurrence begins. The time `raised_at` identifies an occurrence; it is unique for the cause, also if the clock is
//! set back.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::{
    command::CommandError,
    correlation::Correlation,
    course::LimitForecast,
    event::{AlarmEvent, AlarmState, Cause, RunnerUp, SensorChannel, Severity},
    rule::Rule,
    text,
};
use crate::throw::{Direction, ThrowRef};

/// The evidence of an alarm: its rule, severity, size, throws and text.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Evidence {
    pub(super) rule: Rule,
    pub(super) severity: Severity,
    pub(super) change_pct: Option<f64>,
    pub(super) change_pct_sd: Option<f64>,
    pub(super) direction: Option<Direction>,
    pub(super) channel: Option<SensorChannel>,
    pub(super) runner_up: Option<RunnerUp>,
    pub(super) correlation: Option<Correlation>,
    pub(super) first_throw: Option<ThrowRef>,
    pub(super) last_throw: Option<ThrowRef>,
    pub(super) limit_in_throws: Option<LimitForecast>,
    pub(super) text: String,
}

impl Evidence {
    /// Evidence of an alarm that is not about a drift.
    pub(super) fn plain(severity: Severity, throw: Option<&ThrowRef>, text: String) -> Self {
        Self {
            rule: Rule::Usual,
            severity,
            change_pct: None,
            change_pct_sd: None,
            direction: None,
            channel: None,
            runner_up: None,
            correlation: None,
            first_throw: throw.cloned(),
            last_throw: throw.cloned(),
            limit_in_throws: None,
            text,
        }
    }
}

/// The operator of an event, with the reason; both `None` for events of the monitor.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Actor<'a> {
    pub(super) by: Option<&'a str>,
    pub(super) why: Option<&'a str>,
}

/// State of an occurrence, from its condition and the operators' commands.
///
/// ```text
///            raise             acknowledge
///   Normal --------> Active --------------> Active
///     ^  ^        (not seen) <------------  (acknowledged)
///     |  |           |   ^    gets critical    |
///     |  |     clear |   | raise               | clear
///     |  |           v   |                     |
///     |  '-------- Cleared                     |
///     | acknowledge                            |
///     '----------------------------------------'
///
///   shelve: any state -> Shelved (over that state), until the time, `unshelve` or rebaseline; events that come
///   meanwhile change the state beneath. Maintenance shows every alarm as out_of_service, and changes none.
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum State {
    /// The condition exists.
    Active {
        /// Acknowledgement since the last escalation.
        acknowledged: Option<Acknowledgement>,
    },
    /// The condition ended before an acknowledgement.
    Cleared,
    /// Acknowledged and cleared: the occurrence is over.
    Normal,
    /// Silenced by an operator.
    Shelved {
        /// End of the shelving.
        until: Timestamp,
        /// The operator who shelved it.
        by: String,
        /// The operator's reason.
        why: String,
        /// The state without the shelving: one of the other three.
        beneath: Box<State>,
    },
}

/// Operator and time of an acknowledgement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Acknowledgement {
    pub(super) by: String,
    pub(super) at: Timestamp,
}

impl State {
    /// The state without shelving.
    fn beneath(&self) -> &Self {
        if let Self::Shelved { beneath, .. } = self { beneath } else { self }
    }

    fn beneath_mut(&mut self) -> &mut Self {
        if let Self::Shelved { beneath, .. } = self { beneath } else { self }
    }

    fn is_active(&self) -> bool {
        matches!(self.beneath(), Self::Active { .. })
    }

    fn word(&self) -> AlarmState {
        match self {
            Self::Active { acknowledged: None } => AlarmState::ActiveUnacknowledged,
            Self::Active { acknowledged: Some(_) } => AlarmState::ActiveAcknowledged,
            Self::Cleared => AlarmState::ClearedUnacknowledged,
            Self::Normal => AlarmState::Normal,
            Self::Shelved { .. } => AlarmState::Shelved,
        }
    }
}

/// An occurrence of an alarm, from the raise until it is normal again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Alarm {
    pub(super) state: State,
    /// The rule that owns the alarm.
    #[serde(default, skip_serializing_if = "is_usual")]
    pub(super) rule: Rule,
    /// Latest event, with cause, severity and identity.
    pub(super) last: AlarmEvent,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference to the field")]
fn is_usual(rule: &Rule) -> bool {
    *rule == Rule::Usual
}

/// The open alarms of one machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Alarms {
    pub(super) open: Vec<Alarm>,
    /// Latest `raised_at` so far.
    pub(super) latest: Option<Timestamp>,
    /// Number of occurrences so far, of all causes.
    pub(super) occurrences: u64,
    pub(super) out_of_service: bool,
}

impl Alarms {
    fn find(&self, cause: Cause) -> Option<usize> {
        self.open.iter().position(|alarm| alarm.last.cause == cause)
    }

    /// Makes the event after a change of the alarm at `index`; removes the alarm if it is normal.
    fn event(&mut self, index: usize, at: Timestamp, actor: Actor, text: Option<String>) -> AlarmEvent {
        let alarm = &mut self.open[index];
        let state = if self.out_of_service { AlarmState::OutOfService } else { alarm.state.word() };
        alarm.last.event_no += 1;
        alarm.last.event_at = at;
        alarm.last.state = state;
        alarm.last.by = actor.by.map(str::to_owned);
        alarm.last.why = actor.why.map(str::to_owned);
        alarm.last.acknowledged_by = match alarm.state.beneath() {
            State::Active { acknowledged: Some(acknowledged) } => Some(acknowledged.by.clone()),
            _ => None,
        };
        if let Some(text) = text {
            alarm.last.text = text;
            // A command adds to the text at most.
            if actor.by.is_none() {
                alarm.last.text_at = Some(at);
            }
        }
        if state == AlarmState::Normal { self.open.remove(index).last } else { alarm.last.clone() }
    }

    /// A unique `raised_at`: the time of the clock. If the clock was set back, its millisecond with the count of
    /// occurrences as microseconds.
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

    /// Raises the alarm of `cause`; no change if it is active already. The usual rule takes over the alarm of a rule that
    /// knows no part.
    pub(super) fn raise(&mut self, cause: Cause, evidence: Evidence, at: Timestamp) -> Option<AlarmEvent> {
        let takes_over = evidence.rule == Rule::Usual && self.rule(cause).is_some_and(Rule::knows_no_part);
        if self.is_active(cause) && !takes_over {
            return None;
        }
        let index = self.find(cause).unwrap_or_else(|| {
            let last = occurrence(cause, self.unique(at), evidence.clone());
            self.open.push(Alarm { state: State::Cleared, rule: evidence.rule, last });
            self.open.len() - 1
        });
        Some(self.activate(index, evidence, at))
    }

    /// Raises the alarm about a sensor or the supply. An alarm that is active about another sensor or by another rule changes to
    /// this fault if the fault `is_new`, so that one alarm does not hide another fault.
    pub(super) fn raise_another(
        &mut self,
        cause: Cause,
        evidence: Evidence,
        is_new: bool,
        at: Timestamp,
    ) -> Option<AlarmEvent> {
        let owner = self.rule(cause);
        let other = self.find_active(cause).is_some_and(|event| event.channel != evidence.channel)
            || cause == Cause::Supply && owner.is_some_and(|rule| rule != evidence.rule)
            || owner == Some(Rule::Offset);
        let index = self.find(cause).filter(|_| other && is_new);
        match index {
            Some(index) => Some(self.activate(index, evidence, at)),
            None => self.raise(cause, evidence, at),
        }
    }

    /// The sensor of the active alarm about one.
    pub(super) fn faulty_sensor(&self) -> Option<SensorChannel> {
        self.find_active(Cause::Sensor)?.channel
    }

    /// Escalates an active alarm to a higher severity; it needs a new acknowledgement.
    pub(super) fn escalate(&mut self, cause: Cause, evidence: Evidence, at: Timestamp) -> Option<AlarmEvent> {
        let worse = self.severity(cause).is_some_and(|severity| evidence.severity > severity);
        let index = self.find(cause).filter(|_| worse)?;
        Some(self.activate(index, evidence, at))
    }

    /// Gives an active alarm new evidence of any severity; it needs a new acknowledgement.
    pub(super) fn turn(&mut self, cause: Cause, evidence: Evidence, at: Timestamp) -> Option<AlarmEvent> {
        let index = self.find(cause).filter(|_| self.is_active(cause))?;
        Some(self.activate(index, evidence, at))
    }

    /// Raises an alarm that is not active, and escalates one that is.
    pub(super) fn raise_or_escalate(&mut self, cause: Cause, evidence: Evidence, at: Timestamp) -> Option<AlarmEvent> {
        if self.is_active(cause) { self.escalate(cause, evidence, at) } else { self.raise(cause, evidence, at) }
    }

    /// Gives an active alarm new evidence, without a change of its state.
    pub(super) fn update(&mut self, cause: Cause, evidence: Evidence, at: Timestamp) -> Option<AlarmEvent> {
        let index = self.find(cause).filter(|_| self.is_active(cause))?;
        Some(self.renew(index, evidence, at))
    }

    fn activate(&mut self, index: usize, evidence: Evidence, at: Timestamp) -> AlarmEvent {
        *self.open[index].state.beneath_mut() = State::Active { acknowledged: None };
        self.renew(index, evidence, at)
    }

    fn renew(&mut self, index: usize, evidence: Evidence, at: Timestamp) -> AlarmEvent {
        let alarm = &mut self.open[index];
        alarm.rule = evidence.rule;
        let AlarmEvent { cause, raised_at, event_no, .. } = alarm.last;
        alarm.last = AlarmEvent { event_no, text_at: Some(at), ..occurrence(cause, raised_at, evidence) };
        self.event(index, at, Actor::default(), None)
    }

    /// Takes over an open alarm of a lost monitor, as cleared; ends it if `cause` has an alarm already.
    pub(super) fn adopt(&mut self, last: AlarmEvent, text: String, at: Timestamp) -> AlarmEvent {
        let state = if self.find(last.cause).is_some() { State::Normal } else { State::Cleared };
        self.open.push(Alarm { state, rule: Rule::Usual, last });
        self.event(self.open.len() - 1, at, Actor::default(), Some(text))
    }

    /// Adds an event with a text to an open alarm, without a change of its state.
    pub(super) fn remark(&mut self, cause: Cause, text: String, at: Timestamp) -> Option<AlarmEvent> {
        let index = self.find(cause)?;
        Some(self.event(index, at, Actor::default(), Some(text)))
    }

    /// Clears the alarm of `cause`.
    pub(super) fn clear(&mut self, cause: Cause, text: String, at: Timestamp) -> Option<AlarmEvent> {
        let index = self.find(cause)?;
        let alarm = &mut self.open[index];
        let State::Active { acknowledged } = alarm.state.beneath() else { return None };
        let cleared = if acknowledged.is_some() { State::Normal } else { State::Cleared };
        *alarm.state.beneath_mut() = cleared;
        alarm.last.limit_in_throws = None;
        // A throw may have been made before the alarm, and received after it.
        let at = at.max(alarm.last.raised_at);
        Some(self.event(index, at, Actor::default(), Some(text)))
    }

    /// Acknowledges an alarm.
    pub(super) fn acknowledge(&mut self, cause: Cause, by: &str, at: Timestamp) -> Result<AlarmEvent, CommandError> {
        let index = self.find(cause).ok_or(CommandError::NoSuchAlarm { cause })?;
        let state = self.open[index].state.beneath_mut();
        *state = match state {
            State::Active { acknowledged: Some(before) } => {
                return Err(CommandError::AlreadyAcknowledged { cause, by: before.by.clone() });
            }
            State::Active { acknowledged: None } => {
                State::Active { acknowledged: Some(Acknowledgement { by: by.to_owned(), at }) }
            }
            _ => State::Normal,
        };
        Ok(self.event(index, at, Actor { by: Some(by), why: None }, None))
    }

    /// Shelves an alarm until a time; a second shelving replaces the time.
    pub(super) fn shelve(
        &mut self,
        cause: Cause,
        until: Timestamp,
        actor: Actor,
        at: Timestamp,
    ) -> Result<AlarmEvent, CommandError> {
        let index = self.find(cause).ok_or(CommandError::NoSuchAlarm { cause })?;
        let state = &mut self.open[index].state;
        let (by, why) = (actor.by.unwrap_or_default().to_owned(), actor.why.unwrap_or_default().to_owned());
        *state = State::Shelved { until, by, why, beneath: Box::new(state.beneath().clone()) };
        Ok(self.event(index, at, actor, None))
    }

    /// Ends the shelving.
    pub(super) fn unshelve(&mut self, cause: Cause, actor: Actor, at: Timestamp) -> Result<AlarmEvent, CommandError> {
        let index = self.find(cause).ok_or(CommandError::NoSuchAlarm { cause })?;
        let state = &mut self.open[index].state;
        let State::Shelved { beneath, .. } = state else { return Err(CommandError::NotShelved { cause }) };
        *state = (**beneath).clone();
        Ok(self.event(index, at, actor, None))
    }

    /// Ends the shelvings that are due.
    pub(super) fn unshelve_due(&mut self, now: Timestamp) -> Vec<AlarmEvent> {
        let is_due = |alarm: &&Alarm| matches!(alarm.state, State::Shelved { until, .. } if until <= now);
        let due: Vec<Cause> = self.open.iter().filter(is_due).map(|alarm| alarm.last.cause).collect();
        due.into_iter().filter_map(|cause| self.unshelve(cause, Actor::default(), now).ok()).collect()
    }

    /// Takes the machine out of service or back, with an event of every open alarm.
    pub(super) fn set_out_of_service(&mut self, out: bool, actor: Actor, at: Timestamp) -> Vec<AlarmEvent> {
        self.out_of_service = out;
        let open: Vec<Cause> = self.open.iter().map(|alarm| alarm.last.cause).collect();
        let event = |cause: Cause| {
            let index = self.find(cause)?;
            let Alarm { state, last, .. } = &self.open[index];
            let is_unchecked = !out && state.is_active();
            let text = is_unchecked.then(|| text::before_maintenance(&last.text));
            Some(self.event(index, at, actor, text))
        };
        open.into_iter().filter_map(event).collect()
    }

    /// Closes an alarm, acknowledged by `actor`.
    pub(super) fn close(&mut self, cause: Cause, text: String, actor: Actor, at: Timestamp) -> Option<AlarmEvent> {
        let index = self.find(cause)?;
        self.open[index].state = State::Normal;
        Some(self.event(index, at, actor, Some(text)))
    }

    pub(super) fn is_active(&self, cause: Cause) -> bool {
        self.find_active(cause).is_some()
    }

    /// The rule that owns the active alarm of `cause`.
    pub(super) fn rule(&self, cause: Cause) -> Option<Rule> {
        self.in_force().find(|alarm| alarm.last.cause == cause).map(|alarm| alarm.rule)
    }

    /// The cause of the active alarm that `rule` owns.
    pub(super) fn owned_by(&self, rule: Rule) -> Option<Cause> {
        self.in_force().find(|alarm| alarm.rule == rule).map(|alarm| alarm.last.cause)
    }

    /// Gives the alarm of `cause` an owner, as read from a snapshot.
    pub(super) fn give(&mut self, cause: Cause, rule: Rule) {
        if let Some(index) = self.find(cause) {
            self.open[index].rule = rule;
        }
    }

    fn find_active(&self, cause: Cause) -> Option<&AlarmEvent> {
        self.active().find(|event| event.cause == cause)
    }

    /// Severity of an active alarm.
    pub(super) fn severity(&self, cause: Cause) -> Option<Severity> {
        self.find_active(cause).map(|event| event.severity)
    }

    fn in_force(&self) -> impl Iterator<Item = &Alarm> {
        self.open.iter().filter(|alarm| alarm.state.is_active())
    }

    /// The latest events of the active alarms, oldest first.
    pub(super) fn active(&self) -> impl Iterator<Item = &AlarmEvent> {
        self.in_force().map(|alarm| &alarm.last)
    }

    /// The active alarms about a drift of the coefficients, oldest first.
    pub(super) fn drifts(&self) -> impl Iterator<Item = &AlarmEvent> {
        let is_of_coefficients = |alarm: &&Alarm| alarm.last.cause.is_drift() && !alarm.rule.knows_no_part();
        self.in_force().filter(is_of_coefficients).map(|alarm| &alarm.last)
    }

    /// The latest event of every open alarm, oldest first.
    pub(super) fn events(&self) -> impl Iterator<Item = &AlarmEvent> {
        self.open.iter().map(|alarm| &alarm.last)
    }
}

/// The event of an occurrence, before its number, time and state are set.
fn occurrence(cause: Cause, raised_at: Timestamp, evidence: Evidence) -> AlarmEvent {
    AlarmEvent {
        cause,
        raised_at,
        event_no: 0,
        severity: evidence.severity,
        state: AlarmState::Normal,
        event_at: raised_at,
        change_pct: evidence.change_pct,
        change_pct_sd: evidence.change_pct_sd,
        direction: evidence.direction,
        channel: evidence.channel,
        runner_up: evidence.runner_up,
        correlation: evidence.correlation,
        first_throw: evidence.first_throw,
        last_throw: evidence.last_throw,
        text: evidence.text,
        text_at: None,
        acknowledged_by: None,
        limit_in_throws: evidence.limit_in_throws,
        by: None,
        why: None,
    }
}
