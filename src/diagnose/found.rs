//! What a rule finds in the last throws, and its alarm.

use super::{
    alarm::{Alarms, Evidence},
    event::{AlarmEvent, Cause, SensorChannel, Severity},
    operational::Context,
    rule::Rule,
    text,
};
use crate::throw::ThrowRef;

/// Part of its limit below which a fault has ended. One that is raised above its limit stays between the two, so its alarm
/// does not alternate.
const OVER_BELOW: f64 = 0.5;

/// Counts the consecutive throws in which a fault has ended; `size` is that of the measured quantity, as part of its limit.
/// Without a size the count stays.
pub(super) fn count_over(over: &mut u32, size: Option<f64>) {
    *over = match size {
        Some(size) if size < OVER_BELOW => over.saturating_add(1),
        Some(_) => 0,
        None => *over,
    };
}

/// What a rule finds in the last throws.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Found {
    /// A fault.
    Fault(Cause, Box<Evidence>),
    /// A fault that is much larger than when it was last reported.
    Larger(Cause, Box<Evidence>),
    /// No fault, for long enough to end an alarm.
    Nothing,
    /// Neither.
    Unclear,
}

impl Found {
    /// A drift without a named part.
    pub(super) fn unnamed(severity: Severity, throw: Option<&ThrowRef>, text: String) -> Self {
        Self::Fault(Cause::Unattributed, Box::new(Evidence::plain(severity, throw, text)))
    }

    /// Raises or ends the alarm of `rule`. A fault that a present alarm explains raises none.
    pub(super) fn apply(
        self,
        rule: Rule,
        alarms: &mut Alarms,
        Context { name, at, .. }: Context,
    ) -> Option<AlarmEvent> {
        match (alarms.owned_by(rule), self) {
            (Some(cause), Self::Nothing) => {
                let supply = alarms.is_active(Cause::Supply) && rule.knows_no_part();
                let text =
                    if supply { text::explained(name, Cause::Supply) } else { text::cleared(name, cause, false) };
                alarms.clear(cause, text, at)
            }
            (Some(cause), Self::Fault(_, evidence) | Self::Larger(_, evidence))
                if alarms.severity(cause).is_some_and(|severity| evidence.severity > severity) =>
            {
                alarms.escalate(cause, Evidence { rule, ..*evidence }, at)
            }
            (Some(cause), Self::Larger(_, evidence)) => alarms.remark(cause, evidence.text, at),
            (None, Self::Fault(cause, evidence) | Self::Larger(cause, evidence))
                if !alarms.active().any(|event| event.cause == Cause::Unattributed || explains(event, alarms)) =>
            {
                alarms.raise(cause, Evidence { rule, ..*evidence }, at)
            }
            _ => None,
        }
    }
}

/// Ends the alarm of a rule that knows no part, when another alarm names the part or the sensor.
pub(super) fn withdraw_explained(alarms: &mut Alarms, Context { name, at, .. }: Context) -> Option<AlarmEvent> {
    let part = alarms.active().find(|event| explains(event, alarms))?.cause;
    let unnamed = [Rule::Features, Rule::Start].into_iter().find_map(|rule| alarms.owned_by(rule))?;
    alarms.clear(unnamed, text::explained(name, part), at)
}

/// Whether this alarm names the part, or the sensor, that changes the features and the start of a throw. A changed supply
/// explains some of them and not all, so the features are compared without what it explains. An offset of a
/// sensor does not change them.
fn explains(event: &AlarmEvent, alarms: &Alarms) -> bool {
    use SensorChannel::{Clock, Current, Position};
    Cause::PHYSICAL.contains(&event.cause)
        || event.cause == Cause::Sensor
            && matches!(event.channel, Some(Current | Position | Clock))
            && alarms.rule(Cause::Sensor) != Some(Rule::Offset)
}
