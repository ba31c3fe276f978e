//! A chart: curves over an x axis, or bars in groups.

use serde::{Serialize, Serializer};

use super::axis::Axis;
use super::svg::{Anchor, Canvas};

/// Colours that people with colour blindness can distinguish (Okabe and Ito, 2008).
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#555555"];
/// Typical width of a character of 12 px \[px\]. Only the viewer of an SVG knows the true width.
const CHARACTER: f64 = 6.8;
/// Least space between neighbouring names or labels \[px\].
const GAP: f64 = 10.0;
/// Space left of the axes \[px\].
const LEFT: f64 = 72.0;
/// Space right of the axes \[px\].
const MARGIN: f64 = 24.0;
/// Colour of the grid.
const GRID: &str = "#dddddd";
/// Colour of the axes.
const FRAME: &str = "#444444";

#[derive(Debug, Clone, Serialize)]
#[serde(untagged)]
enum Content {
    Curves { x_label: String, times: bool, curves: Vec<Curve> },
    Bars { categories: Vec<String>, groups: Vec<(String, Vec<f64>)> },
}

#[derive(Debug, Clone, Serialize)]
struct Curve {
    name: String,
    #[serde(serialize_with = "short")]
    points: Vec<(f64, f64)>,
    /// Half the width of the band around the curve, one value for each point; empty for no band.
    reach: Vec<f64>,
    dots: bool,
}

