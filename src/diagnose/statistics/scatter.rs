//! The natural scatter of a machine's throws, and the covariance of the mean of some throws.
//!
//! A throw's logarithms x = (ln b0, ln a1, ln a0) scatter around their centre for two reasons. The machine varies with
//! weather and load: covariance A, serially correlated, with the lag-1 correlation `phi_i` of coefficient i. The
//! estimator has errors: covariance C, independent from throw to throw and known for every estimate. The mean of w
//! throws has the covariance
//!
//! ```text
//! V = D A D + C / w,   D = diag(sqrt(g_w(phi_i) / w)),   g_w(phi) = 1 + 2 sum_{k<w} (1 - k/w) phi^k
//! ```
//!
//! where `g_w` is the ratio of the variance of a mean of w correlated throws to that of independent ones, for a
//! first-order autoregression. With more throws `g_w` tends to (1 + phi) / (1 - phi). A part of the scatter may last
//! longer than its lag-1 correlation shows, as weather does. This slow part has a `g_w` of its own, with the lag-1
//! correlation [`SLOW_LAG1`]. The centre of a baseline is a mean of throws too, and has an error of the same kind.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use statrs::function::beta::ln_beta;

use super::{
    persistence::{Kind, Possible, phi_of, possible},
    sym3::{self, Sym3},
};

/// Throws of a direction from which the covariance comes from the baseline alone, and the lag-1 correlation nearly so.
/// With fewer throws, both are weighted means with typical values, as a dozen correlated throws hardly determine them.
const ENOUGH_THROWS: f64 = 50.0;
/// Typical lag-1 correlation, as (weight in throws, value): with few, and with enough throws.
const USUAL_LAG1: [(f64, f64); 2] = [(20.0, 0.35), (4.0, 0.2)];
/// Weight of [`TYPICAL_SD`] in independent throws: for a typical machine, and for another machine.
const TYPICAL_WORTH: (f64, f64) = (15.0, 2.0);
/// Prior odds that a machine is typical.
const LIKE_MOST: f64 = 50.0;
/// Standard deviation of atanh of the lag-1 correlation, for typical machines and for others. The value 0.22 is
/// 1/sqrt(20), where 20 is the weight in [`USUAL_LAG1`] with few throws. With the value 0.7, one machine in seven has a
/// correlation above 0.8.
const LAG1_SD: (f64, f64) = (0.22, 0.7);
/// Least standard deviation of the natural scatter of each logarithm: absolute, far below that of any machine; and
/// relative to the largest of the three. Keeps covariances positive definite in single precision, also for equal
/// throws.
const LEAST_SD: (f64, f64) = (2e-4, 1e-3);
/// Typical standard deviations of ln b0, ln a1, ln a0 from weather and load.
const TYPICAL_SD: [f64; 3] = [0.005, 0.03, 0.01];
/// Range of lag-1 correlations. With a larger one, few throws cannot tell the variance of a mean. A lower end of zero
/// would make limits too wide, as the estimate for independent throws has errors of both signs.
const LAG1_RANGE: (f64, f64) = (-0.3, 0.95);
/// Largest lag-1 correlation that is considered possible: a series that is hardly stationary.
const MOST_LAG1: f64 = 0.98;
/// Lag-1 correlation of the slow part of the scatter: weather that lasts half a day, at twenty throws a day.
pub(crate) const SLOW_LAG1: f64 = 0.9;
/// Lags whose correlations show the slow part; the rest of the scatter has hardly any correlation at these lags.
const SLOW_LAGS: std::ops::Range<usize> = 5..16;
/// Least number of throws for an estimate of the slow part, about five times the longest lag in [`SLOW_LAGS`]. With 50
/// throws, the estimate may have any value from 0 to [`MOST_SLOW`].
const LEAST_FOR_SLOW: f64 = 80.0;
/// Standard deviations subtracted from an estimated slow part, so that scatter without one hardly ever gets one.
const DISCOUNT_SD: f64 = 0.5;
/// Largest slow part, as part of the natural variance.
const MOST_SLOW: f64 = 0.9;
/// Fourth moment of a Gaussian variable relative to the square of its variance.
const GAUSSIAN_KURTOSIS: f64 = 3.0;
/// Prior weight of Gaussian scatter against the measured kurtosis: three values each of 20 independent throws.
const GAUSSIAN_WEIGHT: f64 = 60.0;

