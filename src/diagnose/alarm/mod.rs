//! The life cycle of alarms, after ISA-18.2 / IEC 62682 and OPC UA Part 9.
//!
//! A machine has one alarm per cause. An occurrence of the alarm lasts from its raise until its state is `normal`. If
//! the alarm is raised again while it is `cleared_unacknowledged`, the same occurrence continues. The time `raised_at`
//! identifies an occurrence; it is unique for machine and cause, also if the clock is set back.

mod command;
mod rule;
pub(super) mod rule_result;
mod step;

use std::mem;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

pub(super) use command::Maintenance;
pub use command::{Command, CommandError};
pub(super) use rule::Rule;
pub(super) use rule_result::{OVER_BELOW, RuleResult, count_over};
pub(super) use step::Step;

use super::{AlarmEvent, AlarmState, Cause, SensorChannel, Severity, statistics::is_default, text};

/// The operator whose command causes an event, and the reason given; both `None` if the monitor causes it.
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
///   shelve: any state -> Shelved, until the given time, `unshelve` or rebaseline. The shelved state is kept beneath,
///   and events during the shelving change it. Maintenance changes no state; its events show `out_of_service`.
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum State {
    /// The condition exists.
    Active {
        /// `None` until an operator acknowledges the alarm, and again after an escalation.
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
        /// The state without the shelving: one of the other three.
        beneath: Box<State>,
    },
}

/// Operator of an acknowledgement. Its time is that of the event.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Acknowledgement {
    pub(super) by: String,
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
    /// The rule that owns the alarm and clears it.
    #[serde(default, skip_serializing_if = "is_default")]
    pub(super) rule: Rule,
    /// Other rules whose fault was added to the text of the alarm, see [`Alarms::add_fault`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) added: Vec<Rule>,
    /// Whether the alarm is from before a maintenance, and no evidence after it has confirmed it yet.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(super) is_unchecked: bool,
    /// Latest event, with cause, severity and identity.
    pub(super) last: AlarmEvent,
}

impl Alarm {
    pub(super) fn cleared(rule: Rule, last: AlarmEvent) -> Self {
        Self { state: State::Cleared, rule, added: Vec::new(), is_unchecked: false, last }
    }
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
    /// The events since the last [`Self::take_events`].
    #[serde(skip)]
    pub(super) new: Vec<AlarmEvent>,
}

impl Alarms {
    /// Removes and returns the new events, in order. A monitor calls this at the end of every step; the steps before an
    /// observation leave their events to it. So no snapshot contains new events.
    pub(super) fn take_events(&mut self) -> Vec<AlarmEvent> {
        mem::take(&mut self.new)
    }

    fn find(&self, cause: Cause) -> Option<usize> {
        self.open.iter().position(|alarm| alarm.last.cause == cause)
    }

    /// Adds an event with the present state of the alarm at `index`. During maintenance, the event has the state
    /// `OutOfService` instead. An alarm whose event has the state `Normal` is removed.
    fn event(&mut self, index: usize, at: Timestamp, actor: Actor, text: Option<String>) {
        let alarm = &mut self.open[index];
        // A throw may have been made before the raise, and received after it.
        let at = at.max(alarm.last.raised_at);
        let state = if self.out_of_service { AlarmState::OutOfService } else { alarm.state.word() };
        alarm.last.event_no += 1;
        alarm.last.event_at = at;
        alarm.last.state = state;
        alarm.last.by = actor.by.map(str::to_owned);
        alarm.last.why = actor.why.map(str::to_owned);
        alarm.last.over = !alarm.state.is_active();
        match alarm.state.beneath() {
            State::Active { acknowledged } => {
                alarm.last.acknowledged_by = acknowledged.as_ref().map(|acknowledged| acknowledged.by.clone());
            }
            State::Cleared => (alarm.last.acknowledged_by, alarm.last.limit_in_throws) = (None, None),
            // The alarm ended with its acknowledgement or after it, or was never acknowledged.
            State::Normal | State::Shelved { .. } => alarm.last.limit_in_throws = None,
        }
        if let Some(text) = text {
            // An operator's command may only append a sentence to the text of an earlier event, which keeps its time.
            if actor.by.is_none() || !text.starts_with(&alarm.last.text) {
                alarm.last.text_at = Some(at);
            }
            alarm.last.text = text;
        }
        self.new.push(if state == AlarmState::Normal { self.open.remove(index).last } else { alarm.last.clone() });
    }

