//! Charts of a run as SVG: delay and share named right over the size of the fault.

use super::{
    report::{Report, Row, Tally},
    scenario::{Depth, Growth, Noise, Situation},
};
use crate::{
    diagnose::Cause,
    report::{Panel, Sheet},
};

/// A curve: its name, and its value for a row.
type Curve = (&'static str, fn(&Row) -> Option<f64>);

const DELAYS: [Curve; 4] = [
    ("pointsd", |row| row.monitor.delay_median),
    ("the paper's rule", |row| row.paper.delay_median),
    ("CUSUM", |row| row.cusum.delay_median),
    ("pointsd, 95 %", |row| row.monitor.delay_p95),
];
const RIGHT: [Curve; 3] = [
    ("pointsd", |row| Some(right_pct(&row.monitor, row))),
    ("the paper's rule", |row| Some(right_pct(&row.paper, row))),
    ("CUSUM", |row| Some(right_pct(&row.cusum, row))),
];

/// A grid of charts. It has a column for each cause, and rows for delay and share named right, for steps and for ramps.
/// The charts have the rows at parameter depth with default noise and plain conditions. Delays are medians.
pub fn picture(report: &Report) -> String {
    let title = format!("Naming a fault: delay and share right, seed {}", report.seed);
    let mut sheet = Sheet::new(title).columns(Cause::PHYSICAL.len()).panel_size(460.0, 300.0);
    for shape in [Growth::Step, Growth::Ramp] {
        for (quantity, curves) in [("throws to the name", DELAYS.as_slice()), ("named right [%]", RIGHT.as_slice())] {
            for part in Cause::PHYSICAL {
                let rows: Vec<&Row> = report.rows.iter().filter(|row| shown(row, part, shape)).collect();
                let panel = Panel::curves(format!("{part}, {}", shape.as_ref()), "size [% of nominal]", quantity);
                sheet = sheet.panel(curves.iter().fold(panel, |panel, (name, value)| {
                    let points = rows.iter().map(|row| (row.size_pct, value(row).unwrap_or(f64::NAN)));
                    panel.dotted_line(*name, points)
                }));
            }
        }
    }
    sheet.to_svg()
}

fn shown(row: &Row, part: Cause, shape: Growth) -> bool {
    let plain = row.situation == Situation::Plain && row.depth == Depth::Parameter && row.noise == Noise::Default;
    plain && row.parts == [part] && row.shape == shape
}

fn right_pct(tally: &Tally, row: &Row) -> f64 {
    100.0 * tally.right as f64 / row.trials as f64
}
