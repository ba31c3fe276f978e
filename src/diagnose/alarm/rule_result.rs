//! Result of a rule over the last throws, and its alarm.

use super::{Alarms, Rule, Step};
use crate::diagnose::{AlarmEvent, Cause, SensorChannel, Settings, text};

/// Part of its limit below which a fault has ended. An alarm is raised only above the limit, so it does not alternate.
pub(crate) const OVER_BELOW: f64 = 0.5;

/// Counts the consecutive throws in which a fault has ended; `size` is the measured quantity as part of its limit. If
/// it is `None`, the count stays.
pub(crate) fn count_over(over: &mut u32, size: Option<f64>) {
    *over = match size {
        Some(size) if size < OVER_BELOW => over.saturating_add(1),
        Some(_) => 0,
        None => *over,
    };
}

/// Result of a rule over the last throws.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum RuleResult {
    /// A fault.
    Fault(Box<AlarmEvent>),
    /// A fault that is much larger than at its last report.
    Larger(Box<AlarmEvent>),
    /// No fault, for long enough to end an alarm.
    Nothing,
    /// The last throws show neither a fault nor its end.
    Unclear,
}

impl RuleResult {
    /// The result without a fault, which has ended for `calm` throws.
    pub(crate) fn after_calm(calm: u32, settings: &Settings) -> Self {
        if calm >= settings.off_delay_throws { Self::Nothing } else { Self::Unclear }
    }

    /// Raises, escalates or ends the alarm of `rule`. A fault without a named part raises no alarm if an active alarm
    /// explains it.
    pub(crate) fn apply(self, rule: Rule, step: &mut Step) {
        let Step { alarms, name, .. } = step;
        match (alarms.owned_by(rule), self) {
            (Some(cause), Self::Nothing) => {
                let supply =
                    alarms.is_active(Cause::Supply) && rule.knows_no_part() && rule.is_explained_by(Cause::Supply);
                let text =
                    if supply { text::explained(name, Cause::Supply) } else { text::back_to_normal(name, cause) };
                step.clear(cause, |_| text);
            }
            (Some(cause), Self::Fault(event) | Self::Larger(event))
                if alarms.severity(cause).is_some_and(|severity| event.severity > severity) =>
            {
                alarms.escalate(rule, AlarmEvent { cause, ..*event });
            }
            (Some(cause), Self::Larger(event)) => step.remark(cause, event.text),
            (None, Self::Fault(event) | Self::Larger(event))
                if !(rule.knows_no_part() && alarms.active().any(|event| explains(event, rule, alarms))) =>
            {
                alarms.raise(rule, *event);
            }
            _ => {}
        }
    }
}

/// Ends the alarm of a rule that cannot name the faulty part, if another active alarm names the part or the sensor.
pub(crate) fn withdraw_explained(step: &mut Step) {
    let alarms = &step.alarms;
    let found = [Rule::Features, Rule::Start, Rule::End].into_iter().find_map(|rule| {
        let unnamed = alarms.owned_by(rule)?;
        let part = alarms.active().find(|event| explains(event, rule, alarms))?.cause;
        Some((unnamed, part))
    });
    if let Some((unnamed, part)) = found {
        step.clear(unnamed, |name| text::explained(name, part));
    }
}

/// Whether this alarm names the part, or the sensor, that changes the quantity of `rule` in a throw. A changed
/// supply does not count: the features are compared without the change that it explains. A sensor explains some of the
/// features, so their rule considers it, and it does not explain a rise at the end of the stroke only.
fn explains(event: &AlarmEvent, rule: Rule, alarms: &Alarms) -> bool {
    use SensorChannel::{Clock, Current, Position};
    // The last few throws of an intermittent fault are mostly sound, and so are the features, which are medians.
    let is_median = rule == Rule::Features && alarms.rule(event.cause) == Some(Rule::Intermittent);
    event.cause.is_part() && rule.is_explained_by(event.cause) && !is_median
        || event.cause == Cause::Sensor
            && rule == Rule::Start
            && matches!(alarms.distorting_sensor(), Some(Current | Position | Clock))
}
