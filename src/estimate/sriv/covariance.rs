//! Covariance of the estimate with noise on the output and on the inputs.
//!
//! The textbook's σ² (Z'Z)⁻¹ is for noise on the output alone. Here the current is measured too, and its noise passes
//! through the model. To first order the error of the estimate is
//!
//! ```text
//! θ̂ - θ = M⁻¹ Σ_k z_k e_k,   M = Σ z φ',   e = n_y - Σ_s (B_s/A) n_s
//! ```
//!
//! with instrument z and regressor φ, as the equation error, filtered by 1/A, is the output noise `n_y` minus the noise
//! `n_s` of each input s filtered by the model. Let T be the lower triangular matrix of the sampled response of B/A.
//! Then Σ `z_k` (T n)_k = (T' Z)' n, and T' Z is Z filtered backwards in time. So, for white noise of variances `s_y²`
//! and `s_s²`,
//!
//! ```text
//! P = M⁻¹ ( s_y² Z'Z + Σ_s s_s² W_s' W_s ) M⁻ᵀ,   W_s = Z filtered backwards in time by B_s/A
//! ```
//!
//! With a prefilter 1/C other than 1/A (see `refined`) the equation error is (A/C) `n_y` - (B/C) `n_s`. So W is Z
//! filtered by B/C, and Z filtered by A/C replaces Z in Z'Z.
//!
//! The start position and the current's offset are means over n quiet samples, those before the start of the motor.
//! Their errors, of variances `s_y²/n` and `s_s²/n`, are common to all samples and add `s_y²/n` (Σz)(Σz)' and `s_s²/n`
//! (Σw)(Σw)' to the bracket, with the rows w of W. (If the noise is below half a step of the converter, the mean is no
//! better than one sample, so the variance of the rounding error is added to theirs.)

use nalgebra::Matrix3;

use super::{
    Solution,
    filter::{Discrete, Hold, dot},
    problem::{Problem, Signal, Sriv, Workspace},
};
use crate::estimate::{
    load::{Load, STEPS},
    matrix::{sandwich, times},
};

/// Variances of the white noise on the signals of a problem.
#[derive(Debug, Clone, Copy)]
pub struct Noise<'a, const S: usize> {
    /// Variance on the output.
    pub output: f64,
    /// Variance on each input; 0 for inputs that are not measured.
    pub inputs: [f64; S],
    /// For a first input that is a nonlinear function of the measured value: the standard deviation of the noise of
    /// each of its samples, as multiple of the square root of `inputs[0]`. `None` if it is the same for all samples.
    pub scale: Option<&'a [f64]>,
    /// Variances of the offsets that were removed from the first input and from the output; 0 if none was removed.
    pub offsets: [f64; 2],
}

impl<const N: usize, const S: usize, const P: usize> Sriv<N, S, P> {
    /// Covariance of the parameters of `solution`, which must be the last solution computed in `workspace`.
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

/// Standard deviation of the share of the friction that is dry: the root mean square of a share that may be anything
/// from 0 to 1.
pub(crate) const DRY_SHARE: f64 = 0.58;
/// Share of the travel after which the machine has its running speed.
const STARTED_SHARE: f64 = 0.05;

impl Sriv<2, 1, 3> {
    /// Covariance of the errors of (b0, a1, a0) from a random load. A charge of 1 A s in one sample of the input
    /// changes them by M⁻¹ w / T, with the sampling interval T. `None` if the movement does not determine the load.
    pub(crate) fn load_covariance(
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

    /// Errors of (b0, a1, a0) that are equal in every throw: those from dry friction, for one standard deviation of its
    /// share, and those from an error `offset` of the current's offset, with the `scale` of [`Noise`].
    ///
    /// A disturbance d of the acceleration changes the output by n = d/A (d/C with a prefilter 1/C) and the estimate by
    /// M⁻¹ Σ z n. The model has only viscous friction. It stands for a dry friction F with the same torque at the speed
    /// ω, and the two differ by d = -F (1 - y'/ω) at the speed y'. ω is the mean speed of the movement after its start.
    /// A mean over less of the movement would depend on the spring, which brakes one direction and drives the other,
    /// and the resulting interval would not contain the true friction.
    pub(crate) fn systematic_errors(
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

/// A - C for the prefilter 1/C, with the coefficient of the d-th derivative at index d; `None` if A and C are equal.
fn excess<const N: usize, const S: usize, const P: usize>(solution: &Solution<N, S, P>) -> Option<[f64; N]> {
    let a = Sriv::<N, S, P>::denominator(&solution.parameters);
    let excess = std::array::from_fn(|d| a[N - 1 - d] - solution.denominator[N - 1 - d]);
    // Where C is the A of the last iteration, the two differ by less than the tolerance.
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

/// Filters the rows of `z` from the last to the first by B/A; calls `take` with each index and filtered row.
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
