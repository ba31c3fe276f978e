//! A changed current at the end of the stroke: the force that closes or locks the points has grown, or is lost. The window
//! of the estimate ends before it, so neither coefficients nor ratios show it. The next step is points that do not lock.

use serde::{Deserialize, Serialize};

use super::{Gauge, Gauges, mean};
use crate::{
    diagnose::{
        AlarmEvent, Cause, Severity,
        alarm::{RuleResult, Step, count_over},
        statistics::{Level, median, moving_range_sd},
        text,
    },
    throw::Direction,
};

/// Change that matters, as part of the larger of running current and current at the end. On healthy machines the rise is
/// constant within some hundredths of this; a rise of 1 doubles the current.
const RISE: f64 = 0.3;
/// Number of throws of a direction in a level, which is their median.
const LEVEL: usize = 6;
/// Least significant change: in standard deviations of one throw while the normal value was learned, and in standard
/// deviations of a level with the scatter of its throws. A force that grows may scatter by much more than before.
const SIGNIFICANT_SD: f64 = 4.0;
/// Standard deviation of a median of [`LEVEL`] values, as part of that of one value.
const OF_MEDIAN: f64 = 0.5;

/// Watches the current at the end of the stroke.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct EndWatch {
    /// Consecutive throws without a change.
    calm: u32,
}

/// The current at the end of the stroke in the last throws of a direction.
#[derive(Debug, Clone, Copy, PartialEq)]
struct EndChange {
    direction: Direction,
    /// Rise that the running current does not explain \[A\]; negative for a fall.
    rise_a: Level,
    /// Current that the running current explains \[A\].
    expected_a: f64,
    /// Change of the logarithm of the running current.
    running: f64,
    /// Size relative to the least change that matters and is significant.
    size: f64,
}

impl EndChange {
    /// `None` if the gauges or their normal values are unknown, or with too few throws.
    ///
    /// A changed motor or sensor changes the whole current by a factor, so the difference between end and running
    /// current too. Friction over the whole stroke leaves this difference as it was. So all differences between these
    /// two are explained.
    fn of(gauges: &Gauges, direction: Direction) -> Option<Self> {
        let ((usual_a, usual_sd), (usual_running, _)) =
            (gauges.normal(direction, Gauge::EndRise)?, gauges.normal(direction, Gauge::Running)?);
        let throws: Vec<(f64, f64)> = gauges.pairs(direction, [Gauge::EndRise, Gauge::Running]).take(LEVEL).collect();
        if throws.len() < LEVEL {
            return None;
        }
        let unexplained = |(end_a, running): &(f64, f64)| {
            let scaled_a = usual_a * (running - usual_running).exp();
            end_a - end_a.clamp(usual_a.min(scaled_a), usual_a.max(scaled_a))
        };
        let rises: Vec<f64> = throws.iter().map(unexplained).collect();
        let sd = OF_MEDIAN * usual_sd.max(moving_range_sd(std::slice::from_ref(&rises)));
        let rise_a = Level { value: median(&mut rises.clone()), sd };
        let running = median(&mut throws.iter().map(|(_, running)| *running).collect::<Vec<f64>>());
        let now_a = running.exp() + median(&mut throws.iter().map(|(end_a, _)| *end_a).collect::<Vec<f64>>());
        // With a spring, the running current of one direction may be small.
        let running_a = mean(&gauges.normals(Gauge::Running).map(f64::exp).collect::<Vec<f64>>());
        let matters = RISE * running_a.max(usual_running.exp() + usual_a);
        let size = rise_a.value.abs() / matters.max(SIGNIFICANT_SD * usual_sd.max(sd));
        Some(Self { direction, rise_a, expected_a: now_a - rise_a.value, running: running - usual_running, size })
    }

    fn text(&self) -> String {
        text::end_change(self.direction, self.expected_a, self.rise_a, self.running)
    }
}

impl EndWatch {
    /// Applies a throw, which the `gauges` contain already.
    pub(crate) fn judge(&mut self, gauges: &Gauges, step: &Step) -> RuleResult {
        let changes: Vec<EndChange> =
            Direction::BOTH.into_iter().filter_map(|direction| EndChange::of(gauges, direction)).collect();
        let largest = changes.iter().map(|change| change.size).max_by(f64::total_cmp);
        count_over(&mut self.calm, largest);
        let changed: Vec<&EndChange> = changes.iter().filter(|change| change.size > 1.0).collect();
        if changed.is_empty() {
            return RuleResult::after_calm(self.calm, step.settings);
        }
        // Points whose lock or spring gives less force still close.
        let has_risen = changed.iter().any(|change| change.rise_a.value > 0.0);
        let is_critical = has_risen && largest.is_some_and(|size| size > step.settings.critical_factor);
        let severity = if is_critical { Severity::Critical } else { Severity::Warning };
        let direction = if let [only] = changed[..] { Some(only.direction) } else { None };
        let changes: Vec<String> = changed.iter().map(|change| change.text()).collect();
        let event = step.event(Cause::Unattributed, severity, text::end(step.name, &changes, has_risen, LEVEL));
        RuleResult::Fault(Box::new(AlarmEvent { direction, ..event }))
    }
}
