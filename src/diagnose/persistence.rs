//! How strongly consecutive throws may depend on each other, from the few throws of a baseline that still fills.
//!
//! A dozen throws of a machine that wanders lie close together: their variance is small, and their lag-1 correlation too,
//! as both are taken around their own mean. So an estimate of each with an error of its own is far too certain. The
//! likelihood of the throws for every lag-1 correlation phi has neither problem: the natural scatter is an autoregression
//! of first order with an unknown mean and an unknown variance v, beside the errors of the estimates, and a Kalman filter
//! gives the sum of squares Q around the best mean, in units of v. The mean and v are integrated out, v with an inverse
//! chi-square prior around the typical variance:
//!
//! ```text
//! ln L = -1/2 ln det - 1/2 ln info + n0/2 ln(n0 v0) + ln G((m + n0)/2) - ln G(n0/2) - (m + n0)/2 ln(Q + n0 v0)
//! ```
//!
//! Most machines have a typical variance (n0 large) and a typical phi. A few have neither, and the throws show which of
//! the two kinds a machine is.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use statrs::function::gamma::ln_gamma;

use super::autoregression::{Autoregression, dot, ln_sum};

/// Inverse hyperbolic tangent of the first phi, and their distance: phi from -0.3 to 0.97.
const NODES: (usize, f64, f64) = (9, -0.3, 0.3);
/// Inverse hyperbolic tangent of the typical phi of 0.35.
const USUAL_PHI: f64 = 0.365;

/// Prior for a kind of machine: typical, or unlike most.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kind {
    /// Logarithm of the prior odds.
    pub(super) ln_odds: f64,
    /// Weight of the typical variance in independent throws.
    pub(super) worth: f64,
    /// Standard deviation of the inverse hyperbolic tangent of phi.
    pub(super) phi_sd: f64,
}

/// A possible lag-1 correlation of one coefficient, at its node.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Possible {
    #[serde(rename = "w")]
    pub(super) weight: f32,
    /// Variance of the natural scatter of one throw, with its degrees of freedom.
    #[serde(rename = "v")]
    pub(super) variance: f32,
    #[serde(rename = "f")]
    pub(super) freedom: f32,
}

/// The lag-1 correlation of a node.
pub(super) fn phi_of(node: usize) -> f64 {
    z_of(node).tanh()
}

/// Its inverse hyperbolic tangent.
fn z_of(node: usize) -> f64 {
    NODES.1 + NODES.2 * node as f64
}

/// The possible lag-1 correlations of each coefficient, each with a third of the probability. `natural` and `sensor` are the
/// variances of the natural scatter and of the estimates; `worth` the degrees of freedom of a throw.
pub(super) fn possible(
    residuals: &[Vector3<f64>],
    [natural, sensor, typical]: [Vector3<f64>; 3],
    worth: f64,
    kinds: [Kind; 2],
) -> [[Possible; NODES.0]; 3] {
    let own = residuals.len() as f64 - 1.0;
    let whitened: [[Whitened; NODES.0]; 3] = std::array::from_fn(|i| {
        let series: Vec<f64> = residuals.iter().map(|residual| residual[i]).collect();
        // Errors of the estimates relative to the natural scatter; those of ratios have a coefficient without scatter.
        let error = (sensor[i] / natural[i].max(f64::MIN_POSITIVE)).min(LARGEST_ERROR);
        std::array::from_fn(|at| Whitened::of(&series, &Autoregression { phi: phi_of(at), natural: 1.0, error }))
    });
    let mut found = [[[(0.0, 0.0); NODES.0]; 3]; 2];
    let mut totals = [0.0; 2];
    for (kind, (found, total)) in kinds.iter().zip(found.iter_mut().zip(&mut totals)) {
        *total = kind.ln_odds;
        let of_prior = |v0: f64| {
            0.5 * kind.worth * (kind.worth * v0).ln() - ln_gamma(0.5 * kind.worth) + ln_gamma(0.5 * (own + kind.worth))
        };
        for (i, nodes) in found.iter_mut().enumerate() {
            for (at, (evidence, variance)) in nodes.iter_mut().enumerate() {
                let Whitened { squares, ln_determinant, information } = whitened[i][at];
                let squares = squares + kind.worth * typical[i];
                *evidence = of_prior(typical[i])
                    - 0.5 * ((z_of(at) - USUAL_PHI) / kind.phi_sd).powi(2)
                    - kind.phi_sd.ln()
                    - 0.5 * (ln_determinant + information.ln() + (own + kind.worth) * squares.ln());
                *variance = squares / (own + kind.worth);
            }
            let of_nodes = ln_sum(nodes.iter().map(|(evidence, _)| *evidence));
            for (evidence, _) in nodes {
                *evidence = (*evidence - of_nodes).exp();
            }
            *total += of_nodes;
        }
    }
    let of_kinds = ln_sum(totals.into_iter());
    let share = totals.map(|total| (total - of_kinds).exp());
    let mean = |i: usize, at: usize| {
        let weight: f64 = (0..2).map(|kind| share[kind] * found[kind][i][at].0).sum();
        let mean = |of: &dyn Fn(usize) -> f64| -> f64 {
            let sum: f64 = (0..2).map(|kind| share[kind] * found[kind][i][at].0 * of(kind)).sum();
            sum / weight.max(f64::MIN_POSITIVE)
        };
        let variance = mean(&|kind| found[kind][i][at].1);
        let freedom = mean(&|kind| own * worth + kinds[kind].worth);
        #[expect(clippy::cast_possible_truncation, reason = "1e-7 of a weight or a variance has no effect")]
        Possible { weight: weight as f32 / 3.0, variance: variance as f32, freedom: freedom as f32 }
    };
    std::array::from_fn(|i| std::array::from_fn(|at| mean(i, at)))
}

/// Largest variance of the errors of the estimates, in natural variances.
const LARGEST_ERROR: f64 = 50.0;

/// A series with independent values of equal variance.
#[derive(Clone, Copy)]
struct Whitened {
    /// Sum of squares around the best mean.
    squares: f64,
    ln_determinant: f64,
    /// Information about the mean.
    information: f64,
}

impl Whitened {
    /// The filter runs on the series and on a constant, so the mean is that of least squares.
    fn of(series: &[f64], noise: &Autoregression) -> Self {
        let noise = noise.whitening(series.len());
        let (values, ones) = (noise.of(series), noise.of(&vec![1.0; series.len()]));
        let information = dot(&ones, &ones);
        let squares = (dot(&values, &values) - dot(&values, &ones).powi(2) / information).max(0.0);
        Self { squares, ln_determinant: noise.ln_determinant, information }
    }
}
