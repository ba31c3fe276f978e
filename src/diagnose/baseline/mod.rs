//! The baseline of a machine and direction.

mod neutral;
mod temperature;
mod trend;
mod wet;

use jiff::Timestamp;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

pub(super) use neutral::Neutral;
pub use temperature::TemperatureSource;
pub(super) use temperature::{Suspicion, covariance_of_effect};
pub(super) use trend::Filling;
pub(super) use wet::{LONGEST_SPELL, WetSpell, wet_spells};

use self::{temperature::Temperature, trend::TrendThrow};
use super::{
    Cause, Settings,
    observation::{Evaluated, SCALE_VARIANCE},
    statistics::{Scatter, Sym3, centre_and_sd, median, to_f32},
};
use crate::throw::Direction;

/// A baseline as stored in the history.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BaselineRecord {
    /// The direction.
    pub direction: Direction,
    /// Start of the last throw of the baseline.
    pub taken_at: Timestamp,
    /// Number of throws of the baseline.
    pub throws: usize,
    /// Whether the baseline has all its throws, and these have no trend. An incomplete baseline has wider limits; it is
    /// replaced when it has more throws, unless they have a trend.
    pub complete: bool,
    /// Centre of b0 \[rad s⁻² A⁻¹\], a1 \[s⁻¹\] and a0 \[s⁻²\]. For a baseline of ratios it is (1, a1/b0, a0/b0).
    pub center: [f64; 3],
    /// Whether the baseline has the ratios of the coefficients only.
    #[serde(default)]
    pub ratios_only: bool,
    /// Throw-to-throw covariance of (ln b0, ln a1, ln a0).
    pub log_covariance: [[f64; 3]; 3],
    /// Lag-1 correlation of the scatter of each coefficient from throw to throw, without the errors of the estimates.
    pub lag1: [f64; 3],
    /// Source of the temperature coefficients.
    pub temperature_source: TemperatureSource,
    /// Change of the coefficients with temperature \[% per K\]; zero without compensation.
    pub temperature_pct_per_k: [f64; 3],
    /// Temperature of the centre \[°C\]; `None` without measurements.
    pub reference_c: Option<f64>,
    /// Centre of the duration \[s\]; `None` without measurements.
    pub duration_s: Option<f64>,
}

impl BaselineRecord {
    /// Changes of the ratios a1/b0 and a0/b0 from the centre \[%\], without temperature compensation.
    pub fn ratio_changes_pct(&self, ratios: [f64; 2]) -> [f64; 2] {
        let [b0, a1, a0] = self.center;
        [100.0 * (ratios[0] * b0 / a1 - 1.0), 100.0 * (ratios[1] * b0 / a0 - 1.0)]
    }
}

/// A throw of a baseline. Short names keep the snapshot small; single precision keeps the memory of a fleet small while
/// it learns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct BaselineThrow {
    /// Number of the throw among those of the machine.
    #[serde(rename = "n")]
    order: u32,
    #[serde(rename = "x")]
    log: [f32; 3],
    #[serde(rename = "t", default, skip_serializing_if = "Option::is_none")]
    temperature_c: Option<f32>,
    #[serde(rename = "d", default, skip_serializing_if = "Option::is_none")]
    duration_s: Option<f32>,
}

/// The baseline of one direction, in logarithms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Baseline {
    pub(super) centre: [f64; 3],
    pub(super) throws: usize,
    pub(super) complete: bool,
    /// Start of its last throw.
    pub(super) taken_at: Timestamp,
    /// The temperature compensation.
    pub(super) temperature: Temperature,
    pub(super) duration_s: Option<f64>,
    pub(super) scatter: Scatter,
    /// Slopes of the logarithms per throw of the machine; `None` without a trend.
    slopes: Option<[f64; 3]>,
    /// For a baseline of ratios: the matrix, by columns, that maps an error of ratios to the part of it that differs
    /// from throw to throw. `None` if the whole error differs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    differing: Option<Box<[[f64; 3]; 3]>>,
}

/// Known changes over the throws of a baseline, which are no part of its scatter.
#[derive(Debug, Clone, Copy)]
pub(super) struct Changes<'a> {
    /// Slopes of a trend, per throw of the machine.
    pub(super) slopes: Option<[f64; 3]>,
    pub(super) wet: &'a [WetSpell],
}

