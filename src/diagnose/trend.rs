//! A trend in the throws of a baseline: wear that was there from the first throw on.
//!
//! Two models of a coefficient's logarithm are compared: a level for each direction (and the effect of the temperature,
//! if it is known), and the same with a slope. A slope must also explain the throws better than a step. The throws
//! scatter as a first-order autoregression of unknown variance and unknown lag-1 correlation phi, any from 0 to 1 with
//! the same probability, plus the errors of the estimates. All models are integrated over phi, so that a machine whose
//! throws wander is not taken for one that wears out. Levels and variance have flat priors (Zellner, An Introduction to
//! Bayesian Inference in Econometrics, 1971, 3.1); the change over the throws has a normal prior.

use nalgebra::Vector3;

use super::autoregression::{Autoregression, Whitening, dot, ln_sum};

/// Throws from which a trend can be found.
const LEAST_THROWS: usize = 24;
/// Number of values of phi.
const PHIS: u32 = 16;
/// Prior standard deviation of the change over all throws, in standard deviations of one throw.
const CHANGE_SD: f64 = 4.0;
/// Bounds from which a baseline has a trend.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bound {
    /// Logarithm of the Bayes factor of slope against levels.
    pub(super) evidence: f64,
    /// Change over the throws as part of the warning limit.
    pub(super) part_of_limit: f64,
}
/// The bounds while a baseline fills. Throws that depend strongly on those before often look like a slope for some throws,
/// so the change must also be that of a part near its limit (and the sign that of wear).
pub(super) const WHILE_FILLING: Bound = Bound { evidence: 1.0, part_of_limit: 0.65 };
/// The bounds for the last throws of a baseline, which stays provisional with a trend. Of 4,000 series of 100 healthy throws
/// with phi from 0 to 0.9 about 1 % or fewer reach them.
pub(super) const AT_THE_END: Bound = Bound { evidence: 2.7, part_of_limit: 1.0 / 3.0 };
/// Number of parts of the series between which a step may be.
const STEPS: usize = 12;
/// Logarithm of the Bayes factor of slope against step from which the series has a slope and not a step, which is
/// detected as a drift.
const STEP_BOUND: f64 = 1.0;
/// Residuals are clipped at this many robust standard deviations.
const CLIP_SD: f64 = 3.5;

/// A throw of a baseline, of either direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct TrendThrow {
    /// Number of the throw among those of the machine.
    pub(super) order: u64,
    /// Side of its direction.
    pub(super) side: usize,
    /// Distance of the logarithms from the centre of the direction.
    pub(super) residual: Vector3<f64>,
    pub(super) temperature_c: Option<f64>,
}

/// Slopes of ln b0, ln a1, ln a0 per throw of the machine; 0 without a trend. `error_part` is the part of the estimates'
/// errors in the variance of each, `evidence` that of a bound above.
pub(super) fn slopes(throws: &[TrendThrow], sd: [f64; 3], error_part: [f64; 3], evidence: f64) -> [f64; 3] {
    if throws.len() < LEAST_THROWS {
        return [0.0; 3];
    }
    let (first, last) = (throws[0].order, throws[throws.len() - 1].order);
    let range = (last - first) as f64;
    let time: Vec<f64> = throws.iter().map(|throw| (throw.order - first) as f64 / range - 0.5).collect();
    let mut levels: Vec<Vec<f64>> = (0..2)
        .map(|side| throws.iter().map(|throw| f64::from(u8::from(throw.side == side))).collect())
        .filter(|level: &Vec<f64>| level.contains(&1.0))
        .collect();
    let celsius: Option<Vec<f64>> = throws.iter().map(|throw| throw.temperature_c).collect();
    levels.extend(celsius.filter(|celsius| celsius.iter().any(|c| (c - celsius[0]).abs() > 0.1)));
    std::array::from_fn(|i| {
        let reach = CLIP_SD * sd[i];
        let values: Vec<f64> = throws.iter().map(|throw| throw.residual[i].clamp(-reach, reach)).collect();
        slope(&values, &time, &levels, error_part[i], evidence).map_or(0.0, |change| change / range)
    })
}