/// A possible ratio of the true covariance of a mean of throws to the assumed covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Factor {
    pub(crate) ratio: f64,
    pub(crate) probability: f64,
    /// Degrees of freedom of the variance of one throw.
    pub(crate) freedom: f64,
}

/// Noise of a series of throws along one direction of the logarithms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Noise {
    /// Standard deviation of one throw, without the slow part.
    pub(crate) sd: f64,
    /// Correlation of consecutive throws, without the slow part.
    pub(crate) lag1: f64,
    /// Standard deviation of the slow part, whose lag-1 correlation is [`SLOW_LAG1`].
    pub(crate) slow_sd: f64,
    /// Standard deviation of the baseline's centre, and of other errors that all throws share.
    pub(crate) offset_sd: f64,
}

/// Natural scatter of a machine, from the residuals of a baseline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Scatter {
    /// Covariance A of the natural scatter.
    natural: Sym3,
    /// Mean covariance C of the estimates.
    sensor: Sym3,
    /// Lag-1 correlations of the natural scatter.
    pub(crate) lag1: [f64; 3],
    /// Slow part of the natural variance, 0 to [`MOST_SLOW`].
    #[serde(default)]
    slow: [f64; 3],
    throws: f64,
    /// Weight of the typical scatter in independent throws; 0 for a baseline of enough throws.
    #[serde(default)]
    leaning: f64,
    /// Degrees of freedom of one throw for a variance; 1 for Gaussian scatter, less with heavy tails.
    #[serde(default = "gaussian")]
    tail_worth: f64,
    /// Possible lag-1 correlations, coefficient by coefficient; empty for a baseline of enough throws.
    #[serde(default)]
    possible: Box<[Possible]>,
}

impl Scatter {
    /// Learns the scatter from residuals in the order of their throws. `sensor`: mean covariance of the estimates;
    /// `centres`: number of means removed from the residuals, one for each direction.
    pub(crate) fn learn(residuals: &[Vector3<f64>], sensor: Matrix3<f64>, centres: usize) -> Self {
        let throws = residuals.len() as f64;
        let zero = residuals.iter().map(|r| r * r.transpose()).sum::<Matrix3<f64>>() / throws;
        let lagged = |i: usize, lag: usize| -> f64 {
            residuals.iter().zip(&residuals[lag..]).map(|(a, b)| a[i] * b[i]).sum::<f64>() / throws
        };
        let few = throws < ENOUGH_THROWS * centres as f64;
        let (usual_weight, usual) = usual_lag1(few);
        let mut lag1 = [0.0; 3];
        let mut slow = [0.0; 3];
        let mut grow = Vector3::zeros();
        for i in 0..3 {
            // Removing the mean reduces the moments by the variance of the mean; corrected with a first guess of it.
            let share = ((zero[(i, i)] - sensor[(i, i)]) / zero[(i, i)]).clamp(0.0, 1.0);
            let natural = zero[(i, i)] * share.max(0.2);
            let raw = if share > 0.0 { lagged(i, 1) / natural } else { 0.0 };
            let unbiased = (raw + centres as f64 / throws) / (1.0 - 3.0 * centres as f64 / throws);
            let weight = throws * share;
            // atanh of an estimated correlation is nearly normal.
            let own = unbiased.clamp(-MOST_LAG1, MOST_LAG1).atanh();
            lag1[i] = ((weight * own + usual_weight * f64::atanh(usual)) / (weight + usual_weight))
                .tanh()
                .clamp(LAG1_RANGE.0, LAG1_RANGE.1);
            slow[i] = slow_part(lag1[i], throws, |lag| lagged(i, lag) / natural * throws / (throws - lag as f64));
            let lost = centres as f64 * (1.0 + share * (inflation_of(lag1[i], slow[i], throws) - 1.0)) / throws;
            grow[i] = (1.0 / (1.0 - lost.min(0.5))).sqrt();
        }
        let scale = Matrix3::from_diagonal(&grow);
        let total = scale * zero * scale;
        let own = effective(throws, lag1.iter().sum::<f64>() / 3.0);
        let typical = Matrix3::from_diagonal(&Vector3::from(TYPICAL_SD).map(|sd| sd * sd));
        let leaning = if few { worth_of_typical(total, typical + sensor, own) } else { 0.0 };
        let natural = (natural_part(total, sensor) * own + typical * leaning) / (own + leaning);
        let least = LEAST_SD.0.powi(2) + LEAST_SD.1.powi(2) * natural.diagonal().max();
        let natural = natural + Matrix3::from_diagonal_element(least);
        let tail_worth = tail_worth(residuals, own);
        let possible = few.then(|| {
            let like = Kind { ln_odds: 0.0, worth: TYPICAL_WORTH.0, phi_sd: LAG1_SD.0 };
            let other = Kind { ln_odds: -LIKE_MOST.ln(), worth: TYPICAL_WORTH.1, phi_sd: LAG1_SD.1 };
            let variances = [natural, sensor, typical].map(|covariance| covariance.diagonal());
            possible(residuals, variances, tail_worth, [like, other]).into_iter().flatten().collect()
        });
        Self {
            natural: natural.into(),
            sensor: sensor.into(),
            lag1,
            slow,
            throws,
            leaning,
            tail_worth,
            possible: possible.unwrap_or_default(),
        }
    }