impl BaselineThrow {
    pub(super) fn new(order: u64, throw: &Evaluated) -> Self {
        Self {
            order: u32::try_from(order).unwrap_or(u32::MAX),
            log: throw.log.map(to_f32),
            temperature_c: throw.temperature_c.map(to_f32),
            duration_s: throw.duration_s.map(to_f32),
        }
    }

    /// The logarithms without the friction that rain took away.
    fn dry(&self, wet: &[WetSpell]) -> Vector3<f64> {
        let change: f64 = wet.iter().map(|spell| spell.change_at(self.order)).sum();
        Vector3::from(self.log.map(f64::from)) - Vector3::y() * change
    }
}

impl Baseline {
    /// Computes a baseline from at least a dozen throws of a direction; `sensor` is the mean covariance of their
    /// estimates. With the slopes of a trend the centre is that of the throw at which the machine was least worn: the
    /// first one, or the last one while it runs in.
    pub(super) fn learn(
        throws: &[BaselineThrow],
        sensor: Sym3,
        of_ratios: bool,
        changes: Changes,
        taken_at: Timestamp,
        settings: &Settings,
    ) -> Self {
        let raw: Vec<_> = throws
            .iter()
            .zip(unchanged(throws, changes))
            .map(|(throw, log)| (log, throw.temperature_c.map(f64::from)))
            .collect();
        let temperature = Temperature::learn(&raw, settings);
        let compensated = |(x, celsius): &(Vector3<f64>, _)| x - temperature.effect(temperature.distance(*celsius));
        let logs: Vec<Vector3<f64>> = raw.iter().map(compensated).collect();
        let robust = centres_and_sds(&logs);
        let centre = robust.map(|(centre, _)| centre);
        let residuals: Vec<Vector3<f64>> = logs.iter().map(|x| clip(x - Vector3::from(centre), robust)).collect();
        let mut sensor = sensor.into();
        let differing = if of_ratios { differing_part(&residuals, &sensor) } else { None };
        if let Some(part) = &differing {
            sensor = transformed(sensor, part);
        }
        let mut durations: Vec<f64> = throws.iter().filter_map(|l| l.duration_s.map(f64::from)).collect();
        Self {
            centre,
            throws: throws.len(),
            complete: throws.len() >= settings.baseline_throws && changes.slopes.is_none(),
            taken_at,
            temperature,
            duration_s: (!durations.is_empty()).then(|| median(&mut durations)),
            scatter: Scatter::learn(&residuals, sensor, 1),
            slopes: changes.slopes,
            differing: differing.map(|part| Box::new(part.into())),
        }
    }

    /// Residuals of throws from their own centre, which may differ from that of the baseline, each with the number of
    /// its throw.
    pub(super) fn around_own_level(&self, throws: &[BaselineThrow], wet: &[WetSpell]) -> Vec<(u32, Vector3<f64>)> {
        let compensated = |(throw, log): (&BaselineThrow, Vector3<f64>)| {
            self.compensated(self.residual(&log.into(), throw.temperature_c.map(f64::from)))
        };
        let dry = Changes { slopes: None, wet };
        let logs: Vec<Vector3<f64>> = throws.iter().zip(unchanged(throws, dry)).map(compensated).collect();
        let robust = centres_and_sds(&logs);
        let level = Vector3::from(robust.map(|(centre, _)| centre));
        throws.iter().zip(logs).map(|(throw, log)| (throw.order, clip(log - level, robust))).collect()
    }

    /// Whether errors that repeat in every throw count in a comparison with it. With a baseline of ratios they cancel.
    pub(super) fn counts_repeating_errors(&self) -> bool {
        self.differing.is_none()
    }

    /// Covariance of the part of the errors of a throw's ratios that differs from throw to throw; `sensor` is the
    /// covariance of all its errors.
    pub(super) fn differing(&self, sensor: Matrix3<f64>) -> Matrix3<f64> {
        self.differing.as_ref().map_or(sensor, |part| transformed(sensor, &Matrix3::from(**part)))
    }

