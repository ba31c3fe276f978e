//! Detection of drifts in the last 3, 6, 12 and 24 throws. For each of these windows, T = m' V^-1 m is compared with
//! its limit, where m is the mean of the residuals (ln b0, ln a1, ln a0, relative to the baseline) and V is its
//! covariance.
//!
//! There are three streams of throws: one for each direction, and the mixed stream of both in the order of the throws.
//! The mixed stream is the first to show a fault of the machine; the stream of a direction shows a fault of this
//! direction only.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{Point, Thresholds};
use crate::diagnose::{
    Cause,
    baseline::{Baseline, covariance_of_effect},
    statistics::{LONGEST_WINDOW, LastValues, Level, Scatter, Sym3, WINDOWS, clipped_mean, sym3, to_f32},
};

/// Largest part of the limit of T that a single innovation may contribute to a window of three throws: two throws show
/// a step.
const MOST_OF_ONE: f64 = 0.4;
/// Largest such part if the scatter has heavy tails: four throws show a step.
const MOST_OF_ONE_WITH_HEAVY_TAILS: f64 = 0.08;
/// Least T, along the drift, of the innovations without an outlier. Of healthy innovations, 0.1 % have more and the
/// sign of the drift.
const CONFIRMED: f64 = 9.5;
/// Number of last throws in which the test for a fading change looks.
const FADES_WITHIN: usize = WINDOWS[2];
/// Limit of the test for a fading change, in standard deviations of a change between two throws. Each change is clipped
/// to it, so at least two changes must show that the drift fades: an outlier between throws with a drift does not.
const FADING_SD: f64 = 3.0;
/// Number of stored throws of each direction: those of the longest window.
const KEPT: usize = WINDOWS[3];
/// Least number of throws with the common scale for a window that shows it ([`CommonScale`]): with fewer, a single
/// outlier would count for all its throws of ratios.
const LEAST_SCALED: usize = WINDOWS[0];
/// Largest number of standard deviations of a lasting error that the test of T allows for. A lasting error is the same in
/// all throws of a machine, so it is drawn once: the effect of the temperature, which has one slope per machine, bounded
/// by physics at 2.5 standard deviations before any learning; and the misfit of rough throws, which repeats. The full
/// limit of T rules out chance in thousands of throws, and would multiply these errors by six or seven.
const MOST_OF_LASTING_SD: f64 = 3.0;
/// Standard deviation of the common scale, as a logarithm, in a window that does not show it: far more than any fault.
pub(crate) const UNKNOWN_SCALE_SD: f64 = 1.0;
/// A size does not depend on the common scale if its weights sum to less than this part of the largest weight. Weights
/// from windows that do not show the scale sum to less than a fiftieth, other weights to some tenths or more.
const NO_SCALE: f64 = 0.05;

/// A throw after the baseline, as its residual from the baseline. Short names keep the snapshot small.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct RecentThrow {
    /// Number of the throw among those of the machine. 32 bits keep the memory of a fleet small.
    #[serde(rename = "n")]
    pub(crate) order: u32,
    #[serde(rename = "r")]
    residual: [f32; 3],
    #[serde(rename = "c")]
    sensor: Sym3,
    /// Distance from the reference temperature \[K\].
    #[serde(rename = "k")]
    distance_k: f32,
    /// Whether only the ratios of the coefficients are known: residual and covariance have an arbitrary common scale.
    #[serde(rename = "s", default, skip_serializing_if = "std::ops::Not::not")]
    ratios_only: bool,
}

impl RecentThrow {
    pub(crate) fn new(order: u64, residual: Vector3<f64>, distance_k: f64, sensor: Sym3, ratios_only: bool) -> Self {
        let order = u32::try_from(order).unwrap_or(u32::MAX);
        Self {
            order,
            residual: [0, 1, 2].map(|i| to_f32(residual[i])),
            sensor,
            distance_k: to_f32(distance_k),
            ratios_only,
        }
    }

    /// Whether the throw shows the common scale of the coefficients, and so the inertia.
    pub(crate) fn has_scale(&self) -> bool {
        !self.ratios_only
    }

