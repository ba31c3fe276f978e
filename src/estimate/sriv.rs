//! Simplified refined instrumental variable estimation of a continuous-time model (SRIVC).
//!
//! The model has order N, S inputs and one denominator,
//!
//! ```text
//! A(p) y = Σ_s B_s(p) u_s + a_N y_eq,   A(p) = p^N + a_1 p^(N-1) + … + a_N,   p = d/dt
//! ```
//!
//! of which equation (12) is the case N = 2, S = 1, B = b0. Every signal is filtered by 1/Â(s), which gives filtered
//! derivatives without differentiating anything:
//!
//! ```text
//! y_f⁽ᴺ⁾ = φ' θ,   φ = [ u_f⁽ᵐ⁾ … u_f for every input, -y_f⁽ᴺ⁻¹⁾ … -y_f', -(y_f - y_eq,f) ],   θ = [B_1 … B_S, a_1 … a_N]
//! θ = (Σ z φ')⁻¹ Σ z y_f⁽ᴺ⁾
//! ```
//!
//! where the instrument z is φ with y replaced by the output x̂ of the auxiliary model, x̂ = (Σ `B̂_s` `u_s` + `â_N` `y_eq`) / Â,
//! which knows nothing of the noise in y. Filter and auxiliary model come from the estimate before; the first one is
//! least squares with the filter 1/(s+λ)^N. (Young 1984; Garnier, Gilson, Young.)
//!
//! A constant load is the input [`Signal::Constant`]; unknown initial conditions are the input [`Signal::Impulse`] with
//! numerator order N-1. One pass over the samples filters, forms the sums and keeps the instruments for the covariance;
//! the buffers for them live in [`Workspace`] and are reused.

use super::{
    filter::{Discrete, Hold},
    small::{Inverse, invert, is_stable, reflected, times},
};

/// One input of the model.
#[derive(Debug, Clone, Copy)]
pub enum Signal<'a> {
    /// Sampled together with the output, and what it does between the samples.
    Sampled(&'a [f64], Hold),
    /// 1 from the first sample on: its coefficient is a constant load.
    Constant,
    /// A unit impulse at the first sample: its coefficients are the initial conditions.
    Impulse,
}

/// What is to be identified.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a, const S: usize> {
    /// Sampling interval \[s\].
    pub interval_s: f64,
    /// The output, at rest before the first sample unless an impulse input says otherwise.
    pub output: &'a [f64],
    /// The inputs, each sampled one as long as the output.
    pub inputs: [Signal<'a>; S],
    /// The output at which the term in `a_N` vanishes, its mean over the interval after each sample; 0 while something
    /// else still holds the machine. `None` when it is 0 throughout.
    pub equilibrium: Option<&'a [f64]>,
}

/// The model's structure and when to stop: order `N`, `S` inputs, `P` parameters in all.
#[derive(Debug, Clone)]
pub struct Sriv<const N: usize, const S: usize, const P: usize> {
    /// Input and derivative of each of the first P-N columns.
    columns: [(usize, usize); P],
    numerator_orders: [usize; S],
    /// Where the iteration starts.
    pub start: Start<N>,
    /// Relative change of the parameters at which the iteration has converged.
    pub tolerance: f64,
    /// Most iterations.
    pub max_iterations: usize,
}

/// Where the iteration starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Start<const N: usize> {
    /// Least squares with the filter 1/(s+λ)^N, λ in rad/s.
    Lag(f64),
    /// Least squares with the filter 1/A(s), A monic with these coefficients \[`a_1` … `a_N`\].
    Denominator([f64; N]),
}

/// The numerators do not make `P` parameters, or one of them is not of lower order than the denominator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("numerator orders must be below {order} and give {numerator_parameters} coefficients in all")]
pub struct InvalidStructure {
    order: usize,
    numerator_parameters: usize,
}

/// Why the iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// The parameters changed by less than the tolerance.
    Converged,
    /// The iteration limit came first.
    IterationLimit,
}

/// Why there is no solution at all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Failure {
    /// A sampled input is not as long as the output.
    #[error("input and output differ in length")]
    UnequalLengths,
    /// Fewer samples than twice the parameters.
    #[error("too few samples for the number of parameters")]
    TooFewSamples,
    /// The normal equations are singular or not finite: the inputs do not excite the model.
    #[error("the normal equations are singular")]
    Singular,
}

