//! Covariance of the estimate with noise on the output and on the inputs.
//!
//! The textbook σ² (Z'Z)⁻¹ includes only noise on the output. Here the current is measured too, and its noise passes
//! through the model. To first order the error of the estimate is
//!
//! ```text
//! θ̂ - θ = M⁻¹ Σ_k z_k e_k,   M = Σ z φ',   e = n_y - Σ_s (B_s/A) n_s
//! ```
//!
//! as the equation error, filtered by 1/A, is the output noise `n_y` minus the input noise `n_s` filtered by the model.
//! With T the lower triangular matrix of the sampled response B/A, Σ `z_k` (T n)_k = (T' Z)' n, and T' Z is Z filtered
//! backwards in time. So, for white noise of variances `s_y²` and `s_s²`,
//!
//! ```text
//! P = M⁻¹ ( s_y² Z'Z + Σ_s s_s² W_s' W_s ) M⁻ᵀ,   W_s = Z filtered backwards in time by B_s/A
//! ```
//!
//! With another prefilter 1/C than 1/A (see `refined`) the equation error is (A/C) `n_y` - (B/C) `n_s`, so W is Z
//! filtered by B/C, and V = Z filtered by A/C replaces Z in Z'Z.
//!
//! The start position and the current's offset are means over n quiet samples: their errors, of variances `s_y²/n` and
//! `s_s²/n`, are common to all samples and add `s_y²/n` (Σz)(Σz)' and `s_s²/n` (Σw)(Σw)' to the bracket. (With noise
//! below half a step of the converter averaging does not help, and the rounding error of one sample replaces them.)

use nalgebra::Matrix3;

use super::{
    filter::{Discrete, Hold, dot},
    load::{Load, STEPS},
    problem::{Problem, Signal, Sriv, Workspace},
    small::{sandwich, times},
    sriv::Solution,
};

/// White noise on the samples of a problem.
#[derive(Debug, Clone, Copy)]
pub struct Noise<'a, const S: usize> {
    /// Variance on the output.
    pub output: f64,
    /// Variance on each input; 0 for inputs without measurement.
    pub inputs: [f64; S],
    /// Standard deviation of the noise of each sample of the first input, as multiple of the root of `inputs[0]`; for
    /// an input that is a nonlinear function of the measured value.
    pub scale: Option<&'a [f64]>,
    /// Variances of the offsets removed from the first input and from the output; 0 without removal.
    pub offsets: [f64; 2],
}

impl<const N: usize, const S: usize, const P: usize> Sriv<N, S, P> {
    /// Covariance of the parameters of `solution`, which must be the last solution that used `workspace`.
    pub fn covariance(
        &self,
        problem: &Problem<S>,
        solution: &Solution<N, S, P>,
        noise: &Noise<S>,
        workspace: &Workspace<P>,
    ) -> [[f64; P]; P] {
        let (z, stride) = (&workspace.instruments, workspace.stride);
        // Each stored instrument represents `stride` instruments.
        let represented = stride as f64;
        let mut middle = [[0.0; P]; P];
        let mut sum = [0.0; P];
        let mut take = |v: &[f64; P]| {
            add_square(&mut middle, v, represented * noise.output);
            add(&mut sum, v, represented);
        };
        match excess(solution).zip(Discrete::new(&solution.denominator, represented * problem.interval_s)) {
            None => z.iter().for_each(take),
            Some((excess, filter)) => {
                backwards(z, &filter, Hold::First, &excess, |k, v| take(&std::array::from_fn(|i| z[k][i] + v[i])));
            }
        }
        add_square(&mut middle, &sum, noise.offsets[1]);
        for (s, variance) in noise.inputs.into_iter().enumerate().filter(|(_, variance)| *variance > 0.0) {
            let Signal::Sampled(_, hold) = problem.inputs[s] else { continue };
            let Some(filter) = Discrete::new(&solution.denominator, represented * problem.interval_s) else { continue };
            let numerator = self.numerator(&solution.parameters, s);
            let scale = noise.scale.filter(|_| s == 0);
            let mut sum = [0.0; P];
            backwards(z, &filter, hold, &numerator, |k, w| {
                let [mean, square] = scale.map_or([1.0; 2], |scale| moments(&scale[k * stride..], stride));
                add_square(&mut middle, w, variance * represented * square);
                add(&mut sum, w, represented * mean);
            });
            if s == 0 {
                // The error of an offset is common to all samples of the trace.
                add_square(&mut middle, &sum, noise.offsets[0]);
            }
        }
        for i in 0..P {
            for j in 0..i {
                middle[i][j] = middle[j][i];
            }
        }
        sandwich(&solution.inverse, &middle)
    }
}

/// Dry share of the friction: root mean square of a share that is uniform between 0 and 1.
pub(super) const DRY_SHARE: f64 = 0.58;
/// Share of the travel after which the machine has its running speed.
const STARTED_SHARE: f64 = 0.05;

