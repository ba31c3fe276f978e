//! Pictures for reports: curves and grouped bars as SVG text, several panels to a sheet.
//!
//! ```
//! use pointsd::report::{Panel, Sheet};
//! let delay = Panel::curves("Delay", "size [%]", "throws").line("kt", [(5.0, 12.0), (10.0, 3.0)]).log_y();
//! let bars = Panel::bars("Change", "% of nominal", ["b0", "a1"]).group("test 1", [100.0, 99.0]);
//! let svg = Sheet::new("Both").panel(delay).panel(bars).to_svg();
//! assert!(svg.starts_with("<svg"));
//! ```

mod axis;
mod panel;
mod svg;

pub use panel::Panel;

use svg::Canvas;

/// Width of one panel \[px\].
const PANEL_WIDTH: f64 = 640.0;
/// Height of one panel \[px\].
const PANEL_HEIGHT: f64 = 380.0;
/// Height of the sheet's title \[px\].
const TITLE_HEIGHT: f64 = 44.0;

/// Panels under one title, filled row by row.
#[derive(Debug, Clone)]
pub struct Sheet {
    title: String,
    columns: usize,
    panels: Vec<Panel>,
}

impl Sheet {
    /// An empty sheet, one column wide.
    #[must_use]
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), columns: 1, panels: Vec::new() }
    }

    /// Puts this many panels beside each other, at least one.
    #[must_use]
    pub fn columns(mut self, columns: usize) -> Self {
        self.columns = columns.max(1);
        self
    }

    /// Adds a panel.
    #[must_use]
    pub fn panel(mut self, panel: Panel) -> Self {
        self.panels.push(panel);
        self
    }

    /// The sheet as a stand-alone SVG document.
    #[must_use]
    pub fn to_svg(&self) -> String {
        let columns = self.columns.min(self.panels.len().max(1));
        let rows = self.panels.len().div_ceil(columns);
        let width = PANEL_WIDTH * columns as f64;
        let mut canvas = Canvas::new(width, TITLE_HEIGHT + PANEL_HEIGHT * rows as f64);
        canvas.text(width / 2.0, 30.0, 20.0, svg::Anchor::Middle, &self.title);
        for (at, panel) in self.panels.iter().enumerate() {
            let left = PANEL_WIDTH * (at % columns) as f64;
            let top = TITLE_HEIGHT + PANEL_HEIGHT * (at / columns) as f64;
            panel.draw(&mut canvas, left, top, PANEL_WIDTH, PANEL_HEIGHT);
        }
        canvas.finish()
    }
}
