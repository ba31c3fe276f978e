//! Refined estimation, with a prefilter for the noise.
//!
//! With white noise `n_y` of variance `s_y²` on the output and `n_u` of variance `s_u²` on the input, the error of the
//! equation A y = b0 u is A `n_y` - b0 `n_u`. It has the spectrum `s_y²` |C|², with the stable spectral factor
//! C = s² + `c_1` s + `c_0`:
//!
//! ```text
//! |C|² = |A|² + r b0²,   r = s_u² / s_y²,   c_0 = √(a_0² + r b0²),   c_1 = √(a_1² - 2 a_0 + 2 c_0)
//! ```
//!
//! Filtered by 1/C the error is white. So SRIV with this filter instead of 1/A is nearly the maximum-likelihood
//! estimate, and its scatter is half as large. But the faster filter passes more noise of the current into the
//! instrument z, which uses the same current as the regressor. The mean β of the sum Σ z ε, with the equation error ε,
//! is then not 0. It is known, as `s_u²` is known,
//!
//! ```text
//! β = -s_u² Σ_k Σ_{j ≤ k} g_z(j) g_ε(j)
//! ```
//!
//! with the responses `g_z` of the instrument and `g_ε` = b0 `g_1` of the error to one sample of the current, `g_1`
//! that of the filter 1/C. M⁻¹ β is subtracted from the estimate, M = Σ z φ'. (Young 2008; Garnier, Gilson, Young.)

use nalgebra::Vector3;

use super::{
    Failure, Solution, Termination,
    covariance::Noise,
    distance,
    filter::{Discrete, Hold},
    pass::Auxiliary,
    polynomial::is_stable,
    problem::{Problem, Sriv, Workspace},
    solve,
};

impl Sriv<2, 1, 3> {
    /// Refines `solution`, which must be stable, for this noise of output and input. Its `fit` stays that of the model
    /// before the refinement. `None` if the input is without noise, as then the prefilter of SRIV is optimal, or the
    /// output is without noise.
    ///
    /// # Errors
    /// When the normal equations become singular or the model unstable.
    pub fn refine(
        &self,
        problem: &Problem<1>,
        solution: &Solution<2, 1, 3>,
        noise: &Noise<1>,
        workspace: &mut Workspace<3>,
    ) -> Result<Option<Solution<2, 1, 3>>, Failure> {
        let share = noise.scale.map_or(1.0, |scale| scale.iter().map(|s| s * s).sum::<f64>() / scale.len() as f64);
        let ratio = noise.inputs[0] * share / noise.output;
        if !(ratio.is_finite() && ratio > 0.0) {
            return Ok(None);
        }
        let mut refined = solution.clone();
        refined.termination = Termination::IterationLimit;
        refined.iterations = 0;
        while refined.iterations < self.max_iterations && refined.termination != Termination::Converged {
            let before = refined.parameters;
            let a = Self::denominator(&before);
            let c = spectral_factor(&before, ratio);
            if !(is_stable(&a) && is_stable(&c)) {
                return Err(Failure::Singular);
            }
            let auxiliary = Auxiliary { parameters: &before, denominator: Some(&a) };
            let next;
            (next, refined.inverse, refined.rcond) = solve(self.pass(problem, &c, Some(auxiliary), workspace), &c)?;
            refined.iterations += 1;
            if distance(&next, &before) <= self.tolerance {
                refined.termination = Termination::Converged;
            }
            (refined.parameters, refined.denominator) = (next, c);
        }
        let filter = Discrete::new(&refined.denominator, problem.interval_s).ok_or(Failure::Singular)?;
        let bias = noise_in_instrument(&refined.parameters, &filter, problem, noise).ok_or(Failure::Singular)?;
        refined.parameters = (Vector3::from(refined.parameters) - refined.inverse * Vector3::from(bias)).into();
        Ok(Some(refined))
    }
}

/// \[`c_1`, `c_0`\] for the parameters b0, a1, a0 and the `ratio` r of the noise variances.
fn spectral_factor([b0, a1, a0]: &[f64; 3], ratio: f64) -> [f64; 2] {
    let c0 = (a0 * a0 + ratio * b0 * b0).sqrt();
    [(a1 * a1 - 2.0 * a0 + 2.0 * c0).max(0.0).sqrt(), c0]
}

/// The mean β of Σ z ε from the noise of the input.
fn noise_in_instrument(
    parameters: &[f64; 3],
    filter: &Discrete<2>,
    problem: &Problem<1>,
    noise: &Noise<1>,
) -> Option<[f64; 3]> {
    let [b0, a1, a0] = *parameters;
    let (_, hold) = problem.inputs[0];
    let model = Discrete::new(&[a1, a0], problem.interval_s)?;
    let (input_row, model_row, linear) = (filter.readout(hold), model.readout(hold), filter.readout(Hold::First));
    let len = problem.output.len();
    // For the response after j samples: the noise power of all samples with at least j later samples, over
    // `noise.inputs[0]`.
    let mut reached = noise.scale.map_or(len as f64, |scale| scale.iter().map(|s| s * s).sum());
    let (mut input_state, mut model_state) = (input_row.start(&[0.0; 2], 1.0), model_row.start(&[0.0; 2], 1.0));
    let mut state = linear.start(&[0.0; 2], 0.0);
    let mut beta = [0.0; 3];
    for j in 0..len {
        let impulse = f64::from(u8::from(j == 0));
        let u = input_row.read(0, &input_state, impulse);
        let x = b0 * model_row.read(0, &model_state, impulse);
        for (beta, z) in beta.iter_mut().zip([u, -linear.read(1, &state, x), -linear.read(0, &state, x)]) {
            *beta -= noise.inputs[0] * b0 * reached * z * u;
        }
        filter.advance(&mut input_state, impulse);
        model.advance(&mut model_state, impulse);
        filter.advance(&mut state, x);
        reached -= noise.scale.map_or(1.0, |scale| scale[len - 1 - j] * scale[len - 1 - j]);
    }
    Some(beta)
}
