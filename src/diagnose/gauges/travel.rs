//! A changed travel of a toe whose movement is judged: the points stop at another place. The coefficients of the
//! movement before it stay as they were. A configured stroke shows a single short throw; this rule needs none.

use super::{
    Gauge, Gauges,
    side_watch::{SideChange, SideThrows, SideWatch},
};
use crate::diagnose::{
    alarm::{RuleResult, Step},
    statistics::median,
    text,
};

/// Loss of travel that matters, as a logarithm: 5 mm of 120 mm, the gap that a lock must detect. A longer stroke was
/// adjusted, or misses its stop.
const SHORTER: f64 = 0.04;
const LONGER: f64 = 0.1;
/// Least significant change, in standard deviations of one throw.
const SIGNIFICANT_SD: f64 = 4.0;
/// Least change of the duration, as part of that of the travel. A position sensor with another gain leaves the
/// duration.
const OF_DURATION: f64 = 0.5;

/// Applies a throw, which the `gauges` contain already.
pub(crate) fn judge_travel(watch: &mut SideWatch, gauges: &Gauges, step: &Step) -> RuleResult {
    let text = |changes: &str, ways: [bool; 2], throws: usize| text::travel(step.name, changes, ways, throws);
    watch.judge(gauges, [Gauge::Travel, Gauge::Duration], change, text, step)
}

/// The change of the travel; its size is 0 if the duration has not changed.
fn change(side: &SideThrows) -> SideChange {
    let SideThrows { direction, usual: [(usual, sd), (usual_duration, _)], ref throws } = *side;
    let (mut travels, mut durations): (Vec<f64>, Vec<f64>) = throws.iter().copied().unzip();
    let now = median(&mut travels);
    let (change, of_duration) = (now - usual, median(&mut durations) - usual_duration);
    let matters = if change < 0.0 { SHORTER } else { LONGER };
    let is_of_toe = of_duration / change > OF_DURATION;
    let size = if is_of_toe { change.abs() / matters.max(SIGNIFICANT_SD * sd) } else { 0.0 };
    let text = || text::travel_change(direction, [usual, now].map(f64::exp));
    SideChange { size, is_worse: change < 0.0, text: (size > 1.0).then(text) }
}