    /// Residual of a throw from the centre, without temperature compensation, and the distance from the reference
    /// temperature \[K\].
    pub(super) fn residual(&self, log: &[f64; 3], temperature_c: Option<f64>) -> (Vector3<f64>, f64) {
        (Vector3::from(*log) - Vector3::from(self.centre), self.temperature.distance(temperature_c))
    }

    /// The residual with temperature compensation.
    pub(super) fn compensated(&self, (raw, distance): (Vector3<f64>, f64)) -> Vector3<f64> {
        raw - self.temperature.effect(distance)
    }

    /// Number of throws whose mean is as uncertain as the centre. With a trend, the centre is an end of a fitted
    /// line, which has four times the variance of the middle of the line.
    pub(super) fn centre_throws(&self) -> f64 {
        self.throws as f64 / if self.slopes.is_none() { 1.0 } else { 4.0 }
    }

    pub(super) fn has_trend(&self) -> bool {
        self.slopes.is_some()
    }

    /// Whether it has all its throws. With a trend it is not complete even then. A baseline that only a lower setting
    /// makes full is taken again with the next throw, so that it becomes complete.
    pub(super) fn is_final(&self, settings: &Settings) -> bool {
        self.complete || self.has_trend() && self.throws >= settings.baseline_throws
    }

    pub(super) fn record(&self, direction: Direction, ratios_only: bool) -> BaselineRecord {
        let s = self.scatter.of_one_throw();
        BaselineRecord {
            direction,
            taken_at: self.taken_at,
            throws: self.throws,
            complete: self.complete,
            center: self.centre.map(f64::exp),
            ratios_only,
            log_covariance: [0, 1, 2].map(|i| [0, 1, 2].map(|j| s[(i, j)])),
            lag1: self.scatter.lag1,
            temperature_source: self.temperature.source,
            temperature_pct_per_k: self.temperature.per_k().map(|k| 100.0 * k),
            reference_c: self.temperature.reference_c,
            duration_s: self.duration_s,
        }
    }
}

/// Friction over the force of the spring at the end of the stroke, a1 / (a0 T), where T \[s\] is the duration: equation
/// 12 of the study in a steady movement over the stroke.
pub(super) fn friction_over_spring([_, a1, a0]: [f64; 3], duration_s: f64) -> f64 {
    a1 / a0 / duration_s
}

/// [`friction_over_spring`] of a machine: the geometric mean of its directions; 1 if no duration is known.
pub(super) fn usual_friction_over_spring(baselines: [Option<&Baseline>; 2]) -> f64 {
    /// Upper limit of the ratio. Where the spring takes a tenth of the load, the ratio is about 10; a weaker spring
    /// hardly shows in a0, so a larger ratio is uncertain.
    const MOST: f64 = 10.0;
    let of_direction =
        |baseline: &Baseline| Some(friction_over_spring(baseline.centre.map(f64::exp), baseline.duration_s?).min(MOST));
    baselines.into_iter().flatten().filter_map(of_direction).reduce(|a, b| (a * b).sqrt()).unwrap_or(1.0)
}

/// The matrix that maps an error of ratios to the part of it that differs from throw to throw; `sensor` is the
/// covariance of these errors. `None` if `sensor` cannot be inverted.
///
/// The errors come from the misfit of the model, which repeats on most machines. There the ratios scatter less than the
/// errors would let them. The matrix multiplies an error along each principal axis of the scatter relative to the
/// errors by the variance λ of this axis, at most by 1. So most of the scatter is left to the machine, whose throws may
/// be correlated.
fn differing_part(residuals: &[Vector3<f64>], sensor: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let seen = residuals.iter().map(|residual| residual * residual.transpose()).sum::<Matrix3<f64>>();
    // Residuals of ratios have no part along (1, 1, 1), so the variance that `sensor` has there is added.
    let seen = seen / residuals.len() as f64 + Matrix3::repeat(SCALE_VARIANCE);
    let root = sensor.cholesky()?.l();
    let inverse = root.try_inverse()?;
    let relative = (inverse * seen * inverse.transpose()).symmetric_eigen();
    let kept = Matrix3::from_diagonal(&relative.eigenvalues.map(|variance| variance.clamp(0.0, 1.0)));
    Some(root * relative.eigenvectors * kept * relative.eigenvectors.transpose() * inverse)
}

