//! Errors of the coefficients from a random load of unknown size and correlation time.
//!
//! A load counts as the current d that it takes from the motor. In the integrated equation (12) (see `ratios`) it is a
//! charge. The movement is cut into windows. The means of the integrated equation over two neighbouring windows differ
//! by
//!
//! ```text
//! Δ∫u dt = (a1/b0) Δy + (a0/b0) Δ∫(y - y_eq) dt + (1/b0) Δy' + D_k,   D_k = Δ∫d dt
//! ```
//!
//! so the residuals of a fit of the three factors show the charges D of the load. The difference of two neighbouring
//! windows is called a step. The model of the load is a first-order autoregression, `E[D_j D_k]` = σ² φ^|j-k|. A fit
//! also removes a part of a slow load. The restricted likelihood L accounts for this, as it uses only the part of D
//! that no factors can explain (Patterson, Thompson 1971). With the covariance Σ of D for σ = 1, and the matrix X of
//! the fit,
//!
//! ```text
//! L(φ) = |Σ|^(-1/2) |X'Σ⁻¹X|^(-1/2) S^(-ν/2),   S = min D'Σ⁻¹D,   σ² = S/ν,   ν = steps - 3
//! ```
//!
//! Let an estimate change by `g_k` for a charge of 1 in step k. Its variance is the sum of `g_j` `g_k` σ² φ^|j-k| over
//! all j and k. A throw of some seconds hardly shows how long a load lasts, so the result is the mean of this variance
//! over φ, weighted by L.

use std::ops::Range;

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

use super::{
    lanes::sum,
    trace::{
        samples::{integrate, samples_in},
        window::Window,
    },
};

/// Standard deviation of the share of the friction that is dry: the root mean square of a share that may be anything
/// from 0 to 1.
pub(super) const DRY_SHARE: f64 = 0.58;
/// Length of a window \[s\]. With 0.1 s, rails that vibrate at 9 Hz look like a slow load. With 0.05 s, 20 um of noise
/// in the position look like a load that varies by 2 % within 50 ms.
const STEP_S: f64 = 0.07;
/// Largest number of steps, which bounds the time of the computation, and least number.
pub(crate) const STEPS: usize = 48;
const LEAST_STEPS: usize = 8;
/// Least number of samples of a window: a slope is fitted to them.
const LEAST_SAMPLES: usize = 3;
/// Tried correlations of neighbouring steps: correlation times from zero to 3.5 s, the length of a throw, in equal
/// ratios.
const CORRELATIONS: [f64; 8] = [0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.98];
/// Least residual sum of squares as share of the whole: less is rounding, in a trace without noise.
const ROUNDING: f64 = 1e-12;
/// The 95 % interval of Student's t with ν degrees of freedom is wider than that of a normal variable by the factor
/// 1 + this / ν. (Cornish, Fisher: (1.96² + 1)/4)
const STUDENT: f64 = 1.21;

/// Integrals over a movement from one of its samples on, reused from throw to throw.
#[derive(Debug, Default)]
pub(crate) struct Integrals {
    /// ∫u dt.
    pub(super) charge: Vec<f64>,
    /// ∫(y - `y_eq`) dt.
    pub(super) angle: Vec<f64>,
}

impl Integrals {
    pub(super) fn fill(&mut self, window: &Window, from: usize) {
        integrate(&mut self.charge, &window.input[from..], 0.0, window.interval_s);
        integrate(&mut self.angle, &window.output[from..], window.equilibrium, window.interval_s);
    }
}

/// The integrated equation of a movement, as differences of neighbouring windows.
#[derive(Debug)]
pub(crate) struct Load {
    /// First sample of the first window, and samples of a window.
    pub(super) from: usize,
    length: usize,
    /// Number of steps.
    count: usize,
    /// For each of [`CORRELATIONS`] ln L and σ².
    fits: [(f64, f64); CORRELATIONS.len()],
    /// For each step the differences of y, ∫(y - `y_eq`) dt and y', which the three factors multiply, and of ∫u dt.
    rows: [Vector4<f64>; STEPS],
}