    /// Covariance of one throw: natural scatter plus mean covariance of the estimates.
    pub(crate) fn of_one_throw(&self) -> Matrix3<f64> {
        Matrix3::from(self.natural) + Matrix3::from(self.sensor)
    }

    /// Standard deviation of one throw along `weights`.
    pub(crate) fn sd_along(&self, weights: &Vector3<f64>) -> f64 {
        weights.dot(&(self.of_one_throw() * weights)).max(1e-12).sqrt()
    }

    /// Weights, with the sum 1, of the mean of the three logarithms that a throw determines best. This mean is not
    /// correlated with the ratios of the coefficients.
    pub(crate) fn of_scale(&self) -> Vector3<f64> {
        let inverse = sym3::inverse(&self.of_one_throw()).unwrap_or_else(Matrix3::identity);
        let weights = inverse * Vector3::repeat(1.0);
        weights / weights.sum()
    }

    /// Mean covariance of the estimates in the baseline.
    pub(crate) fn sensor(&self) -> Matrix3<f64> {
        self.sensor.into()
    }

    /// Standard deviations of one throw whose estimate has the covariance `sensor`.
    pub(crate) fn sd_of_one(&self, sensor: &Matrix3<f64>) -> Vector3<f64> {
        (Matrix3::from(self.natural) + sensor).diagonal().map(|v| v.max(1e-12).sqrt())
    }

    /// Noise along `weights`, for throws compared with the centre of a baseline of `baseline_throws` throws.
    pub(crate) fn along(&self, weights: &Vector3<f64>, baseline_throws: f64) -> Noise {
        let variance = |m: Matrix3<f64>| (weights.transpose() * m * weights).x.max(0.0);
        let slow = scaled(self.natural.into(), self.slow.into());
        let rest = scaled(self.natural.into(), Vector3::from(self.slow).map(|slow| 1.0 - slow));
        let total = variance(rest + Matrix3::from(self.sensor)).max(1e-12);
        let lag1 = Vector3::from_fn(|i, _| lag1_of_rest(self.lag1[i], self.slow[i]));
        let lagged = rest.component_mul(&Matrix3::from_fn(|i, j| 0.5 * (lag1[i] + lag1[j])));
        let lag1 = ((weights.transpose() * lagged * weights).x / total).clamp(LAG1_RANGE.0, LAG1_RANGE.1);
        let offset_sd = variance(self.centre(baseline_throws)).sqrt();
        Noise { sd: total.sqrt(), lag1, slow_sd: variance(slow).sqrt(), offset_sd }
    }

