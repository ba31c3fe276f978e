//! Simplified refined instrumental variable estimation of a continuous-time model (SRIVC).
//!
//! The model has order N, S inputs and one denominator,
//!
//! ```text
//! A(p) y = Σ_s B_s(p) u_s + a_N y_eq,   A(p) = p^N + a_1 p^(N-1) + … + a_N,   p = d/dt
//! ```
//!
//! with inputs `u_s`, output y, and the output `y_eq` at which the spring is unstressed. Equation (12) is the case
//! N = 2, S = 1, B = b0. Every signal is filtered by 1/Â(s), where Â is the present estimate of A; this gives filtered
//! derivatives (index f) without differentiation:
//!
//! ```text
//! y_f⁽ᴺ⁾ = φ' θ
//! φ = [u_f⁽ᵐ⁾ … u_f for every input, -y_f⁽ᴺ⁻¹⁾ … -y_f', -(y_f - y_eq,f)]
//! θ = [B_1 … B_S, a_1 … a_N]
//! θ = (Σ z φ')⁻¹ Σ z y_f⁽ᴺ⁾
//! ```
//!
//! where the instrument z is φ with y replaced by the output x̂ of the auxiliary model, x̂ = (Σ `B̂_s` `u_s` + `â_N`
//! `y_eq`) / Â, which is independent of the noise in y. Filter and auxiliary model come from the previous estimate; the
//! first estimate is least squares with the filter 1/(s+λ)^N. (Young 1984; Garnier, Gilson, Young.)
//!
//! A constant load is an input of ones. One pass over the samples filters them, forms the sums and stores the
//! instruments for the covariance. The buffers of a [`Workspace`] are reused from problem to problem.

pub(super) mod block;
pub(super) mod covariance;
pub(super) mod filter;
pub(super) mod pass;
pub(super) mod polynomial;
pub(super) mod problem;
pub(super) mod refined;
pub(super) mod sums;

use nalgebra::SMatrix;

use self::{
    pass::Auxiliary,
    polynomial::{is_stable, reflected},
    sums::Sums,
};
use super::{lanes::sum, matrix::invert, rejection::Rejection};

pub use problem::{Problem, Sriv, Workspace};

/// The reason why the iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// Further steps would change the parameters by less than the tolerance.
    Converged,
    /// The iteration limit was reached before convergence.
    IterationLimit,
}

/// The reason why a problem has no solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Failure {
    /// An input, or the equilibrium, and the output differ in length.
    #[error("input and output differ in length")]
    UnequalLengths,
    /// Fewer samples than twice the parameters.
    #[error("too few samples for the number of parameters")]
    TooFewSamples,
    /// The normal equations are singular or not finite: the inputs do not excite the model.
    #[error("the normal equations are singular")]
    Singular,
}

/// Least reciprocal condition number of the normal matrix; below it rounding affects the third digit of the parameters.
const MIN_RCOND: f64 = 1e-12;

impl<const N: usize, const S: usize, const P: usize> Solution<N, S, P> {
    /// Checks that the solution is usable. Convergence alone is not enough: on data that the model cannot describe,
    /// SRIV converges to wrong values.
    ///
    /// # Errors
    /// The first problem: nearly singular, not converged, unstable, or a fit `R²_T` below `floor_pct` \[%\].
    pub fn sound(&self, floor_pct: f64) -> Result<(), Rejection> {
        let fit_pct = 100.0 * self.fit;
        if self.rcond < MIN_RCOND {
            Err(Rejection::Singular)
        } else if self.termination != Termination::Converged {
            Err(Rejection::NotConverged { iterations: self.iterations })
        } else if self.reflected {
            Err(Rejection::Unstable { a1: self.parameters[P - N], a0: self.parameters[P - 1] })
        } else if fit_pct >= floor_pct {
            Ok(())
        } else {
            // Also for a fit that is NaN.
            Err(Rejection::PoorFit { fit_pct, floor_pct })
        }
    }
}

/// The parameters of a model with the diagnostics of their estimation.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution<const N: usize, const S: usize, const P: usize> {
    /// θ: numerator coefficients input by input, highest derivative first, then `a_1` … `a_N`.
    pub parameters: [f64; P],
    /// Number of iterations after the first, least-squares pass.
    pub iterations: usize,
    /// Why the iteration ended.
    pub termination: Termination,
    /// Whether the last filter was unstable before the reflection of its poles, or the final model is unstable.
    pub reflected: bool,
    /// Reciprocal condition number of the scaled normal matrix of the last iteration.
    pub rcond: f64,
    /// `R²_T` = 1 - var(y - x̂) / var(y): 1 for a perfect fit.
    pub fit: f64,
    /// (Σ z φ')⁻¹ of the last iteration.
    pub(super) inverse: SMatrix<f64, P, P>,
    /// Denominator of the filter in the last iteration.
    pub(super) denominator: [f64; N],
}

