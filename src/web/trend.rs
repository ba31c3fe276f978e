//! Charts of coefficients and features over time, and of the trace of one throw.

use jiff::Timestamp;

use super::page;
use crate::{
    diagnose::{BaselineRecord, Settings},
    report::{Panel, Sheet},
    throw::{Direction, Trace, rounded},
    wire::Health,
};

/// Largest number of points of a curve: more than a chart resolves.
pub(super) const POINTS: u32 = 250;
/// A long trace is divided into this number of stretches. Only the least and the greatest sample of each are drawn.
const STRETCHES: usize = 300;
/// Longest time without a sample that a curve crosses \[s\]: a toe sensor may be sampled less often than the current.
const GAP_S: f64 = 0.1;
/// Width and height of a chart \[px\].
const SIZE: (f64, f64) = (420.0, 290.0);

/// A chart with its caption.
pub(super) struct Picture {
    pub(super) svg: String,
    /// The chart as JSON, for the script of the page; empty in a file without scripts.
    pub(super) data: String,
    pub(super) caption: String,
}

impl Picture {
    fn new(panel: Panel, caption: String) -> Self {
        let data = page::data(&panel);
        Self { svg: Sheet::new("").panel_size(SIZE.0, SIZE.1).panel(panel).to_svg(), data, caption }
    }
}

/// A vertical line in a chart, with its label.
pub(super) struct Mark {
    pub(super) at: Timestamp,
    pub(super) label: String,
}

/// The throws of each direction, oldest first.
pub(super) type Directions = [(Direction, Vec<Health>); 2];

/// The throws of both directions.
pub(super) fn all(directions: &Directions) -> impl Iterator<Item = &Health> {
    directions.iter().flat_map(|(_, rows)| rows)
}

/// Every n-th row up to the last, at most [`POINTS`].
pub(super) fn thinned(rows: Vec<Health>) -> Vec<Health> {
    let step = rows.len().div_ceil(POINTS as usize).max(1);
    let first = rows.len().saturating_sub(1) % step;
    rows.into_iter().skip(first).step_by(step).collect()
}

/// The newest baseline of a direction, from `baselines` of one machine, the newest first.
pub(super) fn newest(baselines: &[BaselineRecord], direction: Direction) -> Option<&BaselineRecord> {
    baselines.iter().find(|baseline| baseline.direction == direction)
}

/// Scatter of b0, a1 and a0 from throw to throw: two standard deviations \[%\] in the newest baseline of a direction.
/// It is much larger than the error from sensor noise.
pub(super) fn scatter_pct(baselines: &[BaselineRecord], direction: Direction) -> Option<[f64; 3]> {
    let covariance = newest(baselines, direction)?.log_covariance;
    Some([0, 1, 2].map(|at| 200.0 * covariance[at][at].max(0.0).sqrt()))
}

/// Charts of the changes of b0, a1, a0 and inertia, with limits, marks and the scatter of the machine. Empty without a
/// baseline.
pub(super) fn coefficients(
    directions: &Directions,
    marks: &[Mark],
    baselines: &[BaselineRecord],
    settings: &Settings,
) -> Vec<Picture> {
    if !all(directions).any(|row| row.change_pct.is_some()) {
        return Vec::new();
    }
    // The larger scatter of both directions.
    let scatter = directions.iter().filter_map(|(direction, _)| scatter_pct(baselines, *direction));
    let scatter = scatter.reduce(|one, other| [0, 1, 2].map(|at| one[at].max(other[at])));
    let picture = |title: &str, about: &str, limit: f64, at: Option<usize>| {
        let limits = (limit, limit * settings.critical_factor);
        let band = scatter.zip(at).map(|(scatter, at)| scatter[at]);
        let scatter = band.map(|band| format!("The band of ± {band:.1} % is the scatter of this machine. "));
        let scatter = scatter.unwrap_or_default();
        let caption = format!("{about}. {scatter}Warning at {limit} %, critical at {} %.", rounded(limits.1));
        let of_row = |row: &Health| row.change_pct.map(|pct| at.map_or_else(|| inertia_pct(pct), |at| pct[at]));
        Picture::new(change(title, limits, band, directions, marks, of_row), caption)
    };
    let inertia = "The change of inertia, which changes b0, a1 and a0 alike: from the middle one of the three, as a fault of \
                   another part changes one of them";
    vec![
        picture("motor (b0)", "Change of b0 from the baseline", settings.kt_limit_pct, Some(0)),
        picture("friction (a1)", "Change of a1 from the baseline", settings.friction_limit_pct, Some(1)),
        picture("stiffness (a0)", "Change of a0 from the baseline", settings.stiffness_limit_pct, Some(2)),
        picture("inertia", inertia, settings.inertia_limit_pct, None),
    ]
}

