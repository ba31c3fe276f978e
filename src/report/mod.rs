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
mod calendar;
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
    panel_size: (f64, f64),
    panels: Vec<Panel>,
}

impl Sheet {
    /// An empty sheet, one column wide. Without a title there is no room for one.
    #[must_use]
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), columns: 1, panel_size: (PANEL_WIDTH, PANEL_HEIGHT), panels: Vec::new() }
    }

    /// Gives every panel this width and height \[px\].
    #[must_use]
    pub fn panel_size(mut self, width: f64, height: f64) -> Self {
        self.panel_size = (width, height);
        self
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
        let (panel_width, panel_height) = self.panel_size;
        let title_height = if self.title.is_empty() { 0.0 } else { TITLE_HEIGHT };
        let width = panel_width * columns as f64;
        let mut canvas = Canvas::new(width, title_height + panel_height * rows as f64);
        if !self.title.is_empty() {
            canvas.text(width / 2.0, 30.0, 20.0, svg::Anchor::Middle, &self.title);
        }
        for (at, panel) in self.panels.iter().enumerate() {
            let left = panel_width * (at % columns) as f64;
            let top = title_height + panel_height * (at / columns) as f64;
            panel.draw(&mut canvas, left, top, panel_width, panel_height);
        }
        canvas.finish()
    }
}