/// Why a solution is not to be used although the iteration came to an end.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Unsound {
    /// The normal equations are close to singular.
    #[error("the normal equations are nearly singular (reciprocal condition {rcond:e})")]
    NearlySingular {
        /// Reciprocal condition of the equilibrated normal matrix.
        rcond: f64,
    },
    /// The iteration limit came first.
    #[error("no convergence in {iterations} iterations")]
    NotConverged {
        /// Iterations done.
        iterations: usize,
    },
    /// The model found is unstable; its filter worked only with reflected poles.
    #[error("the model found is unstable")]
    Unstable,
    /// The model's output does not follow the measured one.
    #[error("the model explains {fit} of the output's variance only")]
    PoorFit {
        /// `R²_T`.
        fit: f64,
    },
}

/// Least reciprocal condition of the normal matrix: below it rounding reaches the third digit.
const MIN_RCOND: f64 = 1e-12;

impl<const N: usize, const S: usize, const P: usize> Solution<N, S, P> {
    /// Whether this is an estimate at all. "Converged" alone is not: on data that the model cannot describe, SRIV
    /// converges to nonsense.
    ///
    /// # Errors
    /// The first thing that is wrong with it: not converged, unstable, nearly singular, or a fit `R²_T` below `fit_floor`.
    pub fn sound(&self, fit_floor: f64) -> Result<(), Unsound> {
        if self.rcond < MIN_RCOND {
            return Err(Unsound::NearlySingular { rcond: self.rcond });
        }
        if self.termination != Termination::Converged {
            return Err(Unsound::NotConverged { iterations: self.iterations });
        }
        if self.reflected {
            return Err(Unsound::Unstable);
        }
        // Written so that a NaN is refused.
        if self.fit >= fit_floor { Ok(()) } else { Err(Unsound::PoorFit { fit: self.fit }) }
    }
}

/// The estimate and what it takes to judge it.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution<const N: usize, const S: usize, const P: usize> {
    /// θ: numerator coefficients input by input, highest derivative first, then `a_1` … `a_N`.
    pub parameters: [f64; P],
    /// Iterations after the start.
    pub iterations: usize,
    /// Why it ended.
    pub termination: Termination,
    /// The last filter needed poles reflected into the left half plane.
    pub reflected: bool,
    /// Reciprocal condition of the equilibrated normal matrix of the last iteration.
    pub rcond: f64,
    /// `R²_T` = 1 - var(y - x̂) / var(y).
    pub fit: f64,
    /// (Σ z φ')⁻¹ of the last iteration.
    pub(super) inverse: [[f64; P]; P],
    /// The filter's denominator in the last iteration.
    pub(super) denominator: [f64; N],
}

/// Buffers that live from one problem to the next, so that none is allocated while throws keep their length.
#[derive(Debug, Default)]
pub struct Workspace<const P: usize> {
    pub(super) instruments: Vec<[f64; P]>,
    pub(super) model_output: Vec<f64>,
}

impl<const P: usize> Workspace<P> {
    /// The output x̂ of the auxiliary model in the last iteration, one value a sample.
    #[must_use]
    pub fn model_output(&self) -> &[f64] {
        &self.model_output
    }
}

/// Sums of one pass.
struct Sums<const P: usize> {
    normal: [[f64; P]; P],
    right: [f64; P],
}

impl<const N: usize, const S: usize, const P: usize> Sriv<N, S, P> {
    /// A model whose input s has a numerator of order `numerator_orders[s]`.
    ///
    /// # Errors
    /// When a numerator is not of lower order than N, or Σ (order + 1) + N is not P.
    pub fn new(numerator_orders: [usize; S]) -> Result<Self, InvalidStructure> {
        const { assert!(N > 0 && P > N, "a model has poles and at least one numerator coefficient") };
        let invalid = InvalidStructure { order: N, numerator_parameters: P - N };
        if numerator_orders.iter().any(|order| *order >= N) {
            return Err(invalid);
        }
        let mut columns = [(0, 0); P];
        let mut used = 0;
        for (input, order) in numerator_orders.into_iter().enumerate() {
            for derivative in (0..=order).rev() {
                *columns[..P - N].get_mut(used).ok_or(invalid)? = (input, derivative);
                used += 1;
            }
        }
        if used != P - N {
            return Err(invalid);
        }
        Ok(Self { columns, numerator_orders, start: Start::Lag(5.0), tolerance: 1e-6, max_iterations: 50 })
    }

