//! A sheet: several panels under one title, as one SVG document.

use super::{
    panel::Panel,
    svg::{Anchor, Canvas},
};

/// Size of a panel if no other is set \[px\].
const PANEL_WIDTH: f64 = 640.0;
const PANEL_HEIGHT: f64 = 380.0;
/// Height of the sheet's title \[px\].
const TITLE_HEIGHT: f64 = 44.0;

/// Panels under one title, filled row by row.
#[derive(Debug, Clone)]
#[must_use]
pub struct Sheet {
    title: String,
    columns: usize,
    panel_size: (f64, f64),
    panels: Vec<Panel>,
}

impl Sheet {
    /// An empty sheet of one column. An empty title takes no space.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), columns: 1, panel_size: (PANEL_WIDTH, PANEL_HEIGHT), panels: Vec::new() }
    }

    /// Sets the width and height of every panel \[px\].
    pub fn panel_size(mut self, width: f64, height: f64) -> Self {
        self.panel_size = (width, height);
        self
    }

    /// Sets the number of panels in a row, at least one.
    pub fn columns(mut self, columns: usize) -> Self {
        self.columns = columns.max(1);
        self
    }

    /// Adds a panel.
    pub fn panel(mut self, panel: Panel) -> Self {
        self.panels.push(panel);
        self
    }

    /// The sheet as a stand-alone SVG document.
    pub fn to_svg(&self) -> String {
        let columns = self.columns.min(self.panels.len().max(1));
        let rows = self.panels.len().div_ceil(columns);
        let (panel_width, panel_height) = self.panel_size;
        let title_height = if self.title.is_empty() { 0.0 } else { TITLE_HEIGHT };
        let width = panel_width * columns as f64;
        let mut canvas = Canvas::new(width, title_height + panel_height * rows as f64);
        if !self.title.is_empty() {
            canvas.text(width / 2.0, 30.0, 20.0, Anchor::Middle, &self.title);
        }
        for (at, panel) in self.panels.iter().enumerate() {
            let left = panel_width * (at % columns) as f64;
            let top = title_height + panel_height * (at / columns) as f64;
            panel.draw(&mut canvas, left, top, panel_width, panel_height);
        }
        canvas.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_curve_and_bar_is_drawn_and_text_is_escaped() {
        let curves = Panel::curves("a < b & c", "x", "y")
            .line("one", [(0.0, 1.0), (1.0, f64::NAN), (2.0, 3.0), (3.0, 4.0)])
            .dotted_line("two", [(0.0, 2.0), (3.0, 2.5)]);
        let bars = Panel::bars("bars", "y", ["p", "q"]).group("g", [1.0, -2.0]).level(0.8, "limit");
        let svg = Sheet::new("sheet").columns(2).panel(curves).panel(bars).to_svg();
        // The NaN leaves a single point before it, which is a dot, and a line after it.
        assert_eq!(svg.matches("<polyline").count(), 2);
        assert_eq!(svg.matches("<circle").count(), 1 + 2);
        assert!(svg.contains("a &lt; b &amp; c"));
        assert!(svg.contains("limit"));
        assert!(!svg.contains("NaN"));
        assert_eq!(svg.matches('<').count(), svg.matches('>').count());
    }

    #[test]
    fn a_band_widens_the_axis_and_a_mark_stands_only_where_the_axis_is() {
        let chart = |panel: Panel| Sheet::new("").panel(panel).to_svg();
        let plain = Panel::curves("", "x", "y").line("one", [(0.0, 1.0), (1.0, 2.0)]);
        let banded =
            Panel::curves("", "x", "y").banded_line("one", [(0.0, 1.0, 50.0), (1.0, 2.0, f64::NAN), (2.0, 3.0, 9.0)]);
        assert!(!chart(plain.clone()).contains("<polygon") && !chart(plain.clone()).contains(">40<"));
        let svg = chart(banded.mark(1.0, "raised").mark(9.0, "beyond"));
        assert_eq!(svg.matches("<polygon").count(), 1);
        assert!(svg.contains(">40<") && svg.contains("raised") && !svg.contains("beyond") && !svg.contains("NaN"));
    }

    #[test]
    fn labels_of_near_marks_have_rows_above_the_curves_and_the_fourth_has_none() {
        let chart = |count: u8| {
            let panel = Panel::curves("", "x", "y").line("one", [(0.0, 0.0), (100.0, 1.0)]);
            let panel = (0..count).fold(panel, |panel, at| panel.mark(50.0 + f64::from(at), format!("raised {at}")));
            Sheet::new("").panel(panel.mark(10.0, "far")).to_svg()
        };
        let height_of = |svg: &str, label: &str| -> f64 {
            let text = svg.lines().find(|line| line.contains(&format!(">{label}<"))).unwrap();
            text.split("y=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
        };
        let svg = chart(4);
        let rows = ["raised 0", "raised 1", "raised 2"].map(|label| height_of(&svg, label));
        assert!(rows[0] - rows[1] >= 12.0 && rows[1] - rows[2] >= 12.0, "{rows:?}");
        assert_eq!(height_of(&svg, "far").to_bits(), rows[0].to_bits(), "a label with space is next to the curves");
        assert!(!svg.contains("raised 3"));
        assert_eq!(svg.matches("stroke-dasharray").count(), 5, "every mark has its line");
        let highest = |svg: &str| {
            let line = svg.lines().find(|line| line.starts_with("<polyline")).unwrap();
            line.split([' ', '"', ',']).filter_map(|word| word.parse::<f64>().ok()).nth(3).unwrap()
        };
        assert!(rows[0] < highest(&svg) && highest(&svg) > highest(&chart(0)), "no label lies over the curves");
    }

    #[test]
    fn a_history_shows_the_date_of_even_one_point() {
        let chart = |points: &[(f64, f64)]| {
            Sheet::new("").panel(Panel::history("", "y").line("one", points.iter().copied())).to_svg()
        };
        let noon = 1_795_262_400.0;
        assert!(chart(&[(noon, 1.0)]).contains(">21 Nov 2026<"));
        assert!(chart(&[(noon, 1.0), (noon + 40.0 * 86_400.0, 2.0)]).contains(">23 Nov<"));
        assert!(!chart(&[]).contains("NaN"));
    }

    #[test]
    fn names_that_do_not_fit_are_slanted() {
        let bars = |name: &str| {
            let panel = (0..12).fold(Panel::bars("bars", "y", ["p"]), |panel, _| panel.group(name, [1.0]));
            Sheet::new("sheet").panel(panel).to_svg()
        };
        assert!(!bars("g").contains("rotate(-35)"));
        assert_eq!(bars("a long name").matches("rotate(-35)").count(), 12);
    }
}