/// The covariance `sensor` of an error after the linear map `part`.
fn transformed(sensor: Matrix3<f64>, part: &Matrix3<f64>) -> Matrix3<f64> {
    part * sensor * part.transpose()
}

/// Scatter of the throws of both directions together, in the order in which the machine made them.
pub(super) fn learn_mixed(learned: [&[BaselineThrow]; 2], baselines: [&Baseline; 2], wet: &[WetSpell]) -> Scatter {
    let mut residuals: Vec<(u32, Vector3<f64>)> = Vec::new();
    let mut sensor = Matrix3::zeros();
    for (throws, baseline) in learned.into_iter().zip(baselines) {
        let sd = baseline.scatter.of_one_throw().diagonal().map(f64::sqrt);
        for (throw, log) in throws.iter().zip(unchanged(throws, Changes { slopes: baseline.slopes, wet })) {
            let r = baseline.compensated(baseline.residual(&log.into(), throw.temperature_c.map(f64::from)));
            residuals.push((throw.order, clip(r, [0, 1, 2].map(|i| (0.0, sd[i])))));
        }
        sensor += baseline.scatter.sensor() * throws.len() as f64;
    }
    sensor /= residuals.len() as f64;
    learn_in_order(residuals, sensor, 2)
}

/// [`Scatter::learn`] for residuals in any order, each with the number of its throw.
pub(super) fn learn_in_order(mut residuals: Vec<(u32, Vector3<f64>)>, sensor: Matrix3<f64>, centres: usize) -> Scatter {
    residuals.sort_unstable_by_key(|(order, _)| *order);
    let ordered: Vec<Vector3<f64>> = residuals.into_iter().map(|(_, residual)| residual).collect();
    Scatter::learn(&ordered, sensor, centres)
}

/// The logarithms, with `to_b0` of the ratios to b0.
fn relative(log: Vector3<f64>, to_b0: bool) -> Vector3<f64> {
    if to_b0 { log.add_scalar(-log.x) } else { log }
}

/// The logarithms of the throws without the known `changes`: each coefficient as in the first throw, or in the last one
/// if its slope is against wear.
fn unchanged(throws: &[BaselineThrow], changes: Changes) -> impl Iterator<Item = Vector3<f64>> {
    let [first, last] = [throws.first(), throws.last()].map(|throw| throw.map_or(0, |throw| throw.order));
    let slopes = changes.slopes.unwrap_or_default();
    throws.iter().map(move |throw| {
        let least_worn = |i: usize| if slopes[i] * WEAR_SIGN[i] < 0.0 { last } else { first };
        let since = |i: usize| f64::from(throw.order) - f64::from(least_worn(i));
        throw.dry(changes.wet) - Vector3::from_fn(|i, _| slopes[i] * since(i))
    })
}

/// The throws of both directions while the baselines fill, without the effect of rain, for the search for a trend;
/// `sensor` is the mean covariance of their estimates. `of_ratios`: as ratios to b0.
pub(super) fn filling<'a>(
    sides: [impl Iterator<Item = &'a BaselineThrow>; 2],
    sensor: Matrix3<f64>,
    wet: &[WetSpell],
    of_ratios: bool,
) -> Filling {
    let mut throws: Vec<TrendThrow> = Vec::new();
    let mut variance = [0.0; 3];
    for (side, series) in sides.into_iter().enumerate() {
        let (series, logs): (Vec<&BaselineThrow>, Vec<Vector3<f64>>) =
            series.map(|throw| (throw, throw.dry(wet))).map(|(throw, log)| (throw, relative(log, of_ratios))).unzip();
        if series.is_empty() {
            continue;
        }
        let robust = centres_and_sds(&logs);
        variance = std::array::from_fn(|i| robust[i].1.powi(2).max(variance[i]));
        throws.extend(series.into_iter().zip(logs).map(|(throw, log)| TrendThrow {
            order: throw.order,
            side,
            residual: log - Vector3::from(robust.map(|(centre, _)| centre)),
            temperature_c: throw.temperature_c.map(f64::from),
        }));
    }
    Filling::new(throws, variance, [0, 1, 2].map(|i| sensor[(i, i)]))
}