    /// The denominator coefficients `a_1` … `a_N` in a parameter vector.
    #[must_use]
    pub fn denominator(parameters: &[f64; P]) -> [f64; N] {
        std::array::from_fn(|i| parameters[P - N + i])
    }

    /// The numerator coefficients of one input as a polynomial, coefficient of the d-th derivative at index d.
    pub(super) fn numerator(&self, parameters: &[f64; P], input: usize) -> [f64; N] {
        let mut coefficients = [0.0; N];
        for (column, (of, derivative)) in self.columns[..P - N].iter().enumerate() {
            if *of == input {
                coefficients[*derivative] = parameters[column];
            }
        }
        coefficients
    }

    /// Order of the numerator of one input.
    #[must_use]
    pub fn numerator_order(&self, input: usize) -> usize {
        self.numerator_orders[input]
    }

    /// Identifies the model.
    ///
    /// # Errors
    /// When the problem has too few samples, unequal lengths, or singular normal equations.
    pub fn identify(&self, problem: &Problem<S>, workspace: &mut Workspace<P>) -> Result<Solution<N, S, P>, Failure> {
        let len = problem.output.len();
        let differs = |input: &Signal| matches!(input, Signal::Sampled(u, _) if u.len() != len);
        if problem.inputs.iter().any(differs) || problem.equilibrium.is_some_and(|shift| shift.len() != len) {
            return Err(Failure::UnequalLengths);
        }
        if len < 2 * P {
            return Err(Failure::TooFewSamples);
        }
        workspace.instruments.resize(len, [0.0; P]);
        workspace.model_output.resize(len, 0.0);

        let mut denominator = match self.start {
            Start::Lag(lambda) => lag(lambda),
            Start::Denominator(a) => a,
        };
        let (mut parameters, mut inverse) = solve(&self.pass(problem, &denominator, None, workspace))?;
        let mut iterations = 0;
        let mut was_reflected = false;
        let mut termination = Termination::IterationLimit;
        while iterations < self.max_iterations {
            denominator = Self::denominator(&parameters);
            was_reflected = !is_stable(&denominator);
            if was_reflected {
                denominator = reflected(&denominator);
            }
            let next;
            (next, inverse) = solve(&self.pass(problem, &denominator, Some(&parameters), workspace))?;
            iterations += 1;
            let change = distance(&next, &parameters);
            parameters = next;
            if change <= self.tolerance {
                termination = Termination::Converged;
                break;
            }
        }
        Ok(Solution {
            parameters,
            iterations,
            termination,
            reflected: was_reflected || !is_stable(&Self::denominator(&parameters)),
            rcond: inverse.rcond,
            fit: fit(problem.output, &workspace.model_output),
            inverse: inverse.inverse,
            denominator,
        })
    }

    /// Filters by 1/A and forms the sums; the auxiliary model has `parameters`' numerators, and without them the
    /// instrument is the regressor itself (least squares).
    fn pass(
        &self,
        problem: &Problem<S>,
        a: &[f64; N],
        parameters: Option<&[f64; P]>,
        workspace: &mut Workspace<P>,
    ) -> Sums<P> {
        match (parameters, problem.equilibrium.is_none()) {
            (None, true) => self.filtered_sums::<false, false>(problem, a, &[0.0; P], workspace),
            (None, false) => self.filtered_sums::<false, true>(problem, a, &[0.0; P], workspace),
            (Some(theta), true) => self.filtered_sums::<true, false>(problem, a, theta, workspace),
            (Some(theta), false) => self.filtered_sums::<true, true>(problem, a, theta, workspace),
        }
    }