    /// Whether the throw has a value along `weights`: one of ratios has none along weights that depend on the common
    /// scale.
    fn counts_along(&self, weights: &Vector3<f64>) -> bool {
        self.has_scale() || weights.sum().abs() <= NO_SCALE * weights.amax()
    }

    /// The residual of this throw. One of ratios gets the common scale of the other throws, or 0 if this is unknown.
    fn scaled(&self, residual: Vector3<f64>, scale: &CommonScale) -> Vector3<f64> {
        match scale {
            CommonScale::OfSome { k, mean } if !self.has_scale() => residual.add_scalar(mean - k.dot(&residual)),
            CommonScale::Unknown { k } if !self.has_scale() => residual.add_scalar(-k.dot(&residual)),
            _ => residual,
        }
    }

    /// The residual without temperature compensation, and the distance from the reference temperature \[K\].
    pub(crate) fn raw(&self) -> (Vector3<f64>, f64) {
        (Vector3::from(self.residual.map(f64::from)), f64::from(self.distance_k))
    }

    /// The throw without this effect on the coefficients, or on their ratios.
    pub(crate) fn without(self, effect: impl Fn(bool) -> Vector3<f64>) -> Self {
        let raw = self.raw().0 - effect(!self.has_scale());
        Self { residual: raw.map(to_f32).into(), ..self }
    }

    /// Converts a throw of a snapshot of version 1, which stored residuals with temperature compensation.
    pub(crate) fn add_temperature(&mut self, baseline: &Baseline) {
        let (residual, distance) = self.raw();
        let raw = residual + baseline.temperature.effect(distance);
        *self = Self::new(self.order.into(), raw, distance, self.sensor, self.ratios_only);
    }
}

/// The last throws of one direction.
pub(crate) type RecentThrows = LastValues<RecentThrow, KEPT>;

/// The common scale of the throws of a window. If only the ratios of the coefficients of a throw are known, its three
/// logarithms have an unknown term in common: their common scale, which a change of the inertia shifts. It is the mean
/// of the logarithms with the weights `k` of [`Scatter::of_scale`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum CommonScale {
    /// All throws have their own scale, as on most machines.
    OfAll,
    /// The mean scale of the throws that have one.
    OfSome { k: Vector3<f64>, mean: f64 },
    /// Too few throws have a scale.
    Unknown { k: Vector3<f64> },
}

/// The mean of a window with its covariance and test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Window {
    pub(crate) throws: usize,
    /// Clipped mean of the residuals.
    pub(crate) mean: Vector3<f64>,
    /// Covariance of the mean, with the uncertainty of the baseline.
    pub(crate) covariance: Matrix3<f64>,
    /// Standard deviation of the uncertain effect of the temperature on the mean; contained in the covariance.
    pub(crate) temperature_sd: Vector3<f64>,
    /// Covariance of the misfit of the model in rough throws, which repeats; contained in the covariance.
    pub(crate) misfit: Sym3,
    pub(crate) scale: CommonScale,
}

/// The test of a window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Tested {
    pub(crate) window: Window,
    /// T relative to its limit; above 1 a drift is detected.
    pub(crate) excess: f64,
    /// Whether a drift above its limit is confirmed: it is no outlier that fades over the throws after it.
    pub(super) confirmed: bool,
}

impl Window {
    /// Whether the window shows `cause`. The ratios of the coefficients do not depend on the inertia.
    pub(crate) fn shows(&self, cause: Cause) -> bool {
        cause != Cause::Inertia || self.has_scale()
    }

    /// Whether the common scale of its throws is known.
    pub(crate) fn has_scale(&self) -> bool {
        !matches!(self.scale, CommonScale::Unknown { .. })
    }

    /// Whether b0 changed by more than `motor`, a logarithm, and scatter.
    pub(super) fn exceeds_motor(&self, motor: f64) -> bool {
        self.shows(Cause::Inertia) && self.mean.x.abs() > motor + 2.0 * self.covariance[(0, 0)].sqrt()
    }

    /// The window without the rise of ln a1 by dry friction at a lower speed.
    pub(super) fn without_dry_rise(mut self, rise: Level) -> Self {
        self.mean.y -= rise.value;
        self.covariance[(1, 1)] += rise.sd * rise.sd;
        self
    }