    /// A unique `raised_at`: `at`, if it is later than all before it. After the clock was set back, it is the
    /// millisecond of `at`, with the number of occurrences (modulo 1000) as microseconds.
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

    /// Raises the alarm of the cause of `event`, which is a draft made by `rule`. An alarm that is active already does
    /// not change, with three exceptions: the usual rule of a cause takes over an alarm whose rule cannot name the
    /// faulty part or whose fault was intermittent, the evidence of an alarm from before a maintenance is replaced, and
    /// a fault without a named part is added to that of another rule. Returns whether the alarm changed.
    pub(super) fn raise(&mut self, rule: Rule, event: AlarmEvent) -> bool {
        match self.find_active(event.cause) {
            Some(alarm) if rule == Rule::Usual && alarm.rule.gives_way() => {
                let severity = alarm.last.severity.max(event.severity);
                self.raise_anew(rule, AlarmEvent { severity, ..event });
                true
            }
            Some(alarm) if !alarm.is_unchecked => {
                event.cause == Cause::Unattributed && alarm.rule != rule && self.add_fault(rule, event)
            }
            _ => {
                self.raise_anew(rule, event);
                true
            }
        }
    }

    /// Adds a fault without a named part to the active alarm about another one, whose rule stays its owner: with a more
    /// severe fault the alarm escalates; one at another place, or intermittent, is added to its text. Each rule adds its
    /// fault once until the text is replaced: a fault that comes and goes must not lengthen the text each time. Returns
    /// whether the alarm changed.
    fn add_fault(&mut self, rule: Rule, event: AlarmEvent) -> bool {
        let Some(index) = self.find(event.cause) else { return false };
        let Alarm { state, rule: owner, added, last, .. } = &mut self.open[index];
        let (owner, is_worse) = (*owner, event.severity > last.severity);
        let is_new = !added.contains(&rule);
        let is_other = is_new && rule.sees_other_faults_than(owner);
        if !is_worse && !is_other {
            return false;
        }
        let text = format!("{} {}", last.text, event.text);
        if is_new {
            added.push(rule);
        }
        if is_worse {
            *state.beneath_mut() = State::Active { acknowledged: None };
            self.renew(index, owner, AlarmEvent { text, ..event });
        } else {
            self.event(index, event.event_at, Actor::default(), Some(text));
        }
        true
    }

    /// Raises the alarm of a cause, or replaces the evidence of its active alarm, which needs a new acknowledgement.
    pub(super) fn raise_anew(&mut self, rule: Rule, event: AlarmEvent) {
        let index = self.find(event.cause).unwrap_or_else(|| {
            let last = AlarmEvent { raised_at: self.unique(event.event_at), ..event.clone() };
            self.open.push(Alarm::cleared(rule, last));
            self.open.len() - 1
        });
        let alarm = &mut self.open[index];
        // The new text is about the fault of this rule alone.
        alarm.added.clear();
        *alarm.state.beneath_mut() = State::Active { acknowledged: None };
        self.renew(index, rule, event);
    }

    /// Raises the alarm about a sensor or the supply. If this alarm is active already, about another sensor, an offset
    /// or another fault of the supply, it changes to the new fault if that `is_new`, and its text still has the fault
    /// before. So one fault does not hide another. An offset waits for the end of a fault that the gauges show, as that
    /// one explains changed values.
    pub(super) fn raise_another(&mut self, rule: Rule, event: AlarmEvent, is_new: bool) -> bool {
        let is_other = |alarm: &&Alarm| {
            let is_kind = alarm.rule != rule && (event.cause == Cause::Supply || alarm.rule == Rule::Offset);
            (alarm.last.channel != event.channel || is_kind) && (alarm.rule, rule) != (Rule::Gauges, Rule::Offset)
        };
        match self.find_active(event.cause).filter(is_other).filter(|_| is_new) {
            Some(before) => {
                let text = text::after_another(&event.text, &before.last.text);
                self.raise_anew(rule, AlarmEvent { text, ..event });
                true
            }
            None => self.raise(rule, event),
        }
    }

