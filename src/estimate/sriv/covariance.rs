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

use nalgebra::{SMatrix, SVector};

use super::{
    Solution,
    filter::{Discrete, Hold},
    problem::{Problem, Sriv, Workspace},
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
        let (mut middle, mut sum) = (SMatrix::<f64, P, P>::zeros(), SVector::zeros());
        let mut take = |v: SVector<f64, P>| {
            middle += v * (represented * noise.output) * v.transpose();
            sum += v * represented;
        };
        match excess(solution).zip(Discrete::new(&solution.denominator, represented * problem.interval_s)) {
            None => z.iter().for_each(|z| take((*z).into())),
            Some((excess, filter)) => {
                backwards(z, &filter, Hold::First, &excess, |k, v| take(SVector::from(z[k]) + v));
            }
        }
        middle += sum * noise.offsets[1] * sum.transpose();
        for (s, variance) in noise.inputs.into_iter().enumerate().filter(|(_, variance)| *variance > 0.0) {
            let (_, hold) = problem.inputs[s];
            let Some(filter) = Discrete::new(&solution.denominator, represented * problem.interval_s) else { continue };
            let numerator = self.numerator(&solution.parameters, s);
            let scale = noise.scale.filter(|_| s == 0);
            let mut sum = SVector::<f64, P>::zeros();
            backwards(z, &filter, hold, &numerator, |k, w| {
                let [mean, square] = scale.map_or([1.0; 2], |scale| moments(&scale[k * stride..], stride));
                middle += w * (variance * represented * square) * w.transpose();
                sum += w * (represented * mean);
            });
            if s == 0 {
                // The error of an offset is common to all samples of the trace.
                middle += sum * noise.offsets[0] * sum.transpose();
            }
        }
        middle.fill_lower_triangle_with_upper_triangle();
        let covariance = solution.inverse * middle * solution.inverse.transpose();
        // An array of columns, as rows.
        covariance.transpose().into()
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

/// Filters the rows of `z` from the last to the first by B/A; calls `take` with each index and filtered row.
pub(crate) fn backwards<const N: usize, const P: usize>(
    z: &[[f64; P]],
    filter: &Discrete<N>,
    hold: Hold,
    numerator: &[f64; N],
    mut take: impl FnMut(usize, SVector<f64, P>),
) {
    let (row, through) = filter.readout(hold).combined(numerator);
    let mut states = [[0.0; N]; P];
    for (k, z) in z.iter().enumerate().rev() {
        let mut w = SVector::zeros();
        for j in 0..P {
            w[j] = through * z[j];
            for i in 0..N {
                w[j] += row[i] * states[j][i];
            }
            filter.advance(&mut states[j], z[j]);
        }
        take(k, w);
    }
}