impl<const N: usize, const S: usize, const P: usize> Sriv<N, S, P> {
    /// Identifies the model.
    ///
    /// # Errors
    /// When there are too few samples, the signals differ in length, or the normal equations are singular.
    pub fn identify(&self, problem: &Problem<S>, workspace: &mut Workspace<P>) -> Result<Solution<N, S, P>, Failure> {
        let len = problem.output.len();
        if problem.inputs.iter().map(|(input, _)| *input).chain(problem.equilibrium).any(|signal| signal.len() != len) {
            return Err(Failure::UnequalLengths);
        }
        if len < 2 * P {
            return Err(Failure::TooFewSamples);
        }

        let mut denominator = lag(self.start_per_s);
        let (mut parameters, mut inverse, mut rcond) =
            solve(self.pass(problem, &denominator, None, workspace), &denominator)?;
        let mut iterations = 0;
        let mut last_change = f64::INFINITY;
        let mut was_reflected = false;
        let mut termination = Termination::IterationLimit;
        while iterations < self.max_iterations {
            denominator = Self::denominator(&parameters);
            was_reflected = !is_stable(&denominator);
            if was_reflected {
                denominator = reflected(&denominator);
            }
            let next;
            let auxiliary = Auxiliary { parameters: &parameters, denominator: None };
            (next, inverse, rcond) = solve(self.pass(problem, &denominator, Some(auxiliary), workspace), &denominator)?;
            iterations += 1;
            let change = distance(&next, &parameters);
            parameters = next;
            if remaining(change, last_change) <= self.tolerance {
                termination = Termination::Converged;
                break;
            }
            last_change = change;
        }
        Ok(Solution {
            parameters,
            iterations,
            termination,
            reflected: was_reflected || !is_stable(&Self::denominator(&parameters)),
            rcond,
            fit: fit(problem.output, &workspace.model_output),
            inverse,
            denominator,
        })
    }
}

/// θ, and the inverse of the normal matrix with its reciprocal condition number, from the sums of a pass with the filter
/// 1/C.
pub(super) fn solve<const N: usize, const P: usize>(
    sums: Option<Sums<P>>,
    c: &[f64; N],
) -> Result<([f64; P], SMatrix<f64, P, P>, f64), Failure> {
    let sums = sums.ok_or(Failure::Singular)?;
    let (inverse, rcond) = invert(&sums.normal).ok_or(Failure::Singular)?;
    let mut parameters: [f64; P] = (inverse * sums.right).into();
    for i in 0..N {
        parameters[P - N + i] += c[i];
    }
    if parameters.iter().all(|p| p.is_finite()) { Ok((parameters, inverse, rcond)) } else { Err(Failure::Singular) }
}

/// Relative change of the parameters, ‖next - before‖ / ‖next‖.
pub(super) fn distance<const P: usize>(next: &[f64; P], before: &[f64; P]) -> f64 {
    let squares = |values: [f64; P]| values.iter().map(|v| v * v).sum::<f64>();
    (squares(std::array::from_fn(|i| next[i] - before[i])) / squares(*next)).sqrt()
}

/// Upper bound of the distance to the end of the iteration, from its last two steps. The steps of a fast iteration
/// shrink nearly in a geometric progression, so all later steps together are change² / (last - change). The bound is
/// four times this for a fast iteration, and the last step for a slow one.
fn remaining(change: f64, last: f64) -> f64 {
    const FAST: f64 = 0.1;
    const MARGIN: f64 = 4.0;
    if change < FAST * last && last.is_finite() { MARGIN * change * change / (last - change) } else { change }
}

/// The coefficients of (s + λ)^N without the leading one.
fn lag<const N: usize>(lambda: f64) -> [f64; N] {
    let mut a = [0.0; N];
    for factor in 0..N {
        for i in (0..=factor).rev() {
            a[i] += lambda * if i == 0 { 1.0 } else { a[i - 1] };
        }
    }
    a
}

/// `R²_T` = 1 - var(y - x̂) / var(y). The values of the first sample are subtracted before squaring, so that no square
/// is much larger than a variance.
fn fit(output: &[f64], model: &[f64]) -> f64 {
    let count = output.len() as f64;
    let (first, first_error) = (output[0], output[0] - model[0]);
    let value = sum([output], |[y]| y - first);
    let square = sum([output], |[y]| (y - first).powi(2));
    let error = sum([output, model], |[y, x]| y - x - first_error);
    let error_square = sum([output, model], |[y, x]| (y - x - first_error).powi(2));
    1.0 - (error_square - error * error / count) / (square - value * value / count)
}