    /// Covariance of the centre of a baseline of `baseline_throws` throws.
    fn centre(&self, baseline_throws: f64) -> Matrix3<f64> {
        let factors = Vector3::from_fn(|i, _| self.inflation(i, self.throws) / baseline_throws);
        scaled(self.natural.into(), factors) + Matrix3::from(self.sensor) / baseline_throws
    }

    /// Covariance of the difference between a mean of `w` throws and the centre of a baseline of `baseline_throws`
    /// throws. `sensor`: mean covariance of the estimates of the `w` throws.
    pub(crate) fn of_mean(&self, w: usize, sensor: &Matrix3<f64>, baseline_throws: f64) -> Matrix3<f64> {
        let w = w as f64;
        let factors = Vector3::from_fn(|i, _| self.inflation(i, w) / w);
        scaled(self.natural.into(), factors) + sensor / w + self.centre(baseline_throws)
    }

    /// Lag-1 correlations of the logarithms of throws; errors of the estimates, with covariance `sensor`, reduce them.
    pub(crate) fn lag1_of_one(&self, sensor: &Matrix3<f64>) -> Vector3<f64> {
        let natural = Matrix3::from(self.natural).diagonal();
        let share = natural.component_div(&(natural + sensor.diagonal()).map(|v| v.max(1e-12)));
        share.component_mul(&Vector3::from(self.lag1))
    }

    /// The largest plausible lag-1 correlations of the natural scatter: estimate plus two standard deviations.
    pub(crate) fn highest_lag1(&self) -> Vector3<f64> {
        Vector3::from_fn(|i, _| (self.lag1[i].atanh() + 2.0 * self.lag1_sd(i)).tanh().min(LAG1_RANGE.1))
    }

    /// Standard deviation of atanh of the lag-1 correlation of coefficient `i`.
    fn lag1_sd(&self, i: usize) -> f64 {
        let [natural, sensor] = [self.natural, self.sensor].map(|covariance| Matrix3::from(covariance)[(i, i)]);
        let share = natural / (natural + sensor).max(f64::MIN_POSITIVE);
        let (usual_weight, _) = usual_lag1(self.leaning > 0.0);
        ((self.throws * share * (1.0 - self.lag1[i].powi(2))).max(1.0) + usual_weight).sqrt().recip()
    }

    /// Covariance of the sum of `count` innovations; an innovation is x less phi times the x before. `sensor`:
    /// covariance of the estimates; `gaps`: innovations left out between. The error of an estimate is in two
    /// innovations, with opposite signs.
    pub(crate) fn of_innovations(
        &self,
        count: usize,
        gaps: usize,
        phi: &Vector3<f64>,
        sensor: &Matrix3<f64>,
    ) -> Matrix3<f64> {
        let (count, ends) = (count as f64, 1.0 + gaps as f64);
        let fresh = phi.map(|phi| count * (1.0 - phi * phi));
        let errors = phi.map(|phi| count * (1.0 - phi).powi(2) + 2.0 * ends * phi.max(0.0));
        scaled(self.natural.into(), fresh) + scaled(*sensor, errors)
    }

    /// Covariance of the change between two consecutive throws; `sensor`: covariance of their estimates.
    pub(crate) fn of_change(&self, sensor: &Matrix3<f64>) -> Matrix3<f64> {
        let fresh = Vector3::from(self.lag1).map(|lag1| 1.0 - lag1.max(0.0));
        2.0 * (scaled(self.natural.into(), fresh) + sensor)
    }

    /// Covariance of the mean innovation of `w` throws, less [`Self::of_mean`]. An innovation is x less rho times
    /// the x before, where rho is the lag-1 correlation; the mean innovation is the sum of `w` innovations, divided by
    /// w (1 - rho). It differs from the mean of x only by the throws at both ends. For autoregressive scatter it has
    /// the variance of such a part of a long series.
    pub(crate) fn more_of_score(&self, w: usize, sensor: &Matrix3<f64>) -> Matrix3<f64> {
        let w = w as f64;
        let rho = self.lag1_of_one(sensor);
        let ends = rho.map(|rho| 2.0 * rho.max(0.0) / (w * (1.0 - rho)).powi(2));
        let own = |i: usize| self.inflation(i, f64::INFINITY) - self.inflation(i, w);
        let more = Vector3::from_fn(|i, _| own(i).max(0.0) / w);
        scaled(self.natural.into(), more) + scaled(*sensor, ends)
    }

