//! A changed travel of a toe whose movement is judged: the points stop at another place. The coefficients of the movement
//! before it stay as they were. A configured stroke shows a single short throw; this rule needs none.

use serde::{Deserialize, Serialize};

use super::{Gauge, Gauges};
use crate::{
    diagnose::{
        AlarmEvent, Cause, Severity,
        alarm::{RuleResult, Step, count_over},
        statistics::median,
        text,
    },
    throw::Direction,
};

/// Loss of travel that matters, as a logarithm: 5 mm of 120 mm, the gap that a lock must detect. A longer stroke was
/// adjusted, or misses its stop.
const SHORTER: f64 = 0.04;
const LONGER: f64 = 0.1;
/// Number of throws of a direction in a level, which is their median.
const LEVEL: usize = 6;
/// Least significant change, in standard deviations of one throw.
const SIGNIFICANT_SD: f64 = 4.0;
/// Least change of the duration, as part of that of the travel. A position sensor with another gain leaves the duration.
const OF_DURATION: f64 = 0.5;

/// Watches the travel.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct TravelWatch {
    /// Consecutive throws without a change.
    calm: u32,
}

/// The travel in the last throws of a direction.
#[derive(Debug, Clone, Copy, PartialEq)]
struct TravelChange {
    direction: Direction,
    /// Normal travel, and that of the last throws \[mm\].
    from_to_mm: [f64; 2],
    /// Size relative to the least change that matters and is significant; 0 if the duration has not changed.
    size: f64,
}

impl TravelChange {
    /// `None` if the normal values are unknown, or with too few throws.
    fn of(gauges: &Gauges, direction: Direction) -> Option<Self> {
        let ((usual, sd), (usual_duration, _)) =
            (gauges.normal(direction, Gauge::Travel)?, gauges.normal(direction, Gauge::Duration)?);
        let throws: Vec<(f64, f64)> = gauges.pairs(direction, [Gauge::Travel, Gauge::Duration]).take(LEVEL).collect();
        if throws.len() < LEVEL {
            return None;
        }
        let (mut travels, mut durations): (Vec<f64>, Vec<f64>) = throws.into_iter().unzip();
        let now = median(&mut travels);
        let (change, of_duration) = (now - usual, median(&mut durations) - usual_duration);
        let matters = if change < 0.0 { SHORTER } else { LONGER };
        let is_of_toe = of_duration / change > OF_DURATION;
        let size = if is_of_toe { change.abs() / matters.max(SIGNIFICANT_SD * sd) } else { 0.0 };
        Some(Self { direction, from_to_mm: [usual.exp(), now.exp()], size })
    }
}

impl TravelWatch {
    /// Applies a throw, which the `gauges` contain already.
    pub(crate) fn judge(&mut self, gauges: &Gauges, step: &Step) -> RuleResult {
        let changes: Vec<TravelChange> =
            Direction::BOTH.into_iter().filter_map(|direction| TravelChange::of(gauges, direction)).collect();
        let largest = changes.iter().map(|change| change.size).max_by(f64::total_cmp);
        count_over(&mut self.calm, largest);
        let changed: Vec<&TravelChange> = changes.iter().filter(|change| change.size > 1.0).collect();
        if changed.is_empty() {
            return RuleResult::after_calm(self.calm, step.settings);
        }
        let is_critical = changed.iter().any(|change| {
            let [from_mm, to_mm] = change.from_to_mm;
            to_mm < from_mm && change.size > step.settings.critical_factor
        });
        let severity = if is_critical { Severity::Critical } else { Severity::Warning };
        let direction = if let [only] = changed[..] { Some(only.direction) } else { None };
        let travels: Vec<(Direction, [f64; 2])> =
            changed.iter().map(|change| (change.direction, change.from_to_mm)).collect();
        let event = step.event(Cause::Unattributed, severity, text::travel(step.name, &travels, LEVEL));
        RuleResult::Fault(Box::new(AlarmEvent { direction, ..event }))
    }
}
