//! Structure of the model, signals of an identification problem, and reusable buffers of the estimation.

use super::{filter::Hold, polynomial::root_radius};

/// The data of an identification.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a, const S: usize> {
    /// Sampling interval \[s\].
    pub interval_s: f64,
    /// The output. The system is at rest before the first sample.
    pub output: &'a [f64],
    /// The inputs, sampled at the times of the output's samples, and their values between the samples.
    pub inputs: [(&'a [f64], Hold); S],
    /// The output `y_eq` at which the term with `a_N` vanishes (the spring is unstressed), as mean over the interval
    /// after each sample; 0 while a brake or dry friction holds the machine. `None` if it is always 0.
    pub equilibrium: Option<&'a [f64]>,
}

/// Structure of the model (order `N`, `S` inputs, `P` parameters), with start and stop conditions of the iteration.
#[derive(Debug, Clone)]
pub struct Sriv<const N: usize, const S: usize, const P: usize> {
    /// Index of the input, and order of its derivative, for each numerator coefficient; the last N entries are not
    /// used.
    pub(crate) columns: [(usize, usize); P],
    /// λ \[rad/s\] of the filter 1/(s+λ)^N of the least-squares estimate that starts the iteration.
    pub start_per_s: f64,
    /// The iteration has converged when the relative distance of the parameters to their final values, estimated from
    /// the last two steps, is at most this.
    pub tolerance: f64,
    /// Largest number of iterations.
    pub max_iterations: usize,
}

/// Buffers of the estimation, reused from problem to problem to avoid allocations.
#[derive(Debug, Default)]
pub struct Workspace<const P: usize> {
    /// Every `stride`-th instrument, which is enough for a covariance: instruments are smooth, and two digits suffice.
    pub(crate) instruments: Vec<[f64; P]>,
    pub(crate) stride: usize,
    /// The output x̂ of the auxiliary model in the last pass, one value for each sample.
    pub(crate) model_output: Vec<f64>,
}

/// Longest time from one stored instrument to the next, in units of 1 / root radius of the filter.
const KEPT_ANGLE: f64 = 0.05;
/// Largest number of samples from one stored instrument to the next.
const MAX_STRIDE: f64 = 16.0;

impl<const P: usize> Workspace<P> {
    /// Sets stride and lengths of the buffers for a pass over `len` samples with the filter 1/C.
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
    /// A model in which input s has a numerator polynomial of order `numerator_orders[s]`. `None` if an order is not
    /// below N, or the number of parameters Σ (order + 1) + N is not P.
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

    /// The denominator coefficients `a_1` … `a_N`: the last N parameters.
    pub fn denominator(parameters: &[f64; P]) -> [f64; N] {
        std::array::from_fn(|i| parameters[P - N + i])
    }

    /// The numerator polynomial of one input, with the coefficient of the d-th derivative at index d.
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