/// Sign of wear in b0, a1 and a0: a weaker motor, more friction, more stiffness.
const WEAR_SIGN: [f64; 3] = [-1.0, 1.0, 1.0];

/// Trend of the throws of both directions: slopes of ln b0, ln a1, ln a0 \[per throw of the machine\]; 0 for a
/// coefficient without a trend that matters.
pub(super) fn trend(filling: &Filling, settings: &Settings) -> [f64; 3] {
    /// [`trend::AT_THE_END`] applies to this number of last throws of all baselines together: one direction may
    /// complete its baseline two throws before the other.
    const LAST: usize = 4;
    // The throws of one direction may all be without an estimate.
    let is_end = filling.len() + LAST > filling.directions() * settings.baseline_throws;
    let bound = if is_end { trend::AT_THE_END } else { trend::WHILE_FILLING };
    let slopes = filling.slopes(bound.evidence);
    let limits = Cause::OF_COEFFICIENTS.map(|cause| settings.limit_pct(cause));
    let matters = |i: usize| {
        let change_pct = 100.0 * slopes[i] * filling.range();
        limits[i].is_some_and(|limit| change_pct.abs() > bound.part_of_limit * limit)
            && (is_end || change_pct * WEAR_SIGN[i] > 0.0)
    };
    std::array::from_fn(|i| if matters(i) { slopes[i] } else { 0.0 })
}

/// Robust centre and standard deviation of each of the three logarithms.
fn centres_and_sds(logs: &[Vector3<f64>]) -> [(f64, f64); 3] {
    [0, 1, 2].map(|i| centre_and_sd(&logs.iter().map(|log| log[i]).collect::<Vec<_>>()))
}

fn clip(residual: Vector3<f64>, robust: [(f64, f64); 3]) -> Vector3<f64> {
    const REACH_SD: f64 = 3.5;
    Vector3::from_fn(|i, _| residual[i].clamp(-REACH_SD * robust[i].1, REACH_SD * robust[i].1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Residuals of ratios to b0, with independent standard deviations of a1/b0 and a0/b0.
    fn residuals(sd: [f64; 2]) -> Vec<Vector3<f64>> {
        (0..48).map(|at| Vector3::new(0.0, sd[0] * [1.0, -1.0][at % 2], sd[1] * [1.0, -1.0][at / 2 % 2])).collect()
    }

    /// The change over the baseline is that of all throws of the machine, also of those between.
    #[test]
    fn rejected_throws_make_no_trend_smaller() {
        let slopes = |apart: u32| {
            // 9 % over the baseline.
            let throw = |at: u32| BaselineThrow {
                order: apart * at,
                log: [5.0, 2.0 + 0.0009 * at as f32 + if at % 4 < 2 { 0.003 } else { -0.003 }, 1.0],
                temperature_c: None,
                duration_s: None,
            };
            let throws: Vec<BaselineThrow> = (0..100).map(throw).collect();
            let sides = [0, 1].map(|side| throws.iter().skip(side).step_by(2));
            trend(&filling(sides, Matrix3::zeros(), &[], false), &Settings::default())
        };
        for apart in [1, 4] {
            assert!(slopes(apart)[1] > 0.0, "{apart}: {:?}", slopes(apart));
        }
    }

    #[test]
    fn errors_that_repeat_in_every_throw_are_no_scatter() {
        let scale = Matrix3::repeat(SCALE_VARIANCE);
        let stated = Matrix3::from_diagonal(&Vector3::new(0.0, 0.05_f64.powi(2), 0.05_f64.powi(2))) + scale;
        let differing = |sd| transformed(stated, &differing_part(&residuals(sd), &stated).unwrap()) - scale;
        let all = differing([0.05, 0.08]);
        assert!((all - (stated - scale)).norm() < 1e-9, "as large as stated, or larger: {all}");
        let part = differing([0.05, 0.005]);
        assert!((part[(1, 1)] - 0.05_f64.powi(2)).abs() < 1e-9, "a1/b0 scatters as stated: {part}");
        // The scatter has a hundredth of the stated variance, and of that a hundredth belongs to the errors.
        assert!(part[(2, 2)] < 2e-4 * 0.05_f64.powi(2), "a0/b0 hardly scatters: {part}");
    }
}