/// Writes each y with five digits, more than a screen resolves, to keep the JSON short.
fn short<S: Serializer>(points: &[(f64, f64)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(points.iter().map(|(x, y)| (x, format!("{y:.4e}").parse().unwrap_or(*y))))
}

/// A chart with its title, axes and legend. The script of the dashboard, which draws charts too, reads its JSON.
#[derive(Debug, Clone, Serialize)]
#[must_use]
pub struct Panel {
    title: String,
    y_label: String,
    /// Dashed horizontal lines, each with its y and label.
    levels: Vec<(f64, String)>,
    /// Dashed vertical lines of a chart of curves, each with its x and label.
    marks: Vec<(f64, String)>,
    #[serde(flatten)]
    content: Content,
}

/// The rectangle that the axes enclose \[px\], with the y axis.
struct Frame {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
    y: Axis,
}

impl Frame {
    fn y_of(&self, value: f64) -> Option<f64> {
        self.y.place(value).map(|place| self.top + self.height * (1.0 - place))
    }
}

impl Panel {
    /// An empty chart of curves.
    pub fn curves(title: impl Into<String>, x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self::with(title, y_label, Content::Curves { x_label: x_label.into(), times: false, curves: Vec::new() })
    }

    /// An empty chart of curves over time \[s since 1970\], with dates and times in UTC on the x axis.
    pub fn history(title: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self::with(title, y_label, Content::Curves { x_label: "UTC".to_owned(), times: true, curves: Vec::new() })
    }

    /// An empty chart of bars. Each group has one bar for each of the `categories`, in the colour of the category.
    pub fn bars<S: Into<String>>(
        title: impl Into<String>,
        y_label: impl Into<String>,
        categories: impl IntoIterator<Item = S>,
    ) -> Self {
        let categories = categories.into_iter().map(Into::into).collect();
        Self::with(title, y_label, Content::Bars { categories, groups: Vec::new() })
    }

    fn with(title: impl Into<String>, y_label: impl Into<String>, content: Content) -> Self {
        Self { title: title.into(), y_label: y_label.into(), levels: Vec::new(), marks: Vec::new(), content }
    }

    /// Adds a curve of (x, y); a value that is not finite interrupts it. Ignored by a chart of bars.
    pub fn line(self, name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.curve(name, points.into_iter().collect(), Vec::new(), false)
    }

    /// Adds a curve with a dot at every point. Ignored by a chart of bars.
    pub fn dotted_line(self, name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.curve(name, points.into_iter().collect(), Vec::new(), true)
    }

    /// Adds a curve with a band: each point is x, y and half the width of the band. Ignored by a chart of bars.
    pub fn banded_line(self, name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64, f64)>) -> Self {
        let (points, reach) = points.into_iter().map(|(x, y, reach)| ((x, y), reach)).unzip();
        self.curve(name, points, reach, false)
    }

    fn curve(mut self, name: impl Into<String>, points: Vec<(f64, f64)>, reach: Vec<f64>, dots: bool) -> Self {
        if let Content::Curves { curves, .. } = &mut self.content {
            curves.push(Curve { name: name.into(), points, reach, dots });
        }
        self
    }

    /// Adds a group of bars, one value for each category. Ignored by a chart of curves.
    pub fn group(mut self, name: impl Into<String>, values: impl IntoIterator<Item = f64>) -> Self {
        if let Content::Bars { groups, .. } = &mut self.content {
            groups.push((name.into(), values.into_iter().collect()));
        }
        self
    }

    /// Adds a dashed horizontal line with a label.
    pub fn level(mut self, value: f64, label: impl Into<String>) -> Self {
        self.levels.push((value, label.into()));
        self
    }

    /// Adds a dashed vertical line with a label. It is drawn if `x` is in the range of the curves. Ignored by a chart
    /// of bars.
    pub fn mark(mut self, x: f64, label: impl Into<String>) -> Self {
        self.marks.push((x, label.into()));
        self
    }

    pub(super) fn draw(&self, canvas: &mut Canvas, left: f64, top: f64, width: f64, height: f64) {
        let inside = width - LEFT - MARGIN;
        let marks = self.placed_marks(left + LEFT, inside);
        let rows = marks.iter().filter_map(|mark| mark.row).max().map_or(0, |row| row + 1);
        let above = 56.0 + MARK_ROW * rows as f64;
        let frame = Frame {
            left: left + LEFT,
            top: top + above,
            width: inside,
            height: height - above - 54.0 - self.slant(inside),
            y: self.y_axis(),
        };
        canvas.text(left + width / 2.0, top + 20.0, 15.0, Anchor::Middle, &self.title);
        canvas.turned_text((left + 20.0, frame.top + frame.height / 2.0), -90, 13.0, Anchor::Middle, &self.y_label);
        for tick in frame.y.numbers() {
            let Some(y) = frame.y_of(tick.value) else { continue };
            canvas.line((frame.left, y), (frame.left + frame.width, y), GRID, 1.0, false);
            canvas.text(frame.left - 8.0, y + 4.0, 12.0, Anchor::End, &tick.label);
        }
        match &self.content {
            Content::Curves { x_label, times, curves } => {
                let x = x_range(*times, curves);
                draw_x_axis(canvas, &frame, x, x_label, *times);
                draw_curves(canvas, &frame, x, curves);
                draw_marks(canvas, &frame, &marks);
            }
            Content::Bars { categories, groups } => {
                let slanted = self.slant(frame.width) > 0.0;
                draw_bars(canvas, &frame, categories, groups, slanted);
            }
        }
        let (right, bottom) = (frame.left + frame.width, frame.top + frame.height);
        // The end of a history is its most important part, so no label of a level is there.
        let (label_at, anchor) = match self.content {
            Content::Curves { times: true, .. } => (frame.left + 4.0, Anchor::Start),
            _ => (right - 4.0, Anchor::End),
        };
        for (value, label) in &self.levels {
            let Some(y) = frame.y_of(*value) else { continue };
            canvas.line((frame.left, y), (right, y), FRAME, 1.2, true);
            // The label of a line near the top goes below it, as the legend is above the axes.
            let down = if y < frame.top + 16.0 { 14.0 } else { -5.0 };
            canvas.outlined_text(label_at, y + down, 12.0, anchor, label);
        }
        canvas.line((frame.left, frame.top), (frame.left, bottom), FRAME, 1.2, false);
        canvas.line((frame.left, bottom), (right, bottom), FRAME, 1.2, false);
        self.legend(canvas, &frame, top + 34.0);
    }

    /// Extra height for slanted names of groups \[px\]; 0 when the names fit side by side.
    fn slant(&self, width: f64) -> f64 {
        let Content::Bars { groups, .. } = &self.content else { return 0.0 };
        let longest = groups.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0) as f64 * CHARACTER;
        if longest + GAP <= width / groups.len().max(1) as f64 { 0.0 } else { (longest * 0.6 - 20.0).max(0.0) + 1.0 }
    }

    fn y_axis(&self) -> Axis {
        let levels = self.levels.iter().map(|(value, _)| *value);
        match &self.content {
            Content::Curves { curves, .. } => {
                let values = curves.iter().flat_map(|curve| &curve.points).map(|point| point.1);
                let edges = curves.iter().flat_map(Curve::band).flat_map(|(_, low, high)| [low, high]);
                Axis::over(values.chain(edges).chain(levels), false)
            }
            Content::Bars { groups, .. } => {
                let values = groups.iter().flat_map(|(_, values)| values).copied();
                Axis::over(values.chain(levels), true)
            }
        }
    }

    /// The marks in the range of the curves, from left to right. Their labels are in rows, so that they do not overlap.
    fn placed_marks<'a>(&'a self, left: f64, width: f64) -> Vec<PlacedMark<'a>> {
        let Content::Curves { times, curves, .. } = &self.content else { return Vec::new() };
        let x = x_range(*times, curves);
        let place = |(value, label): &'a (f64, String)| Some((x.place(*value)?, label.as_str()));
        let mut shown: Vec<(f64, &str)> = self.marks.iter().filter_map(place).collect();
        // Rounding may move a mark at an end of the axis a little beyond it.
        shown.retain(|(place, _)| (-0.002..=1.002).contains(place));
        shown.sort_by(|one, other| one.0.total_cmp(&other.0));
        let mut ends = [f64::NEG_INFINITY; MARK_ROWS];
        let placed = |(place, label): (f64, &'a str)| {
            let (line, half) = (left + width * place, 0.5 * CHARACTER * label.chars().count() as f64);
            let centre = line.max(left + half - GAP).min(left + width + MARGIN - half);
            let row = ends.iter().position(|end| end + GAP <= centre - half);
            if let Some(row) = row {
                ends[row] = centre + half;
            }
            PlacedMark { line, centre, row, label }
        };
        shown.into_iter().map(placed).collect()
    }

    fn legend(&self, canvas: &mut Canvas, frame: &Frame, top: f64) {
        let names: Vec<&str> = match &self.content {
            Content::Curves { curves, .. } => curves.iter().map(|curve| curve.name.as_str()).collect(),
            Content::Bars { categories, .. } => categories.iter().map(String::as_str).collect(),
        };
        let shown = || names.iter().zip(COLOURS.iter().cycle()).filter(|(name, _)| !name.is_empty());
        let width = |name: &str| 36.0 + CHARACTER * name.chars().count() as f64;
        // A long legend begins left of the axes.
        let end = frame.left + frame.width + MARGIN;
        let mut x = frame.left.min(end - shown().map(|(name, _)| width(name)).sum::<f64>());
        for (name, colour) in shown() {
            canvas.rectangle(x, top, 14.0, 10.0, colour);
            canvas.text(x + 19.0, top + 9.0, 12.0, Anchor::Start, name);
            x += width(name);
        }
    }
}

