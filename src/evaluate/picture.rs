//! The picture of a run: delay and share named right against the size of the fault, as SVG.

use std::fmt::Write as _;

use super::{
    report::{Report, Row, Tally},
    scenario::{Depth, Noise, PARTS, Shape, Situation},
};

/// One rule's name, colour and tally of a row.
type Rule = (&'static str, &'static str, fn(&Row) -> &Tally);

const RULES: [Rule; 3] = [
    ("the paper's bare rule", "#d95f02", |row| &row.paper),
    ("CUSUM", "#7a7a7a", |row| &row.cusum),
    ("pointsd", "#1b4f9c", |row| &row.monitor),
];

/// Width and height of a panel's axes, and of the cell that it stands in \[px\].
const PANEL: (f64, f64) = (190.0, 110.0);
const CELL: (f64, f64) = (250.0, 170.0);
/// Left of the first cell and above it \[px\].
const MARGIN: (f64, f64) = (60.0, 70.0);

/// What a panel shows.
#[derive(Clone, Copy)]
enum Quantity {
    Delay,
    Right,
}

/// Small multiples: a column for each cause, rows for delay and share named right of steps and of ramps. Parameter depth,
/// default noise, plain conditions. Lines are medians; the band reaches to pointsd's 95th percentile.
#[must_use]
pub fn picture(report: &Report) -> String {
    let panels = [Shape::Step, Shape::Ramp].map(|shape| [(shape, Quantity::Delay), (shape, Quantity::Right)]);
    let panels = panels.concat();
    let width = MARGIN.0 + CELL.0 * PARTS.len() as f64;
    let height = MARGIN.1 + CELL.1 * panels.len() as f64;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"sans-serif\" font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    text(
        &mut svg,
        (16.0, 24.0),
        "start",
        "15",
        &format!("Naming a fault: delay and share right, seed {}", report.seed),
    );
    legend(&mut svg);
    for (line, &(shape, quantity)) in panels.iter().enumerate() {
        for (column, part) in PARTS.iter().enumerate() {
            let origin = (MARGIN.0 + CELL.0 * column as f64, MARGIN.1 + CELL.1 * line as f64);
            let rows: Vec<&Row> = report.rows.iter().filter(|row| shown(row, part.as_str(), shape)).collect();
            panel(&mut svg, origin, &rows, quantity);
            let title = match quantity {
                Quantity::Delay => format!("{part}, {}: throws to the name", shape.as_str()),
                Quantity::Right => format!("{part}, {}: named right, %", shape.as_str()),
            };
            text(&mut svg, (origin.0, origin.1 - 8.0), "start", "12", &title);
        }
    }
    svg.push_str("</svg>\n");
    svg
}

fn shown(row: &Row, part: &str, shape: Shape) -> bool {
    let plain = row.case == Situation::Plain.label() && row.depth == Depth::Parameter && row.noise == Noise::Default;
    plain && row.cause == part && row.shape == shape
}

fn legend(svg: &mut String) {
    let mut x = 16.0;
    for (name, colour, _) in RULES.iter().rev() {
        let _ = writeln!(svg, "<rect x=\"{x}\" y=\"36\" width=\"16\" height=\"4\" fill=\"{colour}\"/>");
        text(svg, (x + 22.0, 42.0), "start", "11", name);
        x += 60.0 + 6.5 * name.len() as f64;
    }
}

fn panel(svg: &mut String, origin: (f64, f64), rows: &[&Row], quantity: Quantity) {
    let value = |tally: &Tally, row: &Row| match quantity {
        Quantity::Delay => tally.delay_median,
        Quantity::Right => Some(100.0 * tally.right as f64 / row.trials as f64),
    };
    let top = match quantity {
        Quantity::Right => 100.0,
        Quantity::Delay => round_up(rows.iter().flat_map(|row| highest_delay(row)).fold(4.0, f64::max)),
    };
    let sizes = || rows.iter().map(|row| row.size_pct);
    let (least, largest) = (sizes().fold(f64::MAX, f64::min), sizes().fold(1.0, f64::max));
    // Logarithmic: sizes are multiples of the limit.
    let x = |size: f64| origin.0 + PANEL.0 * (0.08 + 0.87 * (size / least).ln() / (largest / least).ln().max(1e-9));
    let y = |value: f64| origin.1 + PANEL.1 * (1.0 - value / top);
    for tick in [0.0, 0.5, 1.0] {
        let (at, label) = (y(tick * top), format!("{}", tick * top));
        let _ = writeln!(svg, "<path d=\"M{} {at:.1}h{}\" stroke=\"#dddddd\"/>", origin.0, PANEL.0);
        text(svg, (origin.0 - 5.0, at + 4.0), "end", "10", &label);
    }
    for row in rows {
        text(svg, (x(row.size_pct), origin.1 + PANEL.1 + 14.0), "middle", "10", &format!("{}", row.size_pct));
    }
    text(svg, (origin.0 + PANEL.0, origin.1 + PANEL.1 + 27.0), "end", "10", "size, % of nominal");
    if matches!(quantity, Quantity::Delay) {
        band(svg, rows, &x, &y);
    }
    for (_, colour, tally) in RULES {
        let points = rows.iter().filter_map(|row| Some((x(row.size_pct), y(value(tally(row), row)?))));
        line(svg, &points.collect::<Vec<_>>(), colour);
    }
}

fn highest_delay(row: &Row) -> impl Iterator<Item = f64> {
    let comparators = row.paper.delay_median.into_iter().chain(row.cusum.delay_median);
    comparators.chain(row.monitor.delay_p95)
}

/// The next of 4, 10, 20, 40, 100, 200, … at or above `value`.
fn round_up(value: f64) -> f64 {
    let decade = 10_f64.powf(value.log10().floor());
    [1.0, 2.0, 4.0, 10.0].into_iter().map(|step| step * decade).find(|top| *top >= value).unwrap_or(value)
}

/// From the monitor's median to its 95th percentile.
fn band(svg: &mut String, rows: &[&Row], x: &dyn Fn(f64) -> f64, y: &dyn Fn(f64) -> f64) {
    let edge = |delay: fn(&Tally) -> Option<f64>| {
        rows.iter().filter_map(move |row| Some((x(row.size_pct), y(delay(&row.monitor)?)))).collect::<Vec<_>>()
    };
    let mut outline = edge(|tally| tally.delay_median);
    outline.extend(edge(|tally| tally.delay_p95).into_iter().rev());
    let points: Vec<String> = outline.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let _ = writeln!(svg, "<polygon points=\"{}\" fill=\"#1b4f9c\" fill-opacity=\"0.15\"/>", points.join(" "));
}

fn line(svg: &mut String, points: &[(f64, f64)], colour: &str) {
    let path: Vec<String> = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let path = path.join(" ");
    let _ = writeln!(svg, "<polyline points=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>");
    for (x, y) in points {
        let _ = writeln!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.5\" fill=\"{colour}\"/>");
    }
}

fn text(svg: &mut String, (x, y): (f64, f64), anchor: &str, size: &str, content: &str) {
    let content = content.replace('&', "&amp;").replace('<', "&lt;");
    let _ =
        writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" font-size=\"{size}\">{content}</text>");
}