/// The change of inertia J \[%\], from the median of the changes of the three coefficients: all three are proportional
/// to 1 / J. A fault of another part changes one coefficient, which leaves the median near 0.
fn inertia_pct(mut change_pct: [f64; 3]) -> f64 {
    change_pct.sort_unstable_by(f64::total_cmp);
    100.0 * ((1.0 + change_pct[1] / 100.0).max(0.01).recip() - 1.0)
}

/// A chart of changes from the baseline \[%\]. `band` is the half width of the band of scatter \[%\].
fn change(
    title: &str,
    (warning, critical): (f64, f64),
    band: Option<f64>,
    directions: &Directions,
    marks: &[Mark],
    value: impl Fn(&Health) -> Option<f64>,
) -> Panel {
    let mut panel = Panel::history(title, "% from the baseline");
    let mut furthest = (0.0_f64, 0.0_f64);
    for (direction, rows) in directions {
        let points = since_baseline(rows, &value);
        furthest = points.iter().fold(furthest, |(low, high), (_, change)| (low.min(*change), high.max(*change)));
        panel = panel.line(direction.to_string(), points);
    }
    if let Some((first, last)) = ends(directions) {
        // Without a band, the line at 0 gives the chart the same range of time as the others.
        let band = band.unwrap_or(0.0);
        panel = panel.banded_line("", [(first, 0.0, band), (last, 0.0, band)]);
    }
    panel = panel.level(warning, "warning").level(-warning, "warning");
    // The critical limit is drawn only if a change is above the warning limit, as it would compress the chart.
    if furthest.1 > warning {
        panel = panel.level(critical, "critical");
    }
    if furthest.0 < -warning {
        panel = panel.level(-critical, "critical");
    }
    let rejected = rejected_at(directions, furthest.0.min(-warning));
    marked(panel, rejected, marks)
}

/// Time and value of each throw. A NaN interrupts the curve at a throw without the value. It also interrupts the curve
/// before the first throw with a new baseline, as a line between changes from two baselines is no trend.
fn since_baseline(rows: &[Health], value: impl Fn(&Health) -> Option<f64>) -> Vec<(f64, f64)> {
    let mut points = Vec::with_capacity(rows.len());
    let mut before = None;
    for row in rows {
        let (at, value) = (x(row.started_at), value(row));
        if value.is_some() {
            // The last throw before a new baseline has both counts at 0.
            let is_last = row.baseline.is_some_and(|baseline| !baseline.has_begun());
            let throws = if is_last { u64::MAX } else { row.throws_since_baseline };
            if before.replace(throws).is_some_and(|before| throws < before) {
                // Between the throws: a script that joins the curves has one value at each time.
                let last: f64 = points.last().map_or(at, |(last, _)| *last);
                points.push((f64::midpoint(last, at), f64::NAN));
            }
        }
        points.push((at, value.unwrap_or(f64::NAN)));
    }
    points
}

/// Gets a feature of a throw, which it can have without an estimate.
type Feature = fn(&Health) -> Option<f64>;

const ALL_THROWS: &str = "of each throw, also of rejected ones";
const ROUGH_THROWS: &str = "of each throw, also of rough ones, which have only the ratios of the coefficients";

/// Charts of the features of every throw, also of rejected ones: duration and currents, and the ratios of the
/// coefficients if some throws have only these. `of_baseline` has the throws of the baseline of each direction, or
/// none.
pub(super) fn features(directions: &Directions, of_baseline: &[Vec<Health>; 2], marks: &[Mark]) -> Vec<Picture> {
    let ratios: [(&str, &str, &str, Feature); 2] = [
        ("Friction per motor (a1 / b0)", "mA s/rad", ROUGH_THROWS, |row| ratio(row, row.a1_per_b0, 1)),
        ("Stiffness per motor (a0 / b0)", "mA/rad", ROUGH_THROWS, |row| ratio(row, row.a0_per_b0, 2)),
    ];
    let shown: [(&str, &str, &str, Feature); 3] = [
        ("Duration", "s", ALL_THROWS, |row| row.duration_s),
        ("Mean current", "A", ALL_THROWS, |row| row.mean_current_a),
        ("Peak current", "A", ALL_THROWS, |row| row.peak_current_a),
    ];
    let is_rough = |row: &Health| row.coefficients.is_none() && row.a1_per_b0.is_some();
    let ratios = if all(directions).any(is_rough) { &ratios[..] } else { &[] };
    let picture = |(title, unit, of, value): (&str, &str, &str, Feature)| {
        let mut panel = Panel::history(title, unit);
        let mut least = f64::INFINITY;
        for (direction, rows) in directions {
            let points: Vec<_> = rows.iter().filter_map(|row| Some((x(row.started_at), value(row)?))).collect();
            least = points.iter().fold(least, |least, (_, value)| least.min(*value));
            panel = panel.line(direction.to_string(), points);
        }
        // An empty line, which takes the colour that the band has in the other charts.
        panel = panel.line("", []);
        let levels: Vec<f64> = of_baseline.iter().filter_map(|rows| median(rows, value)).collect();
        for level in &levels {
            panel = panel.level(*level, "");
        }
        if !least.is_finite() {
            return None;
        }
        let lines =
            if levels.is_empty() { "" } else { " The dashed lines are the medians of the baseline in each direction." };
        let caption = format!("{title} {of}.{lines}");
        Some(Picture::new(marked(panel, rejected_at(directions, least), marks), caption))
    };
    ratios.iter().copied().chain(shown).filter_map(picture).collect()
}

