//! One step of a monitor: its alarms, with the machine, time and throw for new events.

use jiff::Timestamp;

use super::{Alarms, Rule};
use crate::{
    diagnose::{AlarmEvent, AlarmState, Cause, SensorChannel, Settings, Severity},
    throw::ThrowRef,
};

/// A step of a monitor; every rule gets it.
pub(crate) struct Step<'a> {
    pub(crate) alarms: &'a mut Alarms,
    /// Name of the machine in texts.
    pub(crate) name: &'a str,
    /// Time of the events.
    pub(crate) at: Timestamp,
    /// The throw that is evidence of the events; `None` in a step without one.
    pub(crate) throw: Option<&'a ThrowRef>,
    pub(crate) settings: &'a Settings,
}

impl Step<'_> {
    /// A draft of an event, with the throw as evidence. [`Alarms`] sets its number, time of the raise and state.
    pub(crate) fn event(&self, cause: Cause, severity: Severity, text: String) -> AlarmEvent {
        AlarmEvent {
            cause,
            raised_at: self.at,
            event_no: 0,
            severity,
            state: AlarmState::Normal,
            event_at: self.at,
            change_pct: None,
            change_pct_sd: None,
            direction: None,
            channel: None,
            runner_up: None,
            correlation: None,
            first_throw: self.throw.cloned(),
            last_throw: self.throw.cloned(),
            text,
            text_at: None,
            over: false,
            acknowledged_by: None,
            limit_in_throws: None,
            by: None,
            why: None,
        }
    }

    pub(crate) fn warning(&self, cause: Cause, text: String) -> AlarmEvent {
        self.event(cause, Severity::Warning, text)
    }

    /// A draft of a warning about a sensor or the clock.
    pub(crate) fn sensor(&self, channel: SensorChannel, text: String) -> AlarmEvent {
        AlarmEvent { channel: Some(channel), ..self.warning(Cause::Sensor, text) }
    }

    /// Raises the alarm of a cause for its usual rule. Returns whether the alarm changed.
    pub(crate) fn raise(&mut self, event: AlarmEvent) -> bool {
        self.alarms.raise(Rule::Usual, event)
    }

    /// Clears the alarm of a cause, if it is active; `text` makes the text from the name of the machine.
    pub(crate) fn clear(&mut self, cause: Cause, text: impl FnOnce(&str) -> String) {
        if self.alarms.is_active(cause) {
            self.alarms.clear(cause, text(self.name), self.at);
        }
    }

    /// Adds an event with this text to the open alarm of a cause.
    pub(crate) fn remark(&mut self, cause: Cause, text: String) {
        self.alarms.remark(cause, text, self.at);
    }
}
