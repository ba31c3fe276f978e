//! A changed current at the end of the stroke: the force that closes or locks the points has grown, or is lost. The
//! window of the estimate ends before it, so neither coefficients nor ratios show it. The next step is points that do
//! not lock.

use super::{
    Gauge, Gauges, mean,
    side_watch::{SideChange, SideThrows, SideWatch},
};
use crate::diagnose::{
    alarm::{RuleResult, Step},
    statistics::{Level, median, moving_range_sd},
    text,
};

/// Change that matters, as part of the larger of running current and current at the end. On healthy machines the rise
/// is constant within some hundredths of this; a rise of 1 doubles the current.
const RISE: f64 = 0.3;
/// Least significant change: in standard deviations of one throw while the normal value was learned, and in standard
/// deviations of a level with the scatter of its throws. A force that grows may scatter by much more than before.
const SIGNIFICANT_SD: f64 = 4.0;
/// Standard deviation of a median of four values or more, as part of that of one value; of six it is 0.5.
const OF_MEDIAN: f64 = 0.6;

/// Applies a throw, which the `gauges` contain already.
pub(crate) fn judge_end(watch: &mut SideWatch, gauges: &Gauges, step: &Step) -> RuleResult {
    // With a spring, the running current of one direction may be small.
    let running_a = mean(&gauges.normals(Gauge::Running).map(f64::exp).collect::<Vec<f64>>());
    let text = |changes: &str, ways: [bool; 2], throws: usize| text::end(step.name, changes, ways, throws);
    watch.judge(gauges, [Gauge::EndRise, Gauge::Running], |side| change(side, running_a), text, step)
}

/// The change of the rise at the end of the stroke that the running current does not explain. `running_a`: normal
/// running current of both directions \[A\].
///
/// A changed motor or sensor changes the whole current by a factor, so the difference between end and running current
/// too. Friction over the whole stroke leaves this difference as it was. So all differences between these two are
/// explained.
fn change(side: &SideThrows, running_a: f64) -> SideChange {
    let SideThrows { direction, usual: [(usual_a, usual_sd), (usual_running, _)], ref throws } = *side;
    let unexplained = |(end_a, running): &(f64, f64)| {
        let scaled_a = usual_a * (running - usual_running).exp();
        end_a - end_a.clamp(usual_a.min(scaled_a), usual_a.max(scaled_a))
    };
    let rises: Vec<f64> = throws.iter().map(unexplained).collect();
    let sd = OF_MEDIAN * usual_sd.max(moving_range_sd(std::slice::from_ref(&rises)));
    let rise_a = Level { value: median(&mut rises.clone()), sd };
    let running = median(&mut throws.iter().map(|(_, running)| *running).collect::<Vec<f64>>());
    let now_a = running.exp() + median(&mut throws.iter().map(|(end_a, _)| *end_a).collect::<Vec<f64>>());
    let matters = RISE * running_a.max(usual_running.exp() + usual_a);
    let size = rise_a.value.abs() / matters.max(SIGNIFICANT_SD * usual_sd.max(sd));
    let text = || text::end_change(direction, now_a - rise_a.value, rise_a, running - usual_running);
    // Points whose lock or spring gives less force still close.
    SideChange { size, is_worse: rise_a.value > 0.0, text: (size > 1.0).then(text) }
}
