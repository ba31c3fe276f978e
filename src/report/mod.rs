//! Charts as SVG text: curves and grouped bars, several panels on a sheet.
//!
//! ```
//! use pointsd::report::{Panel, Sheet};
//! let delay = Panel::curves("Delay", "size [%]", "throws").line("kt", [(5.0, 12.0), (10.0, 3.0)]);
//! let bars = Panel::bars("Change", "% of nominal", ["b0", "a1"]).group("test 1", [100.0, 99.0]);
//! let svg = Sheet::new("Both").panel(delay).panel(bars).to_svg();
//! assert!(svg.starts_with("<svg"));
//! ```

mod axis;
mod calendar;
mod panel;
mod sheet;
mod svg;

pub use panel::Panel;
pub use sheet::Sheet;
