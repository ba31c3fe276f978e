//! The common part of the rules about the end of the stroke and about the travel: each compares the last throws of a
//! direction with its normal values.

use serde::{Deserialize, Serialize};

use super::{Gauge, Gauges};
use crate::{
    diagnose::{
        AlarmEvent, Cause, Severity,
        alarm::{OVER_BELOW, RuleResult, Step, count_over},
    },
    throw::Direction,
};

/// Largest number of throws of a direction in a level, which is their median, and least number: some of the last throws
/// may be rejected.
const LEVEL: usize = 6;
const LEAST: usize = 4;

/// Watches a quantity of both directions.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct SideWatch {
    /// Consecutive throws without a change.
    calm: u32,
}

/// The last throws of a direction, with its normal values.
pub(super) struct SideThrows {
    pub(super) direction: Direction,
    /// For two gauges, the normal value and the standard deviation of one throw.
    pub(super) usual: [(f64, f64); 2],
    /// The two gauges in these throws.
    pub(super) throws: Vec<(f64, f64)>,
}

/// The change of a quantity in the last throws of a direction.
pub(super) struct SideChange {
    /// Size relative to the least change that matters and is significant.
    pub(super) size: f64,
    /// Whether the points may stop working when the change grows.
    pub(super) is_worse: bool,
    /// The part of the text about this direction; `None` up to a size of 1.
    pub(super) text: Option<String>,
}

impl SideWatch {
    /// Applies a throw, which the `gauges` contain already. `of`: the gauges that the rule needs; `text`: the text of
    /// the alarm, from the parts of the changed directions, whether a change that is worse and one that is not are
    /// among them, and the number of throws in a level.
    pub(super) fn judge(
        &mut self,
        gauges: &Gauges,
        of: [Gauge; 2],
        change: impl Fn(&SideThrows) -> SideChange,
        text: impl FnOnce(&str, [bool; 2], usize) -> String,
        step: &Step,
    ) -> RuleResult {
        let side = |direction: Direction| {
            let [Some(first), Some(second)] = of.map(|gauge| gauges.normal(direction, gauge)) else { return None };
            let throws: Vec<(f64, f64)> = gauges.pairs(direction, of).take(LEVEL).collect();
            let throws = SideThrows { direction, usual: [first, second], throws };
            Some((throws.throws.len() >= LEAST).then(|| (throws.throws.len(), direction, change(&throws))))
        };
        let sides: Vec<Option<(usize, Direction, SideChange)>> = Direction::BOTH.into_iter().filter_map(side).collect();
        // Incomplete or rejected throws may be those of the direction with the fault: the other does not end its alarm.
        let is_half_seen = sides.iter().any(Option::is_none);
        let largest = sides.iter().flatten().map(|(.., change)| change.size).max_by(f64::total_cmp);
        count_over(&mut self.calm, largest.filter(|size| *size >= OVER_BELOW || !is_half_seen));
        let changed: Vec<_> = sides.into_iter().flatten().filter(|(.., change)| change.size > 1.0).collect();
        let Some(throws) = changed.iter().map(|(throws, ..)| *throws).min() else {
            return RuleResult::after_calm(self.calm, step.settings);
        };
        let is_any = |is_worse: bool| changed.iter().any(|(.., change)| change.is_worse == is_worse);
        let is_critical =
            changed.iter().any(|(.., change)| change.is_worse && change.size > step.settings.critical_factor);
        let severity = if is_critical { Severity::Critical } else { Severity::Warning };
        let direction = if let [(_, only, _)] = changed[..] { Some(only) } else { None };
        let parts: Vec<&str> = changed.iter().filter_map(|(.., change)| change.text.as_deref()).collect();
        let text = text(&parts.join("; "), [is_any(true), is_any(false)], throws);
        let event = step.event(Cause::Unattributed, severity, text);
        RuleResult::Fault(Box::new(AlarmEvent { direction, ..event }))
    }
}