    /// `g_w` of coefficient `i`: ratio of the natural variance of a mean of `w` throws to that of independent throws.
    fn inflation(&self, i: usize, w: f64) -> f64 {
        inflation_of(self.lag1[i], self.slow[i], w)
    }

    /// Possible factors on [`Self::of_mean`] of `w` throws: variance and lag-1 correlation are uncertain, as they come
    /// from a finite number of throws. For a lag-1 correlation phi from n throws, atanh phi is nearly normal with the
    /// variance 1 / (n (1 - phi^2)), as that of phi is (1 - phi^2) / n (Bartlett). The measured variance is that of the
    /// innovations, so a larger phi also means a larger variance of one throw. Each coefficient has a third of the
    /// probability. Few throws need another method: see [`super::persistence`].
    pub(crate) fn factors(&self, w: usize) -> Vec<Factor> {
        /// Nodes on each side of the estimated value, and their distance in standard deviations.
        const NODES: (i32, f64) = (6, 0.8);
        let (natural, sensor) = (Matrix3::from(self.natural), Matrix3::from(self.sensor));
        let w = w as f64;
        let of = |phi: f64| inflation(phi, w) / w + inflation(phi, self.throws) / self.throws;
        let of_natural = |phi: f64| of(phi) / (1.0 - phi * phi);
        if !self.possible.is_empty() {
            let nodes = self.possible.len() / 3;
            let factor = |(at, possible): (usize, &Possible)| {
                let i = at / nodes;
                let fixed = sensor[(i, i)] * (1.0 / w + 1.0 / self.throws);
                let natural_of_mean = f64::from(possible.variance) * of(phi_of(at % nodes));
                let ratio =
                    (natural_of_mean + fixed) / (natural[(i, i)] * of(self.lag1[i]) + fixed).max(f64::MIN_POSITIVE);
                Factor { ratio, probability: possible.weight.into(), freedom: possible.freedom.into() }
            };
            return self.possible.iter().enumerate().map(factor).collect();
        }
        let independent = self.lag1.iter().map(|phi| effective(self.throws, *phi)).sum::<f64>() / 3.0;
        let freedom = independent * self.tail_worth + self.leaning;
        let mut factors = Vec::new();
        for i in 0..3 {
            let phi = self.lag1[i];
            let sd = self.lag1_sd(i);
            let fixed = sensor[(i, i)] * (1.0 / w + 1.0 / self.throws);
            let assumed = natural[(i, i)] * of_natural(phi) * (1.0 - phi * phi);
            factors.extend((-NODES.0..=NODES.0).map(|node| {
                let z = f64::from(node) * NODES.1;
                let other = (phi.atanh() + z * sd).tanh().clamp(LAG1_RANGE.0, MOST_LAG1);
                let natural = assumed * of_natural(other) / of_natural(phi);
                let ratio = (natural + fixed) / (assumed + fixed).max(f64::MIN_POSITIVE);
                Factor { ratio, probability: (-0.5 * z * z).exp(), freedom }
            }));
        }
        let total: f64 = factors.iter().map(|factor| factor.probability).sum();
        for factor in &mut factors {
            factor.probability /= total;
        }
        factors
    }
}

/// The covariance `m` with its variances multiplied by `factors`, and the same correlations.
fn scaled(m: Matrix3<f64>, factors: Vector3<f64>) -> Matrix3<f64> {
    let root = factors.map(f64::sqrt);
    m.component_mul(&(root * root.transpose()))
}

fn gaussian() -> f64 {
    1.0
}

