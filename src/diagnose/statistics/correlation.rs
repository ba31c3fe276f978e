//! The paper's cross-correlation of the three inertia estimates.
//!
//! Every coefficient gives an estimate of the inertia, nominal over estimate: `J_b0` = `b0_ref/b0`, `J_a1` =
//! `a1_ref/a1`, `J_a0` = `a0_ref/a0`. When inertia changes, all three change together; the rule needs a correlation of
//! at least 0.8 for each pair. The correlation is over the baseline and the recent window with equal weights, so that a
//! drift has the same effect as between the paper's tests.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// The paper's cross-correlation of the three inertia estimates, pairwise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// Between J from b0 and J from a1.
    pub b0_a1: f64,
    /// Between J from b0 and J from a0.
    pub b0_a0: f64,
    /// Between J from a1 and J from a0.
    pub a1_a0: f64,
}

impl Correlation {
    /// The correlation over two halves of throws, one around the baseline and one around `mean` (ln b0, ln a1, ln a0,
    /// relative to the baseline), both with the covariance `of_one_throw`. An inertia estimate is J = exp(-residual).
    /// For small residuals its covariance is that of the logarithms; the shift between the halves is computed in J
    /// itself.
    pub(crate) fn of(of_one_throw: &Matrix3<f64>, mean: &Vector3<f64>) -> Self {
        let shift = mean.map(|log| (-log).exp() - 1.0);
        let level = mean.map(|log| (-log).exp());
        let scatter = of_one_throw.component_mul(&(level * level.transpose()));
        let pooled = 0.5 * (of_one_throw + scatter) + 0.25 * shift * shift.transpose();
        let between = |i: usize, j: usize| {
            let scale = (pooled[(i, i)] * pooled[(j, j)]).sqrt();
            if scale > 0.0 { (pooled[(i, j)] / scale).clamp(-1.0, 1.0) } else { 0.0 }
        };
        Self { b0_a1: between(0, 1), b0_a0: between(0, 2), a1_a0: between(1, 2) }
    }

    /// Whether all three pairs reach `limit`: the paper's criterion for inertia.
    pub fn indicates_inertia(&self, limit: f64) -> bool {
        [self.b0_a1, self.b0_a0, self.a1_a0].into_iter().all(|pair| pair >= limit)
    }
}