    /// The sensor whose alarm explains changed values in a throw. Wrong dates do not change any, and an offset is
    /// subtracted.
    pub(super) fn distorting_sensor(&self) -> Option<SensorChannel> {
        let alarm = self.find_active(Cause::Sensor)?;
        alarm.last.channel.filter(|_| !matches!(alarm.rule, Rule::Dates | Rule::Offset))
    }

    /// The sensor that the active sensor alarm names.
    pub(super) fn faulty_sensor(&self) -> Option<SensorChannel> {
        self.find_active(Cause::Sensor)?.last.channel
    }

    /// Escalates an active alarm to the severity of `event`, if that is higher; the alarm needs a new acknowledgement
    /// then. Returns whether it escalated.
    pub(super) fn escalate(&mut self, rule: Rule, event: AlarmEvent) -> bool {
        let is_worse = self.severity(event.cause).is_some_and(|severity| event.severity > severity);
        if is_worse {
            self.raise_anew(rule, event);
        }
        is_worse
    }

    /// Raises an alarm that is not active or not checked, and escalates another one.
    pub(super) fn raise_or_escalate(&mut self, event: AlarmEvent) -> bool {
        let stands = self.find_active(event.cause).is_some_and(|alarm| !alarm.is_unchecked);
        if stands { self.escalate(Rule::Usual, event) } else { self.raise(Rule::Usual, event) }
    }

    /// Replaces the evidence of an active alarm, and keeps its state. Its text no longer has added faults, which are
    /// added again.
    pub(super) fn update(&mut self, event: AlarmEvent) {
        if let Some(index) = self.find(event.cause).filter(|_| self.is_active(event.cause)) {
            self.open[index].added.clear();
            self.renew(index, Rule::Usual, event);
        }
    }

    fn renew(&mut self, index: usize, rule: Rule, event: AlarmEvent) {
        let alarm = &mut self.open[index];
        let (at, text) = (event.event_at, event.text.clone());
        let AlarmEvent { raised_at, event_no, .. } = alarm.last;
        (alarm.rule, alarm.is_unchecked) = (rule, false);
        alarm.last = AlarmEvent { raised_at, event_no, ..event };
        self.event(index, at, Actor::default(), Some(text));
    }

    /// Takes over an open alarm of a monitor whose snapshot was lost. The alarm becomes a cleared one; it ends at once
    /// if its cause has an open alarm already.
    pub(super) fn adopt(&mut self, last: AlarmEvent, text: String, at: Timestamp) {
        let is_over = self.find(last.cause).is_some();
        let state = if is_over { State::Normal } else { State::Cleared };
        self.open.push(Alarm { state, ..Alarm::cleared(Rule::Usual, last) });
        // During maintenance too, as only the first alarm of a cause would be found later.
        let out_of_service = self.out_of_service;
        self.out_of_service &= !is_over;
        self.event(self.open.len() - 1, at, Actor::default(), Some(text));
        self.out_of_service = out_of_service;
    }

    /// Adds an event with a text to an open alarm, without a change of its state. See [`Self::update`].
    pub(super) fn remark(&mut self, cause: Cause, text: String, at: Timestamp) {
        if let Some(index) = self.find(cause) {
            self.open[index].added.clear();
            self.event(index, at, Actor::default(), Some(text));
        }
    }

    /// Clears the alarm of `cause`, if it is active.
    pub(super) fn clear(&mut self, cause: Cause, text: String, at: Timestamp) {
        let Some(index) = self.find(cause) else { return };
        let alarm = &mut self.open[index];
        let State::Active { acknowledged } = alarm.state.beneath() else { return };
        let cleared = if acknowledged.is_some() { State::Normal } else { State::Cleared };
        *alarm.state.beneath_mut() = cleared;
        self.event(index, at, Actor::default(), Some(text));
    }

    /// Acknowledges an alarm; a cleared alarm ends with this.
    pub(super) fn acknowledge(&mut self, cause: Cause, by: &str, at: Timestamp) -> Result<(), CommandError> {
        let index = self.find(cause).ok_or(CommandError::NoSuchAlarm(cause))?;
        let Alarm { state, last, .. } = &mut self.open[index];
        match state.beneath_mut() {
            State::Active { acknowledged: Some(before) } => {
                return Err(CommandError::AlreadyAcknowledged { cause, by: before.by.clone() });
            }
            State::Active { acknowledged } => *acknowledged = Some(Acknowledgement { by: by.to_owned() }),
            over => {
                *over = State::Normal;
                last.acknowledged_by = Some(by.to_owned());
            }
        }
        self.event(index, at, Actor { by: Some(by), why: None }, None);
        Ok(())
    }