/// Degrees of freedom of one residual for a variance, 1 for Gaussian scatter: 2 / (kurtosis - 1), squared. The square
/// is needed as residuals are clipped in proportion to their own spread, which varies with the tails too. Example
/// (simulated): 50 throws of Student's t with three degrees of freedom have a kurtosis of 3.9 after clipping, and
/// determine the variance as 21 Gaussian throws do. Few independent throws show no tails and count as Gaussian.
fn tail_worth(residuals: &[Vector3<f64>], independent: f64) -> f64 {
    let moment =
        |i: usize, power: i32| residuals.iter().map(|r| r[i].powi(power)).sum::<f64>() / residuals.len() as f64;
    let kurtosis = (0..3).map(|i| moment(i, 4) / moment(i, 2).powi(2).max(f64::MIN_POSITIVE)).sum::<f64>() / 3.0;
    let weight = 3.0 * independent;
    let excess = weight * (kurtosis - GAUSSIAN_KURTOSIS).max(0.0) / (weight + GAUSSIAN_WEIGHT);
    (2.0 / (GAUSSIAN_KURTOSIS - 1.0 + excess)).powi(2)
}

/// Weight and value of the typical lag-1 correlation, see [`USUAL_LAG1`].
fn usual_lag1(few: bool) -> (f64, f64) {
    USUAL_LAG1[usize::from(!few)]
}

/// Weight of the typical scatter in independent throws: large if the variances `total`, from `own` independent throws,
/// agree with the `typical` ones, small if not. The evidence for either is that of a variance with an inverse
/// chi-square prior of this weight.
fn worth_of_typical(total: Matrix3<f64>, typical: Matrix3<f64>, own: f64) -> f64 {
    let ratios = total.diagonal().component_div(&typical.diagonal());
    let evidence = |worth: f64| -> f64 {
        let of = |ratio: f64| 0.5 * (worth * worth.ln() - (own + worth) * (worth + own * ratio).ln());
        ratios.iter().map(|ratio| of(*ratio) - ln_beta(0.5 * own, 0.5 * worth)).sum()
    };
    let (most, other) = TYPICAL_WORTH;
    let unlike = ((evidence(other) - evidence(most)).exp() / LIKE_MOST).min(f64::MAX);
    (most + other * unlike) / (1.0 + unlike)
}

/// Number of independent throws that determine a variance as well as `throws` with the lag-1 correlation `phi`.
fn effective(throws: f64, phi: f64) -> f64 {
    throws * (1.0 - phi * phi) / (1.0 + phi * phi)
}

/// `g_w(phi)`: variance of a mean of `w` throws relative to that of independent ones. `w` may be infinite.
pub(crate) fn inflation(phi: f64, w: f64) -> f64 {
    let rest = 1.0 - phi;
    if w.is_infinite() {
        return (1.0 + phi) / rest;
    }
    (1.0 + phi) / rest - 2.0 * phi * (1.0 - phi.powf(w)) / (w * rest * rest)
}

/// [`inflation`] of scatter with the lag-1 correlation `lag1`; its part `slow` has the lag-1 correlation [`SLOW_LAG1`].
fn inflation_of(lag1: f64, slow: f64, w: f64) -> f64 {
    if slow > 0.0 {
        (1.0 - slow) * inflation(lag1_of_rest(lag1, slow), w) + slow * inflation(SLOW_LAG1, w)
    } else {
        inflation(lag1, w)
    }
}

/// Lag-1 correlation of the rest of scatter that has the lag-1 correlation `lag1` and the slow part `slow`.
fn lag1_of_rest(lag1: f64, slow: f64) -> f64 {
    ((lag1 - SLOW_LAG1 * slow) / (1.0 - slow)).clamp(LAG1_RANGE.0, LAG1_RANGE.1)
}

/// Slow part of the scatter of `throws` residuals, from the lag-1 correlation and those at [`SLOW_LAGS`].
fn slow_part(lag1: f64, throws: f64, correlation: impl Fn(usize) -> f64) -> f64 {
    if throws < LEAST_FOR_SLOW {
        return 0.0;
    }
    let count = SLOW_LAGS.len() as f64;
    let measured = SLOW_LAGS.map(correlation).sum::<f64>() / count;
    if measured.is_nan() {
        // A coefficient without scatter, as b0 in a baseline of ratios.
        return 0.0;
    }
    // Removing the mean reduces all correlations by the variance of the mean.
    let expected =
        |phi: f64| SLOW_LAGS.map(|lag| phi.powf(lag as f64)).sum::<f64>() / count - inflation(phi, throws) / throws;
    let of_slow = expected(SLOW_LAG1);
    let phi = lag1.max(0.0);
    let sd = (inflation(phi, f64::INFINITY) * (1.0 + phi * phi) / (1.0 - phi * phi) / (count * throws)).sqrt();
    let mut slow = 0.0;
    for _ in 0..5 {
        let rest = (1.0 - slow) * expected(lag1_of_rest(lag1, slow));
        slow = ((measured - rest - DISCOUNT_SD * sd) / of_slow).clamp(0.0, MOST_SLOW);
    }
    slow
}