/// The change over a series with a trend.
fn slope(values: &[f64], time: &[f64], levels: &[Vec<f64>], error_part: f64, evidence: f64) -> Option<f64> {
    let series = Series::new(values, levels, error_part);
    let sloped = series.with(time);
    if sloped.evidence - series.evidence() < evidence {
        return None;
    }
    let step = |at: usize| -> Vec<f64> { (0..values.len()).map(|t| if t < at { -0.5 } else { 0.5 }).collect() };
    let steps: Vec<f64> = (1..STEPS).map(|at| series.with(&step(at * values.len() / STEPS)).evidence).collect();
    let stepped = ln_sum(steps.into_iter()) - (STEPS as f64 - 1.0).ln();
    (sloped.evidence - stepped > STEP_BOUND).then_some(sloped.change)
}

/// A series without its levels, for each phi.
struct Series(Vec<Whitened>);

/// A series for a given phi.
struct Whitened {
    noise: Whitening,
    /// Orthonormal columns of the levels.
    basis: Vec<Vec<f64>>,
    /// The innovations of the series without levels.
    rest: Vec<f64>,
    half_freedom: f64,
    /// Logarithm of the evidence, without the part of `rest`.
    of_levels: f64,
}

/// Evidence for a regressor, and its coefficient.
struct Regression {
    /// Logarithm of the evidence.
    evidence: f64,
    change: f64,
}

impl Series {
    fn new(values: &[f64], levels: &[Vec<f64>], error_part: f64) -> Self {
        let phis = (0..PHIS).map(|step| (f64::from(step) + 0.5) / f64::from(PHIS));
        let noise = |phi: f64| Autoregression { phi, natural: 1.0 - error_part, error: error_part };
        Self(phis.map(|phi| Whitened::new(&noise(phi), values, levels)).collect())
    }

    /// Logarithm of the evidence for levels alone.
    fn evidence(&self) -> f64 {
        let of = |part: &Whitened| part.of_levels - part.half_freedom * dot(&part.rest, &part.rest).ln();
        ln_sum(self.0.iter().map(of))
    }

    fn with(&self, regressor: &[f64]) -> Regression {
        let parts: Vec<Regression> = self.0.iter().map(|part| part.with(regressor)).collect();
        let evidence = ln_sum(parts.iter().map(|part| part.evidence));
        let change = parts.iter().map(|part| (part.evidence - evidence).exp() * part.change).sum();
        Regression { evidence, change }
    }
}

impl Whitened {
    fn new(noise: &Autoregression, values: &[f64], levels: &[Vec<f64>]) -> Self {
        let noise = noise.whitening(values.len());
        let mut rest = noise.of(values);
        let mut of_levels = -0.5 * noise.ln_determinant;
        let mut basis: Vec<Vec<f64>> = Vec::new();
        for level in levels {
            let mut column = noise.of(level);
            remove(&mut column, &basis);
            let norm = dot(&column, &column).sqrt();
            // Otherwise the temperature differs between the directions only.
            if norm > 1e-6 {
                of_levels -= norm.ln();
                for x in &mut column {
                    *x /= norm;
                }
                basis.push(column);
            }
        }
        remove(&mut rest, &basis);
        let half_freedom = (values.len() - basis.len()) as f64 / 2.0;
        Self { noise, basis, rest, half_freedom, of_levels }
    }

    fn with(&self, regressor: &[f64]) -> Regression {
        let mut x = self.noise.of(regressor);
        remove(&mut x, &self.basis);
        let precision = dot(&x, &x) + CHANGE_SD.powi(-2);
        let change = dot(&x, &self.rest) / precision;
        let square = (dot(&self.rest, &self.rest) - change * change * precision).max(f64::MIN_POSITIVE);
        let evidence = self.of_levels - self.half_freedom * square.ln() - 0.5 * (precision * CHANGE_SD.powi(2)).ln();
        Regression { evidence, change }
    }
}

/// Removes the parts along orthonormal columns.
fn remove(column: &mut [f64], basis: &[Vec<f64>]) {
    for unit in basis {
        let part = dot(column, unit);
        column.iter_mut().zip(unit).for_each(|(x, u)| *x -= part * u);
    }
}