impl Sriv<2, 1, 3> {
    /// Covariance of the errors of (b0, a1, a0) by a random load. A charge in a sample of the input has the effect M⁻¹ w / T,
    /// with the interval T.
    pub(super) fn load_covariance(
        &self,
        problem: &Problem<1>,
        solution: &Solution<2, 1, 3>,
        load: &Load,
        workspace: &Workspace<3>,
    ) -> Option<Matrix3<f64>> {
        let (z, stride) = (&workspace.instruments, workspace.stride);
        let filter = Discrete::new(&solution.denominator, stride as f64 * problem.interval_s)?;
        let numerator = self.numerator(&solution.parameters, 0);
        let mut effects = [[0.0; 3]; STEPS];
        backwards(z, &filter, Hold::First, &numerator, |k, w| {
            add(&mut effects[load.step_of(k * stride)], w, stride as f64 / problem.interval_s);
        });
        load.covariance(|step| times(&solution.inverse, &effects[step]).into())
    }

    /// Errors of (b0, a1, a0) that are equal in every throw: from dry friction, for one standard deviation of its share, and
    /// from an error of the current's offset, with the scale of [`Noise`].
    ///
    /// A disturbance d of the acceleration disturbs the output by n = d/A and the estimate by M⁻¹ Σ z n; with a prefilter
    /// 1/C the division is by C. Dry friction counts as viscous friction with the same torque at ω, the mean speed of the
    /// movement after its start; a dry load F differs from it by d = -F (1 - y'/ω). A mean over less of the movement would
    /// depend on the spring, which slows one direction down and speeds up the other, and the interval would not contain the
    /// friction.
    pub(super) fn systematic_errors(
        problem: &Problem<1>,
        solution: &Solution<2, 1, 3>,
        foot: usize,
        (offset, scale): (f64, Option<&[f64]>),
        workspace: &Workspace<3>,
    ) -> [[f64; 3]; 2] {
        let (z, stride, model) = (&workspace.instruments, workspace.stride, &workspace.model_output);
        let [b0, a1, _] = solution.parameters;
        let last = model.len() - 1;
        let moving = model.iter().position(|y| *y > STARTED_SHARE * model[last]).unwrap_or_default().min(last);
        let per_sample = (model[last] - model[moving]) / (last - moving).max(1) as f64;
        let load = DRY_SHARE * a1 * per_sample / problem.interval_s;
        let dry = |k: usize| if k >= foot { load * ((model[k + 1] - model[k]) / per_sample - 1.0) } else { 0.0 };
        let Some(filter) = Discrete::<2>::new(&solution.denominator, problem.interval_s) else { return [[0.0; 3]; 2] };
        let row = filter.readout(Hold::Zero).state[0];
        let (mut states, mut sums) = ([[0.0; 2]; 2], [[0.0; 3]; 2]);
        let mut kept = z.iter();
        let mut until_kept = stride / 2;
        for k in 0..last {
            if until_kept == 0 {
                until_kept = stride;
                if let Some(z) = kept.next() {
                    for (sum, state) in sums.iter_mut().zip(&states) {
                        add(sum, z, stride as f64 * dot(&row, state));
                    }
                }
            }
            until_kept -= 1;
            filter.advance(&mut states[0], dry(k));
            filter.advance(&mut states[1], b0 * offset * scale.map_or(1.0, |scale| scale[k]));
        }
        sums.map(|sum| times(&solution.inverse, &sum))
    }
}

/// A - C for the prefilter 1/C, the coefficient of the d-th derivative at index d; `None` if they are equal.
fn excess<const N: usize, const S: usize, const P: usize>(solution: &Solution<N, S, P>) -> Option<[f64; N]> {
    let a = Sriv::<N, S, P>::denominator(&solution.parameters);
    let excess = std::array::from_fn(|d| a[N - 1 - d] - solution.denominator[N - 1 - d]);
    // After convergence they differ by less than the tolerance.
    (0..N).any(|d| excess[d].abs() > 1e-2 * a[N - 1 - d].abs()).then_some(excess)
}

/// Mean and mean square of the first `count` values.
fn moments(values: &[f64], count: usize) -> [f64; 2] {
    let values = &values[..count.min(values.len())];
    let share = 1.0 / values.len() as f64;
    [values.iter().sum::<f64>() * share, values.iter().map(|v| v * v).sum::<f64>() * share]
}

/// Adds `weight` v v' to the upper triangle.
#[inline]
fn add_square<const P: usize>(sum: &mut [[f64; P]; P], v: &[f64; P], weight: f64) {
    for i in 0..P {
        for j in i..P {
            sum[i][j] += weight * v[i] * v[j];
        }
    }
}

#[inline]
fn add<const P: usize>(sum: &mut [f64; P], v: &[f64; P], weight: f64) {
    for (sum, v) in sum.iter_mut().zip(v) {
        *sum += weight * v;
    }
}

/// Filters the rows of `z` from the last to the first by B/A; calls `take` with the index and each result.
fn backwards<const N: usize, const P: usize>(
    z: &[[f64; P]],
    filter: &Discrete<N>,
    hold: Hold,
    numerator: &[f64; N],
    mut take: impl FnMut(usize, &[f64; P]),
) {
    let (row, through) = filter.readout(hold).combined(numerator);
    let mut states = [[0.0; N]; P];
    for (k, z) in z.iter().enumerate().rev() {
        let mut w = [0.0; P];
        for j in 0..P {
            w[j] = through * z[j];
            for i in 0..N {
                w[j] += row[i] * states[j][i];
            }
            filter.advance(&mut states[j], z[j]);
        }
        take(k, &w);
    }
}
