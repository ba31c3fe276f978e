//! Pictures: how the coefficients of a machine change, and the trace of one throw.

use jiff::Timestamp;

use super::{page, standing};
use crate::{
    diagnose::Settings,
    report::{Panel, Sheet},
    store::HealthRow,
    throw::{Direction, Trace},
};

/// Most points of a curve: more than a picture has room for.
pub(super) const POINTS: usize = 250;
/// Samples of a trace are drawn as the least and the greatest of so many stretches.
const STRETCHES: usize = 300;
/// Size of a picture \[px\].
const SIZE: (f64, f64) = (380.0, 290.0);

/// A picture with what it shows in words.
pub(super) struct Picture {
    pub(super) svg: String,
    pub(super) says: String,
}

/// A moment that gets a mark.
pub(super) struct Mark {
    pub(super) at: Timestamp,
    pub(super) label: String,
}

/// The throws of each direction, oldest first.
pub(super) type Ways = [(Direction, Vec<HealthRow>); 2];

/// Every n-th row, the last one included, so that at most [`POINTS`] are left.
pub(super) fn thinned(rows: Vec<HealthRow>) -> Vec<HealthRow> {
    let step = rows.len().div_ceil(POINTS).max(1);
    let first = rows.len().saturating_sub(1) % step;
    rows.into_iter().skip(first).step_by(step).collect()
}

/// Pictures of b0, a1 and a0 in % from the baseline with two standard deviations, limits and marks. None while there is
/// no baseline.
pub(super) fn trends(ways: &Ways, marks: &[Mark], settings: &Settings) -> Vec<Picture> {
    let shown = |rows: &[HealthRow]| rows.iter().any(|row| row.change_pct.is_some());
    if !ways.iter().any(|(_, rows)| shown(rows)) {
        return Vec::new();
    }
    let coefficients = [
        ("b0", "motor", settings.kt_limit_pct),
        ("a1", "friction", settings.friction_limit_pct),
        ("a0", "stiffness", settings.stiffness_limit_pct),
    ];
    let picture = |(at, (name, part, limit)): (usize, (&str, &str, f64))| {
        let critical = limit * settings.critical_factor;
        Picture {
            svg: trend(at, &format!("{part} ({name})"), (limit, critical), ways, marks),
            says: format!(
                "Change of {name} from its baseline; limits of {part}: warning at {limit} %, critical at {critical} %."
            ),
        }
    };
    coefficients.into_iter().enumerate().map(picture).collect()
}

fn trend(coefficient: usize, title: &str, (warning, critical): (f64, f64), ways: &Ways, marks: &[Mark]) -> String {
    let x = |at: Timestamp| at.as_duration().as_secs_f64();

    let mut panel = Panel::history(title, "% from the baseline");
    let mut furthest = (0.0_f64, 0.0_f64);
    for (direction, rows) in ways {
        let point = |row: &HealthRow| {
            let (change, reach) = (row.change_pct?[coefficient], standing::reach_pct(row)?[coefficient]);
            Some((x(row.started_at), change, reach))
        };
        let points: Vec<_> = rows.iter().filter_map(point).collect();
        furthest = points.iter().fold(furthest, |(low, high), (_, change, _)| (low.min(*change), high.max(*change)));
        panel = panel.banded_line(direction.to_string(), points);
    }
    panel = panel.level(warning, "warning").level(-warning, "warning");
    // Far from it, the critical limit would only make everything small.
    if furthest.1 > warning {
        panel = panel.level(critical, "critical");
    }
    if furthest.0 < -warning {
        panel = panel.level(-critical, "critical");
    }
    let panel = marks.iter().fold(panel, |panel, mark| panel.mark(x(mark.at), mark.label.clone()));
    Sheet::new("").panel_size(SIZE.0, SIZE.1).panel(panel).to_svg()
}

/// The current and the position of a throw.
pub(super) fn trace(trace: &Trace) -> [Picture; 2] {
    let picture = |title: &str, unit: &str, values: &[f64]| {
        let panel = Panel::curves(title, "s", unit).line("", drawn(trace.sample_rate_hz(), values));
        Picture {
            svg: Sheet::new("").panel_size(SIZE.0, SIZE.1).panel(panel).to_svg(),
            says: format!(
                "{title} over the time of the throw, {} samples at {} Hz.",
                page::count(values.len() as u64),
                trace.sample_rate_hz()
            ),
        }
    };
    [picture("Motor current", "A", trace.current_a()), picture("Toe position from normal", "mm", trace.position_mm())]
}

/// The samples, or of many the first, the last, and the least and the greatest of each stretch.
fn drawn(sample_rate_hz: f64, values: &[f64]) -> Vec<(f64, f64)> {
    let stretch = values.len().div_ceil(STRETCHES).max(2);
    let mut kept = vec![0];
    for (number, chunk) in values.chunks(stretch).enumerate() {
        let (low, high) = (0..chunk.len()).fold((0, 0), |(low, high), at| {
            (if chunk[at] < chunk[low] { at } else { low }, if chunk[at] > chunk[high] { at } else { high })
        });
        kept.extend([low.min(high), low.max(high)].map(|at| number * stretch + at));
    }
    kept.push(values.len().saturating_sub(1));
    kept.dedup();
    kept.into_iter().filter_map(|at| Some((at as f64 / sample_rate_hz, *values.get(at)?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_trace_keeps_its_extremes_in_order() {
        let mut values: Vec<f64> = (0..100_000).map(|at| f64::from(at % 1_000)).collect();
        values[54_321] = 1e6;
        let points = drawn(1_000.0, &values);
        assert!(points.len() <= 2 * STRETCHES + 2);
        assert!(points.contains(&(54.321, 1e6)));
        assert!(points.is_sorted_by(|one, next| one.0 < next.0));
        values[0] = 500.5;
        assert_eq!(drawn(1_000.0, &values)[0], (0.0, 500.5), "the axis begins with the first sample");
        assert_eq!(drawn(10.0, &[]), []);
        assert_eq!(drawn(10.0, &[1.0, 2.0, 3.0]), [(0.0, 1.0), (0.1, 2.0), (0.2, 3.0)]);
    }
}