    /// Shelves an alarm until a time; a second shelving replaces the time.
    pub(super) fn shelve(
        &mut self,
        cause: Cause,
        until: Timestamp,
        actor: Actor,
        at: Timestamp,
    ) -> Result<(), CommandError> {
        let index = self.find(cause).ok_or(CommandError::NoSuchAlarm(cause))?;
        let state = &mut self.open[index].state;
        *state = State::Shelved { until, beneath: Box::new(state.beneath().clone()) };
        self.event(index, at, actor, None);
        Ok(())
    }

    /// Ends the shelving.
    pub(super) fn unshelve(&mut self, cause: Cause, actor: Actor, at: Timestamp) -> Result<(), CommandError> {
        let index = self.find(cause).ok_or(CommandError::NoSuchAlarm(cause))?;
        let state = &mut self.open[index].state;
        let State::Shelved { beneath, .. } = state else { return Err(CommandError::NotShelved(cause)) };
        *state = (**beneath).clone();
        self.event(index, at, actor, None);
        Ok(())
    }

    /// Limits the ends of all shelvings to `latest`, and ends the shelvings that are due.
    pub(super) fn unshelve_due(&mut self, now: Timestamp, latest: Timestamp) {
        let cause_if_due = |alarm: &mut Alarm| match &mut alarm.state {
            State::Shelved { until, .. } => {
                *until = latest.min(*until);
                (*until <= now).then_some(alarm.last.cause)
            }
            _ => None,
        };
        let due: Vec<Cause> = self.open.iter_mut().filter_map(cause_if_due).collect();
        for cause in due {
            let _ = self.unshelve(cause, Actor::default(), now);
        }
    }

    /// Takes the machine out of service or back into it, and adds an event to every open alarm.
    pub(super) fn set_out_of_service(&mut self, out: bool, actor: Actor, at: Timestamp) {
        self.out_of_service = out;
        let open: Vec<Cause> = self.open.iter().map(|alarm| alarm.last.cause).collect();
        for cause in open {
            let Some(index) = self.find(cause) else { continue };
            let Alarm { state, is_unchecked, last, .. } = &mut self.open[index];
            *is_unchecked = !out && state.is_active();
            let text = is_unchecked.then(|| text::before_maintenance(&last.text));
            self.event(index, at, actor, text);
        }
    }

    /// Ends an alarm of any state, as acknowledged by `actor`.
    pub(super) fn close(&mut self, cause: Cause, text: String, actor: Actor, at: Timestamp) {
        if let Some(index) = self.find(cause) {
            self.open[index].state = State::Normal;
            self.event(index, at, actor, Some(text));
        }
    }

    pub(super) fn is_active(&self, cause: Cause) -> bool {
        self.find_active(cause).is_some()
    }

    /// The rule that owns the active alarm of `cause`.
    pub(super) fn rule(&self, cause: Cause) -> Option<Rule> {
        self.find_active(cause).map(|alarm| alarm.rule)
    }

    /// The cause of the active alarm that `rule` owns.
    pub(super) fn owned_by(&self, rule: Rule) -> Option<Cause> {
        self.active_alarms().find(|alarm| alarm.rule == rule).map(|alarm| alarm.last.cause)
    }

    /// The causes of the active alarms whose rule gives way to the usual one, oldest first.
    pub(super) fn giving_way(&self) -> impl Iterator<Item = Cause> {
        self.active_alarms().filter(|alarm| alarm.rule.gives_way()).map(|alarm| alarm.last.cause)
    }

    /// The active alarm of `cause`.
    pub(super) fn find_active(&self, cause: Cause) -> Option<&Alarm> {
        self.active_alarms().find(|alarm| alarm.last.cause == cause)
    }

    /// Severity of an active alarm.
    pub(super) fn severity(&self, cause: Cause) -> Option<Severity> {
        self.find_active(cause).map(|alarm| alarm.last.severity)
    }