    fn filtered_sums<const IV: bool, const SHIFTED: bool>(
        &self,
        problem: &Problem<S>,
        a: &[f64; N],
        theta: &[f64; P],
        workspace: &mut Workspace<P>,
    ) -> Sums<P> {
        let linear = Discrete::new(a, problem.interval_s, Hold::First);
        let held = Discrete::new(a, problem.interval_s, Hold::Zero);
        let len = problem.output.len();
        let output = &problem.output[..len];
        let instruments = &mut workspace.instruments[..len];
        let model_output = &mut workspace.model_output[..len];
        let input_filters: [&Discrete<N>; S] = std::array::from_fn(|s| match problem.inputs[s] {
            Signal::Sampled(_, Hold::First) => &linear,
            _ => &held,
        });
        // A signal that is not sampled is an empty slice and a constant.
        let samples: [&[f64]; S] = std::array::from_fn(|s| match problem.inputs[s] {
            Signal::Sampled(u, _) => u,
            Signal::Constant | Signal::Impulse => &[],
        });
        let constants: [f64; S] = problem.inputs.map(|input| f64::from(u8::from(matches!(input, Signal::Constant))));
        let value = |s: usize, k: usize| samples[s].get(k).copied().unwrap_or(constants[s]);
        let mut input_states: [[f64; N]; S] = std::array::from_fn(|s| match problem.inputs[s] {
            Signal::Impulse => std::array::from_fn(|i| f64::from(u8::from(i == N - 1))),
            _ => input_filters[s].rest(value(s, 0)),
        });
        let mut output_state = linear.rest(output[0]);
        let equilibrium = &problem.equilibrium.unwrap_or(output)[..len];
        let mut shift_state = [0.0; N];
        // All filters start at rest, so only impulses show in the first output of the auxiliary model.
        let first: f64 = (0..P - N)
            .filter(|&column| {
                let (input, derivative) = self.columns[column];
                derivative == N - 1 && matches!(problem.inputs[input], Signal::Impulse)
            })
            .map(|column| theta[column])
            .sum();
        let mut model_state = linear.rest(first);
        let mut sums = Sums { normal: [[0.0; P]; P], right: [0.0; P] };
        for k in 0..len {
            let u: [f64; S] = std::array::from_fn(|s| value(s, k));
            let inputs: [[f64; N]; S] = std::array::from_fn(|s| input_filters[s].output(&input_states[s], u[s]));
            let filtered = linear.output(&output_state, output[k]);
            let mut top = output[k];
            for i in 0..N {
                top -= a[N - 1 - i] * filtered[i];
            }
            let mut phi = [0.0; P];
            if P - N == S {
                // Known at compile time: every numerator is a constant.
                for s in 0..S {
                    phi[s] = inputs[s][0];
                }
            } else {
                for (phi, (input, derivative)) in phi.iter_mut().zip(&self.columns[..P - N]) {
                    *phi = inputs[*input][*derivative];
                }
            }
            for i in 0..N {
                phi[P - 1 - i] = -filtered[i];
            }
            if SHIFTED {
                phi[P - 1] += shift_state[0];
            }
            let mut z = phi;
            if IV {
                let mut model = 0.0;
                for (theta, phi) in theta[..P - N].iter().zip(&phi) {
                    model += theta * phi;
                }
                if SHIFTED {
                    model += a[N - 1] * shift_state[0];
                }
                model_output[k] = model;
                let auxiliary = linear.output(&model_state, model);
                model_state = linear.advance(&model_state, model);
                for i in 0..N {
                    z[P - 1 - i] = -auxiliary[i];
                }
                if SHIFTED {
                    z[P - 1] += shift_state[0];
                }
                instruments[k] = z;
            }
            for i in 0..P {
                for j in 0..P {
                    sums.normal[i][j] += z[i] * phi[j];
                }
                sums.right[i] += z[i] * top;
            }
            for s in 0..S {
                input_states[s] = input_filters[s].advance(&input_states[s], u[s]);
            }
            output_state = linear.advance(&output_state, output[k]);
            if SHIFTED {
                shift_state = held.advance(&shift_state, equilibrium[k]);
            }
        }
        sums
    }
}

fn solve<const P: usize>(sums: &Sums<P>) -> Result<([f64; P], Inverse<P>), Failure> {
    let inverse = invert(&sums.normal).ok_or(Failure::Singular)?;
    let parameters = times(&inverse.inverse, &sums.right);
    if parameters.iter().all(|p| p.is_finite()) { Ok((parameters, inverse)) } else { Err(Failure::Singular) }
}

/// ‖next - before‖ / ‖next‖.
fn distance<const P: usize>(next: &[f64; P], before: &[f64; P]) -> f64 {
    let squares = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
    (squares(&mut next.iter().zip(before).map(|(n, b)| n - b)) / squares(&mut next.iter().copied())).sqrt()
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

/// 1 - var(y - x̂) / var(y).
fn fit(output: &[f64], model: &[f64]) -> f64 {
    let count = output.len() as f64;
    let mean = output.iter().sum::<f64>() / count;
    let (mut error, mut error_square, mut square) = (0.0, 0.0, 0.0);
    for (y, x) in output.iter().zip(model) {
        error += y - x;
        error_square += (y - x) * (y - x);
        square += (y - mean) * (y - mean);
    }
    1.0 - (error_square - error * error / count) / square
}