/// A ratio to b0, times 1000: `known` from the estimate, or else computed from the coefficient at index `at`.
fn ratio(row: &Health, known: Option<f64>, at: usize) -> Option<f64> {
    let ratio = known.or_else(|| row.coefficients.map(|coefficients| coefficients[at] / coefficients[0]));
    ratio.map(|ratio| 1e3 * ratio)
}

/// Median of a feature over the evaluated throws; `None` without any.
fn median(rows: &[Health], value: Feature) -> Option<f64> {
    let mut values: Vec<f64> = rows.iter().filter(|row| row.is_evaluated()).filter_map(value).collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Time on the axis \[s since 1970\]. It is computed from whole microseconds, so that its text has at most six
/// decimals.
pub(super) fn x(at: Timestamp) -> f64 {
    at.as_microsecond() as f64 / 1e6
}

/// Times of the first and the last throw in the chart.
fn ends(directions: &Directions) -> Option<(f64, f64)> {
    let times = || all(directions).map(|row| row.started_at);
    Some((x(times().min()?), x(times().max()?)))
}

/// Points of the dots for rejected throws, at `height`.
fn rejected_at(directions: &Directions, height: f64) -> Vec<(f64, f64)> {
    let rows = all(directions).filter(|row| row.is_rejected());
    let mut dots: Vec<f64> = rows.map(|row| x(row.started_at)).collect();
    dots.sort_by(f64::total_cmp);
    // A NaN after each dot interrupts the line.
    dots.into_iter().flat_map(|at| [(at, height), (at, f64::NAN)]).collect()
}

/// The chart with the dots of rejected throws and the marks.
fn marked(panel: Panel, rejected: Vec<(f64, f64)>, marks: &[Mark]) -> Panel {
    let panel = if rejected.is_empty() { panel } else { panel.dotted_line("rejected", rejected) };
    marks.iter().fold(panel, |panel, mark| panel.mark(x(mark.at), mark.label.clone()))
}

/// A curve over the time of a throw.
pub(super) struct Curve {
    pub(super) name: &'static str,
    pub(super) rate_hz: f64,
    pub(super) values: Vec<f64>,
}

/// A chart of curves over the time of a throw.
pub(super) fn over_time(title: &str, unit: &str, curves: impl IntoIterator<Item = Curve>, caption: String) -> Picture {
    let panel = curves.into_iter().fold(Panel::curves(title, "s", unit), |panel, curve| {
        panel.line(curve.name, drawn(curve.rate_hz, &curve.values))
    });
    Picture::new(panel, caption)
}

/// A caption, as "Motor current over the time of the throw, 6,000 samples at 1000 Hz."
pub(super) fn caption(title: &str, trace: &Trace) -> String {
    let samples = page::count(trace.current_a().len() as u64);
    format!("{title} over the time of the throw, {samples} samples at {} Hz.", trace.sample_rate_hz())
}

/// The points of a curve. Of a long trace only the first and the last sample, and the extremes of each stretch. A NaN
/// interrupts the curve where no sample is known for longer than [`GAP_S`].
fn drawn(sample_rate_hz: f64, values: &[f64]) -> Vec<(f64, f64)> {
    let known: Vec<usize> = (0..values.len()).filter(|at| values[*at].is_finite()).collect();
    let stretch = known.len().div_ceil(STRETCHES).max(2);
    let mut points: Vec<(f64, f64)> = Vec::new();
    for run in known.chunk_by(|one, next| (next - one) as f64 <= (GAP_S * sample_rate_hz).max(1.0)) {
        let mut kept = vec![run[0]];
        for chunk in run.chunks(stretch) {
            let (low, high) = chunk.iter().fold((chunk[0], chunk[0]), |(low, high), at| {
                (if values[*at] < values[low] { *at } else { low }, if values[*at] > values[high] { *at } else { high })
            });
            kept.extend([low.min(high), low.max(high)]);
        }
        kept.extend(run.last());
        kept.dedup();
        let first = kept[0] as f64 / sample_rate_hz;
        points.extend(points.last().map(|(last, _)| (f64::midpoint(*last, first), f64::NAN)));
        points.extend(kept.into_iter().map(|at| (at as f64 / sample_rate_hz, values[at])));
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        throw::{MachineId, ThrowRef},
        wire::BaselineProgress,
    };

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
        assert_eq!(drawn(1.0, &[1.0, 2.0]), [(0.0, 1.0), (1.0, 2.0)]);
    }

    /// As of a toe sensor that is sampled ten times less often than the current, and is silent for a while.
    #[test]
    fn a_curve_with_missing_samples_keeps_the_others() {
        let is_missing = |at: usize| !at.is_multiple_of(10) || (2_000..2_200).contains(&at);
        let mut values: Vec<f64> = (0..6_000).map(|at| if is_missing(at) { f64::NAN } else { at as f64 }).collect();
        let points = drawn(1_000.0, &values);
        let (known, gaps): (Vec<_>, Vec<_>) = points.iter().partition(|(_, value)| value.is_finite());
        assert!(known.len() >= STRETCHES, "{} points", known.len());
        assert!(matches!(gaps[..], [(at, _)] if (1.99..2.2).contains(&at)), "{gaps:?}");
        assert!(points.is_sorted_by(|one, next| one.0 < next.0));
        values[..3_000].fill(f64::NAN);
        assert_eq!(drawn(1_000.0, &values)[0], (3.0, 3_000.0));
    }

    fn row(at: i64, throws_since_baseline: u64, so_far: u64) -> Health {
        Health {
            baseline: Some(BaselineProgress { so_far, needed: 50 }),
            throws_since_baseline,
            change_pct: Some([1.0; 3]),
            ..Health::rejected(
                MachineId::new("north", "21B").unwrap(),
                ThrowRef { boot_id: "b".to_owned(), throw_no: at.unsigned_abs() },
                Timestamp::from_second(at).unwrap(),
                "good",
                None,
            )
        }
    }

    #[test]
    fn the_limits_in_a_caption_are_short() {
        let both = [(Direction::NormalToReverse, vec![row(1, 8, 50)]), (Direction::ReverseToNormal, Vec::new())];
        let settings = Settings { kt_limit_pct: 5.1, ..Settings::default() };
        let caption = &coefficients(&both, &[], &[], &settings)[0].caption;
        assert!(caption.ends_with("Warning at 5.1 %, critical at 15.3 %."), "{caption}");
    }

    /// The throws since the baseline of each throw, and whether the last one before a new baseline is among them.
    #[test]
    fn a_new_baseline_interrupts_the_curve() {
        let times = |rows: &[Health]| {
            let points = since_baseline(rows, |row| Some(row.change_pct?[0]));
            points.iter().map(|(at, value)| if value.is_nan() { f64::NAN } else { *at }).collect::<Vec<_>>()
        };
        let is = |found: Vec<f64>, expected: &[f64]| assert_eq!(format!("{found:?}"), format!("{expected:?}"));
        is(times(&[row(1, 8, 50), row(2, 9, 50), row(3, 3, 50)]), &[1.0, 2.0, f64::NAN, 3.0]);
        let points = since_baseline(&[row(1, 8, 50), row(3, 3, 50)], |_| Some(0.0));
        assert!((points[1].0 - 2.0).abs() < 1e-9, "at the time of a throw: {points:?}");
        is(times(&[row(1, 8, 50), row(2, 0, 0), row(3, 3, 50), row(4, 4, 50)]), &[1.0, 2.0, f64::NAN, 3.0, 4.0]);
    }

    #[test]
    fn inertia_moves_all_three_coefficients_alike() {
        let more = 100.0 * (1.0 / 1.2 - 1.0);
        assert!((inertia_pct([more; 3]) - 20.0).abs() < 1e-9);
        for one in [[-20.0, 0.0, 0.0], [0.0, 30.0, 0.0], [0.0, 0.0, 15.0]] {
            assert!(inertia_pct(one).abs() < 1e-9, "{one:?} is the fault of another part");
        }
    }
}