    /// The covariance for a test of T with this limit, in which lasting errors count for at most
    /// [`MOST_OF_LASTING_SD`].
    pub(crate) fn tested(&self, limit: f64) -> Matrix3<f64> {
        let counts = (MOST_OF_LASTING_SD * MOST_OF_LASTING_SD / limit).min(1.0);
        self.covariance - (covariance_of_effect(self.temperature_sd) + Matrix3::from(self.misfit)) * (1.0 - counts)
    }
}

/// A change of ratios, with the common scale at which the middle of the three changes is 0: a single fault leaves two
/// coefficients unchanged.
pub(crate) fn with_middle_kept(change: Vector3<f64>) -> Vector3<f64> {
    change.add_scalar(-change.sum() + change.max() + change.min())
}

/// Number of throws whose mean is as uncertain as the baselines' centres in the mean of `throws`; the centres of the
/// two directions have independent errors.
fn centre_throws(throws: &[(usize, &RecentThrow)], baselines: [Option<&Baseline>; 2]) -> Option<f64> {
    let mut spread = 0.0;
    for side in 0..2 {
        let count = throws.iter().filter(|(at, _)| *at == side).count();
        if count > 0 {
            let part = count as f64 / throws.len() as f64;
            spread += part * part / baselines[side]?.centre_throws();
        }
    }
    Some(1.0 / spread)
}

/// Mean covariance of the estimates of `throws`.
fn mean_sensor(throws: &[(usize, &RecentThrow)]) -> Matrix3<f64> {
    throws.iter().map(|(_, throw)| Matrix3::from(throw.sensor)).sum::<Matrix3<f64>>() / throws.len() as f64
}