impl Load {
    /// Cuts a movement from the sample `from` on into steps; `None` if it is too short, or does not determine the three
    /// factors. `integrals`: those from the sample `from` on.
    pub(crate) fn of(window: &Window, from: usize, integrals: &Integrals, scratch: &mut Vec<f64>) -> Option<Self> {
        let (output, interval_s) = (window.output.get(from..)?, window.interval_s);
        let samples = output.len();
        let steps = samples_in(samples as f64 * interval_s, STEP_S).clamp(LEAST_STEPS, STEPS);
        let length = (samples / (steps + 1)).max(LEAST_SAMPLES);
        let count = (samples / length).min(STEPS + 1).checked_sub(1).filter(|count| *count >= LEAST_STEPS)?;
        let fits = [(0.0, 0.0); CORRELATIONS.len()];
        let mut load = Self { from, length, count, fits, rows: [Vector4::zeros(); STEPS] };
        // With parabolic weights 1 - x² the mean of y' is the slope of the regression line through y, which has the
        // least noise. The sums of x² and of the weights over a window:
        let per_window = length as f64;
        let squares = (per_window * per_window - 1.0) / (3.0 * per_window);
        let weights = per_window - squares;
        let of_slope = 2.0 / (squares * per_window * interval_s);
        let scale = Vector4::new(1.0 / weights, 1.0 / weights, of_slope, 1.0 / weights);
        let place = |at: usize| (2 * at + 1) as f64 * per_window.recip() - 1.0;
        scratch.clear();
        scratch.extend((0..length).map(place));
        let place = scratch.as_slice();
        let mut before = None;
        for (window, start) in (0..).step_by(length).take(count + 1).enumerate() {
            let [output, angle, charge] =
                [output, &integrals.angle, &integrals.charge].map(|signal| [place, &signal[start..start + length]]);
            let weighted = |[x, value]: [f64; 2]| (1.0 - x * x) * value;
            let slope = sum(output, |[x, y]| x * y);
            let row = Vector4::new(sum(output, weighted), sum(angle, weighted), slope, sum(charge, weighted));
            let row = row.component_mul(&scale);
            if let Some(before) = before.replace(row) {
                load.rows[window - 1] = row - before;
            }
        }
        for (at, phi) in CORRELATIONS.into_iter().enumerate() {
            load.fits[at] = load.fit(phi)?;
        }
        Some(load)
    }

    /// The step that a load at `sample` changes. All samples before the first step belong to it.
    pub(crate) fn step_of(&self, sample: usize) -> usize {
        (sample.saturating_sub(self.from + self.length / 2) / self.length).min(self.count - 1)
    }

    /// The samples of each step by [`Self::step_of`], in order.
    pub(crate) fn steps(&self, samples: Range<usize>) -> impl Iterator<Item = Range<usize>> {
        let middle = self.from + self.length / 2;
        let first = move |step: usize| match step {
            0 => samples.start,
            step if step == self.count => samples.end,
            step => (middle + step * self.length).clamp(samples.start, samples.end),
        };
        (0..self.count).map(move |step| first(step)..first(step + 1))
    }

    /// Covariance of the errors of an estimate from the load. `change` is the change of the estimate by a charge of 1
    /// in every sample of a step. `None` if it is not finite.
    pub(crate) fn covariance(&self, change: impl Fn(usize) -> Vector3<f64>) -> Option<Matrix3<f64>> {
        let most = self.fits.iter().fold(f64::NEG_INFINITY, |most, (likelihood, _)| likelihood.max(most));
        let mut changes = [Vector3::zeros(); STEPS];
        let changes = &mut changes[..self.count];
        let mut squares = Matrix3::zeros();
        for (step, own) in changes.iter_mut().enumerate() {
            *own = change(step) / self.length as f64;
            squares += *own * own.transpose();
        }
        let (mut total, mut covariance) = (0.0, Matrix3::zeros());
        for ((likelihood, variance), phi) in self.fits.into_iter().zip(CORRELATIONS) {
            // For step k, `before` is the sum of g_j φ^(k-j) over the steps j before it.
            let (mut before, mut products) = (Vector3::zeros(), Matrix3::zeros());
            for own in &*changes {
                products += before * own.transpose();
                before = (before + own) * phi;
            }
            let weight = (likelihood - most).exp();
            total += weight;
            covariance += (squares + products + products.transpose()) * (variance * weight);
        }
        let covariance = covariance * ((1.0 + STUDENT / self.freedom()).powi(2) / total);
        covariance.iter().all(|v| v.is_finite()).then_some(covariance)
    }

    /// The number ν of degrees of freedom.
    fn freedom(&self) -> f64 {
        (self.count - 3) as f64
    }

    /// ln L and σ² for the correlation `phi` of neighbouring steps, by generalised least squares: minus `phi` times the
    /// step before, the charges of the load are independent.
    fn fit(&self, phi: f64) -> Option<(f64, f64)> {
        let freedom = self.freedom();
        let new = 1.0 - phi * phi;
        let (mut sums, mut before) = (Matrix4::zeros(), Vector4::zeros());
        for (step, row) in self.rows[..self.count].iter().enumerate() {
            let weight = if step == 0 { 1.0 } else { new.recip() };
            let own = row - phi * before;
            sums += own * own.transpose() * weight;
            before = *row;
        }
        let (normal, right) = (sums.fixed_resize::<3, 3>(0.0), sums.column(3).xyz());
        let square = sums[(3, 3)];
        let left = (square - right.dot(&(normal.try_inverse()? * right))).max(ROUNDING * square);
        let likelihood = -0.5 * ((self.count - 1) as f64 * new.ln() + normal.determinant().ln() + freedom * left.ln());
        Some((likelihood, left / freedom))
    }
}
