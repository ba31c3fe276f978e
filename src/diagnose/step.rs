//! One step of a monitor: the alarms that a rule may change, with machine, time and throw of their events.

use jiff::Timestamp;

use super::{
    alarm::Alarms,
    event::{AlarmEvent, Cause, Severity},
    rule::Rule,
    settings::Settings,
};
use crate::throw::ThrowRef;

/// A step of a monitor, for its rules.
pub(super) struct Step<'a> {
    pub(super) alarms: &'a mut Alarms,
    /// Name of the machine in texts.
    pub(super) name: &'a str,
    pub(super) at: Timestamp,
    pub(super) throw: Option<&'a ThrowRef>,
    pub(super) settings: &'a Settings,
}

impl Step<'_> {
    /// The draft of an event, with the throw as evidence.
    pub(super) fn event(&self, cause: Cause, severity: Severity, text: String) -> AlarmEvent {
        AlarmEvent::draft(cause, severity, self.throw, text, self.at)
    }

    pub(super) fn warning(&self, cause: Cause, text: String) -> AlarmEvent {
        self.event(cause, Severity::Warning, text)
    }

    pub(super) fn critical(&self, cause: Cause, text: String) -> AlarmEvent {
        self.event(cause, Severity::Critical, text)
    }

    /// Raises the alarm of the usual rule of a cause. Returns whether it changed.
    pub(super) fn raise(&mut self, event: AlarmEvent) -> bool {
        self.alarms.raise(Rule::Usual, event)
    }

    pub(super) fn clear(&mut self, cause: Cause, text: String) {
        self.alarms.clear(cause, text, self.at);
    }

    /// Adds an event with a text to an open alarm.
    pub(super) fn remark(&mut self, cause: Cause, text: String) {
        self.alarms.remark(cause, text, self.at);
    }
}