impl Curve {
    /// The points of the band: x, lower edge, upper edge.
    fn band(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        self.points.iter().zip(&self.reach).map(|((x, y), reach)| (*x, y - reach, y + reach))
    }
}

/// Largest number of rows for the labels of marks. A mark whose label has no space is a line without label.
const MARK_ROWS: usize = 3;
/// Height of such a row \[px\].
const MARK_ROW: f64 = 14.0;

/// A mark with its place in the chart.
struct PlacedMark<'a> {
    /// Horizontal position of the line, and of the centre of the label \[px\].
    line: f64,
    centre: f64,
    /// Row of the label, counted from the frame up; `None` without space for the label.
    row: Option<usize>,
    label: &'a str,
}

fn x_range(times: bool, curves: &[Curve]) -> Axis {
    let values = curves.iter().flat_map(|curve| &curve.points).map(|point| point.0);
    if times { Axis::of_time(&values) } else { Axis::tight(&values) }
}

fn draw_x_axis(canvas: &mut Canvas, frame: &Frame, x: Axis, label: &str, times: bool) {
    let ticks = if times { x.dates(frame.width / CHARACTER) } else { x.numbers() };
    let (right, bottom) = (frame.left + frame.width, frame.top + frame.height);
    for tick in ticks {
        let Some(at) = x.place(tick.value).map(|place| frame.left + frame.width * place) else { continue };
        canvas.line((at, frame.top), (at, bottom), GRID, 1.0, false);
        canvas.text(at, bottom + 18.0, 12.0, Anchor::Middle, &tick.label);
        if let Some(below) = tick.below {
            let half = 0.5 * CHARACTER * below.chars().count() as f64;
            canvas.text(at.min(right + MARGIN - half), bottom + 33.0, 12.0, Anchor::Middle, &below);
        }
    }
    let down = if times { 48.0 } else { 40.0 };
    canvas.text(frame.left + frame.width / 2.0, bottom + down, 13.0, Anchor::Middle, label);
}

