//! Structure of the model, signals of a problem, and reusable buffers of the estimation.

use super::{filter::Hold, polynomial::root_radius};

/// One input of the model.
#[derive(Debug, Clone, Copy)]
pub enum Signal<'a> {
    /// Sampled together with the output, with its hold between the samples.
    Sampled(&'a [f64], Hold),
    /// 1 from the first sample on: its coefficient is a constant load.
    Constant,
}

impl Signal<'_> {
    pub(super) fn hold(&self) -> Hold {
        match self {
            Self::Sampled(_, hold) => *hold,
            Self::Constant => Hold::Zero,
        }
    }
}

/// The data of an identification.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a, const S: usize> {
    /// Sampling interval \[s\].
    pub interval_s: f64,
    /// The output; at rest before the first sample.
    pub output: &'a [f64],
    /// The inputs; sampled inputs are as long as the output.
    pub inputs: [Signal<'a>; S],
    /// The output at which the term in `a_N` vanishes, as mean over the interval after each sample; 0 while the machine
    /// is held. `None` if it is always 0.
    pub equilibrium: Option<&'a [f64]>,
}

/// Structure of the model (order `N`, `S` inputs, `P` parameters) and stop conditions of the iteration.
#[derive(Debug, Clone)]
pub struct Sriv<const N: usize, const S: usize, const P: usize> {
    /// Input and derivative of each of the first P-N columns.
    pub(super) columns: [(usize, usize); P],
    /// Start of the iteration: least squares with the filter 1/(s+λ)^N, λ in rad/s.
    pub start_per_s: f64,
    /// Relative distance of the parameters to the end of the iteration at which it has converged; estimated from the
    /// last two steps.
    pub tolerance: f64,
    /// Largest number of iterations.
    pub max_iterations: usize,
}

/// Buffers, reused from problem to problem to avoid allocations.
#[derive(Debug, Default)]
pub struct Workspace<const P: usize> {
    /// Every `stride`-th instrument: instruments are smooth, and a covariance needs two digits only.
    pub(super) instruments: Vec<[f64; P]>,
    pub(super) stride: usize,
    /// The output x̂ of the auxiliary model in the last iteration, one value for each sample.
    pub(super) model_output: Vec<f64>,
}

/// Longest distance of stored instruments, in units of 1 / root radius of the filter.
const KEPT_ANGLE: f64 = 0.05;
/// Largest distance of stored instruments \[samples\].
const MAX_STRIDE: f64 = 16.0;

impl<const P: usize> Workspace<P> {
    /// Prepares the buffers for a pass over `len` samples with the filter 1/C.
    pub(super) fn prepare<const N: usize>(&mut self, len: usize, c: &[f64; N], interval_s: f64) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "between 1 and the maximum, also for NaN"
        )]
        let stride = (KEPT_ANGLE / (root_radius(c) * interval_s)).max(1.0).min(MAX_STRIDE.min(len as f64)) as usize;
        self.stride = stride;
        self.instruments.resize((len - stride / 2).div_ceil(stride), [0.0; P]);
        self.model_output.resize(len, 0.0);
    }
}

impl<const N: usize, const S: usize, const P: usize> Sriv<N, S, P> {
    /// A model whose input s has a numerator of order `numerator_orders[s]`; `None` if a numerator is not of lower order
    /// than N, or Σ (order + 1) + N is not P.
    pub fn new(numerator_orders: [usize; S]) -> Option<Self> {
        const { assert!(N > 0 && P > N, "a model has poles and at least one numerator coefficient") };
        let mut columns = [(0, 0); P];
        let mut used = 0;
        for (input, order) in numerator_orders.into_iter().enumerate() {
            for derivative in (0..=order).rev() {
                *columns[..P - N].get_mut(used)? = (input, derivative);
                used += 1;
            }
        }
        let is_valid = used == P - N && numerator_orders.iter().all(|order| *order < N);
        is_valid.then_some(Self { columns, start_per_s: 5.0, tolerance: 1e-6, max_iterations: 50 })
    }

    /// The denominator coefficients `a_1` … `a_N` in a parameter vector.
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
}
