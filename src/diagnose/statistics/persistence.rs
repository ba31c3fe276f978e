//! Serial correlation of the throws of an incomplete baseline, with its uncertainty.
//!
//! If a machine changes slowly, a dozen of its throws lie close together: their variance is small. Their lag-1
//! correlation is small too, as both are taken around the mean of these throws. Two separate estimates would thus be
//! far too certain. The likelihood of the throws for every possible lag-1 correlation phi does not have this fault. Its
//! model of the natural scatter is a first-order autoregression with unknown mean and unknown variance v, to which the
//! errors of the estimates are added. A Kalman filter gives the sum of squares Q around the best mean, in units of v.
//! The mean and v are integrated out, v with an inverse chi-square prior around the typical variance v0 with n0 degrees
//! of freedom. With m the number of throws less one, and G the Gamma function:
//!
//! ```text
//! ln L = -1/2 ln det - 1/2 ln info + n0/2 ln(n0 v0) + ln G((m + n0)/2) - ln G(n0/2) - (m + n0)/2 ln(Q + n0 v0)
//! ```
//!
//! where det is the determinant of the covariance of the throws, and info the information about their mean. Most
//! machines have a typical variance (n0 is large) and a typical phi. A few machines have neither. The throws show which
//! of the two kinds a machine is.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use statrs::function::gamma::ln_gamma;

use super::{
    autoregression::{Autoregression, ln_sum},
    regression::Whitened,
    to_f32,
};

/// Grid of phi, from -0.3 to 0.97: number of nodes, atanh phi of the first node, distance of the nodes in atanh phi.
const NODES: (usize, f64, f64) = (9, -0.3, 0.3);
/// atanh phi of the typical phi, 0.35.
const USUAL_PHI: f64 = 0.365;

/// Prior of a kind of machines: the typical ones, or the others.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Kind {
    /// Logarithm of the prior odds of the kind.
    pub(super) ln_odds: f64,
    /// Weight n0 of the typical variance, in independent throws.
    pub(super) worth: f64,
    /// Standard deviation of atanh phi.
    pub(super) phi_sd: f64,
}

/// A possible lag-1 correlation of a coefficient, at a node of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Possible {
    /// Its probability.
    #[serde(rename = "w")]
    pub(crate) weight: f32,
    /// Variance of the natural scatter of one throw.
    #[serde(rename = "v")]
    pub(crate) variance: f32,
    /// Degrees of freedom of this variance.
    #[serde(rename = "f")]
    pub(crate) freedom: f32,
}

/// The lag-1 correlation of a node.
pub(super) fn phi_of(node: usize) -> f64 {
    z_of(node).tanh()
}

/// atanh phi of a node.
fn z_of(node: usize) -> f64 {
    NODES.1 + NODES.2 * node as f64
}

/// The possible lag-1 correlations of each coefficient; the probabilities of a coefficient sum to 1/3. `natural`,
/// `sensor` and `typical` are variances: of the natural scatter, of the errors of the estimates, and of the scatter of
/// typical machines. `worth`: degrees of freedom of one throw.
pub(crate) fn possible(
    residuals: &[Vector3<f64>],
    [natural, sensor, typical]: [Vector3<f64>; 3],
    worth: f64,
    kinds: [Kind; 2],
) -> [[Possible; NODES.0]; 3] {
    let own = residuals.len() as f64 - 1.0;
    let mean_only = [vec![1.0; residuals.len()]];
    // Sum of squares around the best mean, and -1/2 ln det - 1/2 ln info.
    let whitened: [[(f64, f64); NODES.0]; 3] = std::array::from_fn(|i| {
        let series: Vec<f64> = residuals.iter().map(|residual| residual[i]).collect();
        // Errors of the estimates relative to the natural scatter, which is 0 for b0 in a baseline of ratios.
        let error = (sensor[i] / natural[i].max(f64::MIN_POSITIVE)).min(LARGEST_ERROR);
        std::array::from_fn(|at| {
            let noise = Autoregression { phi: phi_of(at), natural: 1.0, error };
            let whitened = Whitened::new(&noise, &series, &mean_only);
            (whitened.squares(), whitened.of_levels)
        })
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
                let (squares, of_mean) = whitened[i][at];
                let squares = squares + kind.worth * typical[i];
                *evidence =
                    of_prior(typical[i]) - 0.5 * ((z_of(at) - USUAL_PHI) / kind.phi_sd).powi(2) - kind.phi_sd.ln()
                        + of_mean
                        - 0.5 * (own + kind.worth) * squares.ln();
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
        Possible { weight: to_f32(weight) / 3.0, variance: to_f32(variance), freedom: to_f32(freedom) }
    };
    std::array::from_fn(|i| std::array::from_fn(|at| mean(i, at)))
}

/// Largest ratio of the errors' variance to the natural variance.
const LARGEST_ERROR: f64 = 50.0;