    fn active_alarms(&self) -> impl Iterator<Item = &Alarm> {
        self.open.iter().filter(|alarm| alarm.state.is_active())
    }

    /// The latest events of the active alarms, oldest first.
    pub(super) fn active(&self) -> impl Iterator<Item = &AlarmEvent> {
        self.active_alarms().map(|alarm| &alarm.last)
    }

    /// The active alarms about a drift of the coefficients, oldest first.
    pub(super) fn drifts(&self) -> impl Iterator<Item = &AlarmEvent> {
        let is_of_coefficients = |alarm: &&Alarm| alarm.last.cause.is_drift() && !alarm.rule.knows_no_part();
        self.active_alarms().filter(is_of_coefficients).map(|alarm| &alarm.last)
    }

    /// The latest event of every open alarm, oldest first.
    pub(super) fn events(&self) -> impl Iterator<Item = &AlarmEvent> {
        self.open.iter().map(|alarm| &alarm.last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::{LimitForecast, Settings};

    const AT: Timestamp = Timestamp::constant(1_000_000, 0);

    fn step<T>(make: impl FnOnce(&Step) -> T) -> T {
        let settings = Settings::default();
        make(&Step { alarms: &mut Alarms::default(), name: "21B", at: AT, throw: None, settings: &settings })
    }

    fn unattributed(severity: Severity, text: &str) -> AlarmEvent {
        step(|step| step.event(Cause::Unattributed, severity, text.to_owned()))
    }

    #[test]
    fn an_offset_at_its_limit_is_one_event_and_takes_no_explanation_away() {
        let of = |channel| step(|step| step.sensor(channel, "wrong".to_owned()));
        let mut alarms = Alarms::default();
        assert!(alarms.raise_another(Rule::Offset, of(SensorChannel::Current), true));
        assert!(!alarms.raise_another(Rule::Offset, of(SensorChannel::Current), true), "the same offset again");
        assert!(alarms.raise_another(Rule::Offset, of(SensorChannel::Position), true), "that of another sensor");
        assert!(alarms.raise_another(Rule::Gauges, of(SensorChannel::Position), true), "its gain");
        assert!(!alarms.raise_another(Rule::Offset, of(SensorChannel::Current), true));
        assert_eq!(alarms.distorting_sensor(), Some(SensorChannel::Position));
    }

    #[test]
    fn an_added_fault_stays_in_the_text_or_is_added_again() {
        let mut alarms = Alarms::default();
        let warning = |text| unattributed(Severity::Warning, text);
        let text = |alarms: &Alarms| alarms.open[0].last.text.clone();
        alarms.raise(Rule::Features, warning("Charge."));
        assert!(alarms.raise(Rule::End, warning("End.")) && !alarms.raise(Rule::End, warning("End.")));
        assert_eq!(text(&alarms), "Charge. End.");
        alarms.remark(Cause::Unattributed, "More charge.".to_owned(), AT);
        assert!(alarms.raise(Rule::End, warning("End.")));
        assert_eq!(text(&alarms), "More charge. End.");
        assert!(alarms.raise(Rule::End, unattributed(Severity::Critical, "Critical end.")));
        assert_eq!(text(&alarms), "More charge. End. Critical end.");
        assert!(!alarms.raise(Rule::End, unattributed(Severity::Critical, "Critical end.")));
    }

    #[test]
    fn an_alarm_that_is_over_has_no_forecast_and_no_event_is_before_the_raise() {
        let forecast = LimitForecast { low: 10.0, mid: 20.0, high: 30.0 };
        let drift = AlarmEvent { limit_in_throws: Some(forecast), ..unattributed(Severity::Warning, "Drift.") };
        for is_closed in [true, false] {
            let mut alarms = Alarms::default();
            alarms.raise(Rule::Usual, drift.clone());
            let (before, over) = (Timestamp::UNIX_EPOCH, "Over.".to_owned());
            if is_closed {
                alarms.close(Cause::Unattributed, over, Actor::default(), before);
            } else {
                alarms.clear(Cause::Unattributed, over, before);
            }
            let [raised, ended] = &alarms.take_events()[..] else { panic!("two events") };
            assert_eq!((raised.limit_in_throws, ended.limit_in_throws), (Some(forecast), None));
            assert_eq!((ended.event_at, ended.text_at), (AT, Some(AT)));
        }
    }
}