/// The last throws of one direction, or of both, newest first, with the baselines of both directions.
pub(crate) struct Stream<'a> {
    throws: Vec<(usize, &'a RecentThrow)>,
    baselines: [Option<&'a Baseline>; 2],
}

impl<'a> Stream<'a> {
    /// The stream of one direction.
    pub(crate) fn of(ring: &'a RecentThrows, direction: usize, baselines: [Option<&'a Baseline>; 2]) -> Self {
        Self { throws: ring.iter().rev().map(|throw| (direction, throw)).collect(), baselines }
    }

    /// The stream of both directions, in the order of the throws; as long as that of one direction.
    pub(crate) fn mixed(rings: [&'a RecentThrows; 2], baselines: [Option<&'a Baseline>; 2]) -> Self {
        let mut all = Self::all(rings, baselines);
        all.throws.truncate(KEPT);
        all
    }

    /// All stored throws of both directions.
    pub(crate) fn all(rings: [&'a RecentThrows; 2], baselines: [Option<&'a Baseline>; 2]) -> Self {
        let of = |(side, ring)| Self::of(ring, side, baselines).throws;
        let mut throws: Vec<_> = rings.into_iter().enumerate().flat_map(of).collect();
        throws.sort_unstable_by_key(|(_, throw)| std::cmp::Reverse(throw.order));
        Self { throws, baselines }
    }

    pub(crate) fn len(&self) -> usize {
        self.throws.len()
    }

    /// The window of the last `throws`, without the test of T. `None` with fewer throws, or without the baseline of one
    /// of them.
    ///
    /// Throws of ratios contain no information about the common scale. The scale is the mean of the logarithms with
    /// weights `k`, chosen so that it has no correlation with the ratios. So the least-squares scale of the window is
    /// the mean over the other throws, while the least-squares ratios are the mean over all throws. Therefore the
    /// throws of ratios get the mean scale of the others, and the covariance along (1, 1, 1) is that of the other
    /// throws only.
    pub(crate) fn window(&self, throws: usize, scatter: &Scatter) -> Option<Window> {
        let last = self.throws.get(..throws)?;
        let sensor = mean_sensor(last);
        let mut distances = [(0.0, 0.0); 2];
        let mut residuals = Vec::with_capacity(throws);
        for (side, throw) in last {
            let (sum, count) = &mut distances[*side];
            *sum += f64::from(throw.distance_k);
            *count += 1.0;
            residuals.push(self.baselines[*side]?.compensated(throw.raw()));
        }
        let n = throws as f64;
        let scale = self.common_scale(&residuals, scatter);
        for (residual, (_, throw)) in residuals.iter_mut().zip(last) {
            *residual = throw.scaled(*residual, &scale);
        }
        let sd = scatter.sd_of_one(&sensor);
        let values = |i: usize| residuals.iter().map(|residual| residual[i]).collect::<Vec<_>>();
        let mut mean = Vector3::from_fn(|i, _| clipped_mean(&mut values(i), sd[i]));
        let mut temperature_sd = Vector3::zeros();
        for (baseline, (sum, count)) in self.baselines.into_iter().zip(distances) {
            if count > 0.0 {
                temperature_sd += baseline?.temperature.effect_sd(sum / count) * (count / n);
            }
        }
        let mut covariance = scatter.of_mean(throws, &sensor, centre_throws(last, self.baselines)?);
        let mut misfit = self.mean_misfit(throws) / n;
        let of_scale = match scale {
            // The only throw of ratios may be the one before the window, which the common scale includes.
            _ if last.iter().all(|(_, throw)| throw.has_scale()) => None,
            CommonScale::OfAll => None,
            CommonScale::OfSome { k, .. } => {
                let scaled: Vec<_> = last.iter().filter(|(_, throw)| throw.has_scale()).copied().collect();
                let centre = centre_throws(&scaled, self.baselines)?;
                Some((k, k.dot(&(scatter.of_mean(scaled.len(), &mean_sensor(&scaled), centre) * k))))
            }
            CommonScale::Unknown { k } => {
                mean = with_middle_kept(mean);
                Some((k, UNKNOWN_SCALE_SD * UNKNOWN_SCALE_SD))
            }
        };
        if let Some((k, of_scale)) = of_scale {
            let ratios = Matrix3::identity() - Vector3::repeat(1.0) * k.transpose();
            covariance = ratios * covariance * ratios.transpose() + Matrix3::repeat(of_scale);
            misfit = ratios * misfit * ratios.transpose();
        }
        covariance += covariance_of_effect(temperature_sd);
        Some(Window { throws, mean, covariance, temperature_sd, misfit: misfit.into(), scale })
    }

    /// The common scale of the last throws with these residuals.
    fn common_scale(&self, residuals: &[Vector3<f64>], scatter: &Scatter) -> CommonScale {
        // The test of the innovations also needs the throw before the window.
        if self.throws.iter().take(residuals.len() + 1).all(|(_, throw)| throw.has_scale()) {
            return CommonScale::OfAll;
        }
        let k = scatter.of_scale();
        let own = residuals.iter().zip(&self.throws).filter(|(_, (_, throw))| throw.has_scale());
        let mut values: Vec<f64> = own.map(|(residual, _)| k.dot(residual)).collect();
        if values.len() < LEAST_SCALED {
            return CommonScale::Unknown { k };
        }
        CommonScale::OfSome { k, mean: clipped_mean(&mut values, scatter.sd_along(&k)) }
    }

    /// T of the throws of `window` from their mean innovation, converted to a level, instead of their mean. An
    /// innovation is the part of a throw that the throw before it does not predict; each is clipped at `reach`. An
    /// outlier that affects the following throws too is a single innovation, so it counts once.
    fn t_of_innovations(&self, window: &Window, limit: f64, reach: &Vector3<f64>, scatter: &Scatter) -> Option<f64> {
        let n = window.throws as f64;
        let (rho, inverse) = self.innovation(window, limit, scatter)?;
        let fresh = rho.map(|rho| (1.0 - rho * rho).sqrt());
        let mut sum = Vector3::zeros();
        let mut throw = self.residual(0, window)?;
        for at in 1..=window.throws {
            let before = self.residual(at, window);
            let innovation = before.map_or(throw.component_mul(&fresh), |before| throw - rho.component_mul(&before));
            sum += Vector3::from_fn(|i, _| innovation[i].clamp(-reach[i], reach[i]));
            throw = before.unwrap_or_default();
        }
        let level = sum.component_div(&rho.map(|rho| n * (1.0 - rho)));
        Some((level.transpose() * inverse * level).x)
    }

    /// T of the innovations of `window` along those of a lasting change of its mean, without the largest innovation;
    /// for scatter with heavy tails, without the two largest. The serial correlation is the highest that is plausible
    /// for the machine. An outlier that fades over the next throws shifts the mean too, but only a drift keeps it
    /// shifted.
    fn t_without_outliers(&self, window: &Window, heavy_tails: bool, scatter: &Scatter) -> Option<f64> {
        // The misfit that repeats is in no innovation; only the part that differs from throw to throw is.
        let repeated = self.mean_misfit(window.throws) * (1.0 - 1.0 / f64::from(LONGEST_WINDOW));
        let sensor = mean_sensor(&self.throws[..window.throws]) - repeated;
        // The correlation is that of the machine alone: beside a large outlier, the errors of the estimates are small.
        let phi = scatter.highest_lag1();
        let outliers = if heavy_tails { 2 } else { 1 };
        let inverse = sym3::inverse(&scatter.of_innovations(1, 0, &phi, &sensor))?;
        let square = |x: &Vector3<f64>| (x.transpose() * inverse * x).x;
        let mut innovations = Vec::with_capacity(KEPT);
        let mut throw = self.residual(0, window)?;
        for at in 1..=window.throws {
            let before = self.residual(at, window).unwrap_or_default();
            innovations.push(throw - phi.component_mul(&before));
            throw = before;
        }
        innovations.sort_by(|a, b| square(a).total_cmp(&square(b)));
        innovations.truncate(window.throws - outliers);
        let inverse = sym3::inverse(&scatter.of_innovations(innovations.len(), outliers, &phi, &sensor))?;
        let sum: Vector3<f64> = innovations.iter().sum();
        let lasting = window.mean - phi.component_mul(&window.mean);
        let along = inverse * lasting;
        Some(along.dot(&sum).max(0.0).powi(2) / along.dot(&lasting))
    }

    /// Whether the change in `window` becomes smaller from throw to throw, as after an outlier: by the regression of
    /// its differences between consecutive throws of a direction on its size in the earlier throw.
    fn fades(&self, window: &Window, scatter: &Scatter) -> bool {
        let covariance = scatter.of_change(&mean_sensor(&self.throws[..window.throws]));
        let Some(inverse) = sym3::inverse(&covariance) else { return false };
        let along = inverse * window.mean;
        let along = along / along.dot(&window.mean).sqrt();
        let mut before: [Option<f64>; 2] = [None; 2];
        let (mut sum, mut squares) = (0.0, 0.0);
        for at in (0..FADES_WITHIN.min(self.len())).rev() {
            let Some(residual) = self.residual(at, window) else { continue };
            let size = along.dot(&residual);
            if let Some(before) = before[self.throws[at].0].replace(size) {
                sum += (size - before).clamp(-FADING_SD, FADING_SD) * before;
                squares += before * before;
            }
        }
        sum < -FADING_SD * f64::sqrt(squares)
    }

    /// Residual of the throw at this index, with the common scale of `window`; `None` without this throw or its
    /// baseline.
    fn residual(&self, at: usize, window: &Window) -> Option<Vector3<f64>> {
        let (side, throw) = self.throws.get(at)?;
        Some(throw.scaled(self.baselines[*side]?.compensated(throw.raw()), &window.scale))
    }

    /// For each coefficient, the innovation that alone would give `window` the part `most` of its limit.
    fn reach(&self, most: f64, limit: f64, window: &Window, scatter: &Scatter) -> Option<Vector3<f64>> {
        let (rho, inverse) = self.innovation(window, limit, scatter)?;
        Some(Vector3::from_fn(|i, _| window.throws as f64 * (1.0 - rho[i]) * (most * limit / inverse[(i, i)]).sqrt()))
    }

    /// Lag-1 correlations of the throws of `window`, and the inverse covariance of their mean innovation, converted to
    /// a level, for a test with this limit.
    fn innovation(&self, window: &Window, limit: f64, scatter: &Scatter) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let sensor = mean_sensor(&self.throws[..window.throws]);
        let covariance = window.tested(limit) + scatter.more_of_score(window.throws, &sensor);
        Some((scatter.lag1_of_one(&sensor), sym3::inverse(&covariance)?))
    }

    /// The part of the mean covariance of the last `throws` that comes from the misfit of rough throws, which repeats;
    /// only with a baseline of complete coefficients.
    fn mean_misfit(&self, throws: usize) -> Matrix3<f64> {
        let repeats = |(side, throw): &&(usize, &RecentThrow)| {
            throw.ratios_only && self.baselines[*side].is_some_and(Baseline::counts_repeating_errors)
        };
        let rough = self.throws[..throws].iter().filter(repeats);
        rough.map(|(_, throw)| Matrix3::from(throw.sensor)).sum::<Matrix3<f64>>() / throws as f64
    }

    /// The window with the largest `excess`, also if that is below 1. If T of the mean is above a quarter of the limit,
    /// the smaller of this T and that of the mean innovation counts. A single innovation counts for at most a part of
    /// the shortest window's limit. So an outlier is no drift, however heavy the tails are, and a step is detected even
    /// if the limits are high.
    pub(crate) fn strongest(&self, heavy_tails: bool, scatter: &Scatter, thresholds: &Thresholds) -> Option<Tested> {
        let mut best: Option<Tested> = None;
        let (mut shortest, mut reach) = (None, None);
        for (at, &throws) in WINDOWS.iter().enumerate() {
            let Some(window) = self.window(throws, scatter) else { continue };
            let shortest = *shortest.get_or_insert(window);
            let limit = thresholds.of(at);
            let Some(inverse) = sym3::inverse(&window.tested(limit)) else { continue };
            let t = (window.mean.transpose() * inverse * window.mean).x;
            let mut of_innovations = None;
            if t > 0.25 * limit {
                let most_of_one = if heavy_tails { MOST_OF_ONE_WITH_HEAVY_TAILS } else { MOST_OF_ONE };
                reach = reach.or_else(|| self.reach(most_of_one, thresholds.of(0), &shortest, scatter));
                of_innovations = reach.and_then(|reach| self.t_of_innovations(&window, limit, &reach, scatter));
            }
            let excess = t.min(of_innovations.unwrap_or(t)) / limit;
            if best.is_none_or(|best| excess > best.excess) {
                best = Some(Tested { window, excess, confirmed: false });
            }
        }
        let mut best = best?;
        best.confirmed = best.excess > 1.0
            && self.t_without_outliers(&best.window, heavy_tails, scatter).is_some_and(|t| t > CONFIRMED)
            && !self.fades(&best.window, scatter);
        Some(best)
    }

    /// The values of the throws along `weights` with temperature compensation, oldest first. Throws of ratios are left
    /// out if the size depends on the common scale. Ages count the throws of the machine back from the newest throw with
    /// a value; also returns its age before the throw `now`, without the throws of the other direction after the newest
    /// of all.
    pub(crate) fn points(&self, weights: &Vector3<f64>, now: u64) -> (Vec<Point>, u64) {
        let counted = self.throws.iter().find(|(_, throw)| throw.counts_along(weights));
        let since = counted
            .zip(self.throws.first())
            .map_or(0, |((_, counted), (_, newest))| u64::from(newest.order - counted.order));
        let point = |(side, throw): &(usize, &RecentThrow)| {
            if !throw.counts_along(weights) {
                return None;
            }
            let residual = self.baselines[*side]?.compensated(throw.raw());
            Some(Point {
                age: (now - since).saturating_sub(throw.order.into()) as f64,
                value: weights.dot(&residual),
                throws: 1.0,
            })
        };
        let mut points: Vec<Point> = self.throws.iter().filter_map(point).collect();
        points.reverse();
        (points, since)
    }

    /// Whether the last `throws` all have only ratios.
    pub(crate) fn is_without_scale(&self, throws: usize) -> bool {
        self.throws.iter().take(throws).all(|(_, throw)| !throw.has_scale())
    }

    /// Whether the last throws are balanced: at least three, and at least a quarter of each direction.
    pub(crate) fn is_balanced(&self) -> bool {
        let last = self.throws.iter().take(KEPT);
        let (total, reverse) = last.fold((0, 0), |(total, reverse), (side, _)| (total + 1, reverse + side));
        total >= WINDOWS[0] && 4 * reverse >= total && 4 * (total - reverse) >= total
    }
}