/// [`inflation`] of an infinite series; `phi` is clamped to 0 and the upper end of [`LAG1_RANGE`].
pub(crate) fn serial_inflation(phi: f64) -> f64 {
    let phi = phi.clamp(0.0, LAG1_RANGE.1);
    (1.0 + phi) / (1.0 - phi)
}

/// The part of `total` that the errors of the estimates do not explain; positive semidefinite.
fn natural_part(total: Matrix3<f64>, sensor: Matrix3<f64>) -> Matrix3<f64> {
    let eigen = (total - sensor).symmetric_eigen();
    let kept = eigen.eigenvalues.map(|v| v.max(0.0));
    eigen.eigenvectors * Matrix3::from_diagonal(&kept) * eigen.eigenvectors.transpose()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Scatter learned from many baselines of 100 throws, whose residuals are the sum of autoregressions of first order
    /// with these lag-1 correlations and shares of the variance.
    fn learned(parts: &[(f64, f64)]) -> Vec<Scatter> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let baseline = |_| {
            let mut states = vec![0.0; parts.len()];
            let mut next = || {
                for (state, (phi, share)) in states.iter_mut().zip(parts) {
                    *state = phi * *state + ((1.0 - phi * phi) * share).sqrt() * normal();
                }
                Vector3::repeat(0.03 * states.iter().sum::<f64>())
            };
            let series: Vec<_> = (0..200).map(|_| next()).skip(100).collect();
            let mean = series.iter().sum::<Vector3<f64>>() / 100.0;
            let residuals: Vec<_> = series.into_iter().map(|x| x - mean).collect();
            Scatter::learn(&residuals, Matrix3::identity() * 1e-8, 1)
        };
        (0..300).map(baseline).collect()
    }

    /// A mean that used the lag-1 correlation alone would have half of the true variance.
    #[test]
    fn the_variance_of_a_mean_contains_scatter_that_lasts() {
        for slow in [(0.9, 0.4), (0.95, 0.3)] {
            let parts = [(0.2, 1.0 - slow.1), slow];
            let learned = learned(&parts);
            let of_mean = |scatter: &Scatter| scatter.of_mean(24, &Matrix3::zeros(), f64::INFINITY)[(1, 1)];
            let stated = learned.iter().map(of_mean).sum::<f64>() / learned.len() as f64;
            let inflation: f64 = parts.iter().map(|(phi, share)| share * inflation(*phi, 24.0)).sum();
            let ratio = stated / (9e-4 * inflation / 24.0);
            assert!((0.6..1.2).contains(&ratio), "{ratio} for {slow:?}");
        }
    }

    #[test]
    fn scatter_that_does_not_last_has_hardly_any_slow_part() {
        for phi in [0.0, 0.3, 0.6] {
            let learned = learned(&[(phi, 1.0)]);
            let slow = learned.iter().map(|scatter| scatter.slow[1]).sum::<f64>() / learned.len() as f64;
            assert!(slow < 0.1, "{slow} for {phi}");
        }
    }

    #[test]
    fn the_inflation_is_the_sum_it_stands_for() {
        for (phi, w) in [(0.0, 3_u32), (0.5, 3), (0.6, 24), (0.3, 6)] {
            let w_f = f64::from(w);
            let sum: f64 = (1..w).map(|k| (1.0 - f64::from(k) / w_f) * f64::powi(phi, k.cast_signed())).sum();
            assert!((inflation(phi, w_f) - (1.0 + 2.0 * sum)).abs() < 1e-12);
        }
    }
}
