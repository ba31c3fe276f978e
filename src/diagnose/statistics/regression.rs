//! Regression of a series of throws whose scatter is an autoregression of unknown variance and lag-1 correlation.
//!
//! A series has levels (its mean values, such as one for each direction) and a regressor, such as the temperature. The
//! evidence for a regressor is integrated over its coefficient, the levels, the variance and the lag-1 correlation phi.
//! Every phi from 0 to 1 has the same probability, so that a machine with slow random changes is not taken for one that
//! follows the regressor. Levels and variance have flat priors (Zellner, An Introduction to Bayesian Inference in
//! Econometrics, 1971, 3.1); the coefficient has a normal prior.

use super::autoregression::{Autoregression, Whitening, dot, ln_sum};

/// Number of nodes for the integral over phi.
const PHIS: u32 = 16;
/// Prior standard deviation of the coefficient, in standard deviations of one throw.
const CHANGE_SD: f64 = 4.0;

/// A series with its levels removed, for each phi.
pub(crate) struct Series(Vec<Whitened>);

/// A series with its levels removed, whitened for a given phi.
pub(super) struct Whitened {
    noise: Whitening,
    /// Orthonormal columns that span the levels.
    basis: Vec<Vec<f64>>,
    /// The whitened series without levels.
    rest: Vec<f64>,
    /// Half of the degrees of freedom of `rest`.
    half_freedom: f64,
    /// Logarithm of the evidence, without the part of `rest`.
    pub(super) of_levels: f64,
}

/// Evidence for a regressor.
pub(crate) struct Regression {
    /// Logarithm of the evidence.
    pub(crate) evidence: f64,
    /// Coefficient of the regressor.
    pub(crate) change: f64,
}

impl Series {
    /// A series with its levels, one column each. `error_part`: part of the estimates' errors in the variance.
    pub(crate) fn new(values: &[f64], levels: &[Vec<f64>], error_part: f64) -> Self {
        let phis = (0..PHIS).map(|step| (f64::from(step) + 0.5) / f64::from(PHIS));
        let noise = |phi: f64| Autoregression { phi, natural: 1.0 - error_part, error: error_part };
        Self(phis.map(|phi| Whitened::new(&noise(phi), values, levels)).collect())
    }

    /// [`Self::new`] without a lag-1 correlation. The correlation lets chance look like a regressor, so the Bayes
    /// factor of a regressor is largest without one: if it is small here, it is small for [`Self::new`], which takes 16
    /// times as long.
    pub(crate) fn uncorrelated(values: &[f64], levels: &[Vec<f64>], error_part: f64) -> Self {
        let noise = Autoregression { phi: 0.0, natural: 1.0 - error_part, error: error_part };
        Self(vec![Whitened::new(&noise, values, levels)])
    }

    /// Logarithm of the Bayes factor of a regressor against levels alone.
    pub(crate) fn bayes_factor(&self, regressor: &[f64]) -> f64 {
        self.with(regressor).evidence - self.evidence()
    }

    /// Logarithm of the evidence for levels alone.
    pub(crate) fn evidence(&self) -> f64 {
        let of = |part: &Whitened| part.of_levels - part.half_freedom * part.squares().ln();
        ln_sum(self.0.iter().map(of))
    }

    /// The regression on levels and a regressor.
    pub(crate) fn with(&self, regressor: &[f64]) -> Regression {
        let parts: Vec<Regression> = self.0.iter().map(|part| part.with(regressor)).collect();
        let evidence = ln_sum(parts.iter().map(|part| part.evidence));
        let change = parts.iter().map(|part| (part.evidence - evidence).exp() * part.change).sum();
        Regression { evidence, change }
    }
}

impl Whitened {
    pub(super) fn new(noise: &Autoregression, values: &[f64], levels: &[Vec<f64>]) -> Self {
        let noise = noise.whitening(values.len());
        let mut rest = noise.of(values);
        let mut of_levels = -0.5 * noise.ln_determinant;
        let mut basis: Vec<Vec<f64>> = Vec::new();
        for level in levels {
            let mut column = noise.of(level);
            remove(&mut column, &basis);
            let norm = dot(&column, &column).sqrt();
            // A smaller column depends on the others: then the temperature differs between the directions only.
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

    /// Sum of squares around the best levels.
    pub(super) fn squares(&self) -> f64 {
        dot(&self.rest, &self.rest)
    }

    fn with(&self, regressor: &[f64]) -> Regression {
        let mut x = self.noise.of(regressor);
        remove(&mut x, &self.basis);
        let precision = dot(&x, &x) + CHANGE_SD.powi(-2);
        let change = dot(&x, &self.rest) / precision;
        let square = (self.squares() - change * change * precision).max(f64::MIN_POSITIVE);
        let evidence = self.of_levels - self.half_freedom * square.ln() - 0.5 * (precision * CHANGE_SD.powi(2)).ln();
        Regression { evidence, change }
    }
}

/// Removes the parts along the orthonormal columns of `basis`.
fn remove(column: &mut [f64], basis: &[Vec<f64>]) {
    for unit in basis {
        let part = dot(column, unit);
        column.iter_mut().zip(unit).for_each(|(x, u)| *x -= part * u);
    }
}