/// Draws the bands, then the curves, with the first curve on top.
fn draw_curves(canvas: &mut Canvas, frame: &Frame, x: Axis, curves: &[Curve]) {
    let x_of = |value: f64| x.place(value).map(|place| frame.left + frame.width * place);
    for (curve, colour) in curves.iter().zip(COLOURS.iter().cycle()) {
        let edge = |x: f64, y: f64| x_of(x).zip(frame.y_of(y));
        let (upper, lower): (Vec<_>, Vec<_>) =
            curve.band().filter_map(|(x, low, high)| Some((edge(x, high)?, edge(x, low)?))).unzip();
        if upper.len() > 1 {
            canvas.area(upper.into_iter().chain(lower.into_iter().rev()), colour);
        }
    }
    let coloured: Vec<_> = curves.iter().zip(COLOURS.iter().cycle()).collect();
    for (curve, colour) in coloured.into_iter().rev() {
        let places: Vec<Option<(f64, f64)>> =
            curve.points.iter().map(|point| x_of(point.0).zip(frame.y_of(point.1))).collect();
        for run in places.split(Option::is_none) {
            let run: Vec<(f64, f64)> = run.iter().flatten().copied().collect();
            if run.len() > 1 {
                canvas.polyline(&run, colour);
            }
            // A point without neighbours would be invisible as a line.
            for (x, y) in run.iter().filter(|_| curve.dots || run.len() == 1) {
                canvas.circle(*x, *y, 3.2, colour);
            }
        }
    }
}

fn draw_marks(canvas: &mut Canvas, frame: &Frame, marks: &[PlacedMark<'_>]) {
    let row_at = |row: usize| frame.top - 5.0 - MARK_ROW * row as f64;
    for mark in marks {
        let top = mark.row.map_or(frame.top, row_at);
        canvas.line((mark.line, top), (mark.line, frame.top + frame.height), FRAME, 1.2, true);
    }
    for (mark, row) in marks.iter().filter_map(|mark| Some((mark, mark.row?))) {
        canvas.outlined_text(mark.centre, row_at(row), 12.0, Anchor::Middle, mark.label);
    }
}

fn draw_bars(canvas: &mut Canvas, frame: &Frame, categories: &[String], groups: &[(String, Vec<f64>)], slanted: bool) {
    let pitch = frame.width / groups.len().max(1) as f64;
    let bar = 0.8 * pitch / categories.len().max(1) as f64;
    let bottom = frame.top + frame.height;
    let ground = frame.y_of(0.0).unwrap_or(bottom);
    for (at, (name, values)) in groups.iter().enumerate() {
        let left = frame.left + pitch * (at as f64 + 0.1);
        if slanted {
            canvas.turned_text((left + 0.5 * pitch, bottom + 14.0), -35, 12.0, Anchor::End, name);
        } else {
            canvas.text(left + 0.4 * pitch, bottom + 18.0, 12.0, Anchor::Middle, name);
        }
        for (slot, (value, colour)) in values.iter().zip(COLOURS.iter().cycle()).enumerate() {
            if let Some(y) = frame.y_of(*value) {
                canvas.rectangle(left + bar * slot as f64, y.min(ground), bar * 0.94, (y - ground).abs(), colour);
            }
        }
    }
    canvas.line((frame.left, ground), (frame.left + frame.width, ground), FRAME, 1.0, false);
}
