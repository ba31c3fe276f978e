//! The ratios a1/b0 and a0/b0 of the coefficients, from the movement without its start.
//!
//! Let s be a sample at which the toe has moved a little. Equation (12) integrated from s on, and divided by b0, is
//! linear in the ratios:
//!
//! ```text
//! ∫ u dt = (a1/b0) (y - y_s) + (a0/b0) ∫ (y - y_eq) dt + (1/b0) (y' - y'_s)
//! ```
//!
//! This needs neither the time or position of the release, nor the speed at s, nor an iteration. A movement at nearly
//! constant speed determines the ratios, but hardly 1/b0. The noise of the integrated current is a random walk, and a
//! varying load and errors of the model are correlated over still longer times. So the covariance is that of a random
//! load (see `load`).

use std::ops::Range;

use nalgebra::{Matrix2, Matrix3, Matrix4, Vector3, Vector4};

use super::{
    identification::{Estimate, Fit, Grade, RunningRatios},
    load::{DRY_SHARE, Integrals, Load, STEPS},
    products::Products,
    rejection::Rejection,
    trace::{
        samples::{mean, peak, samples_in},
        window::Window,
    },
};

/// Standard deviation of the logarithm of the common scale of the coefficients if nothing is known about it.
const SCALE_SD: f64 = 0.45;
/// Share of the travel that is skipped as the start: 1.5 mm of 115 mm.
const SKIPPED_SHARE: f64 = 0.013;
/// Standard deviation of the part of the travel that play hides from the sensor, as share of the travel. It is 0.6 mm
/// of 115 mm, the root mean square of a play of 0 to 1 mm.
const HIDDEN_SHARE: f64 = 0.005;
/// The speed at a sample is the central difference between this time before it and this time after it \[s\].
const SPEED_S: f64 = 0.02;
/// Least number of samples of a movement.
const LEAST_SAMPLES: usize = 40;
/// Largest root mean square of the residual, as share of the charge of the movement or of its load, whichever is larger:
/// rails that help the motor may leave hardly any charge. Dry friction on every slide chair causes 0.3 %; a current that
/// does not belong to the position causes more.
const LARGEST_RESIDUAL: f64 = 0.006;

/// The ratios a1/b0 and a0/b0 with their errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ratios {
    pub(super) values: [f64; 2],
    /// Covariances of the logarithms of the ratios: from errors that differ in each throw, and from errors that are
    /// equal in every throw.
    pub(super) log_covariance: Matrix2<f64>,
    pub(super) log_systematic: Matrix2<f64>,
    /// Errors of the logarithms of the ratios for one standard deviation of the part of the current at rest that the
    /// machine does not draw in motion.
    log_offset: [f64; 2],
    /// First sample used, in the window.
    pub(super) from: usize,
}

impl Ratios {
    /// The ratios with the covariance of both kinds of errors.
    pub(super) fn running(&self) -> RunningRatios {
        RunningRatios { values: self.values, log_covariance: self.log_covariance + self.log_systematic }
    }

    /// A rough estimate with these ratios and the arbitrary b0 = 1; `fit` is that of the full model.
    pub(super) fn estimate(&self, window: &Window, fit: Option<Fit>, reason: Option<Rejection>) -> Estimate {
        let [a1, a0] = self.values;
        Estimate {
            grade: Grade::Rough,
            b0: 1.0,
            a1,
            a0,
            ratios_only: true,
            covariance: covariance([1.0, a1, a0], SCALE_SD, self.log_covariance),
            systematic: covariance([1.0, a1, a0], 0.0, self.log_systematic),
            offset: [0.0, a1 * self.log_offset[0], a0 * self.log_offset[1]],
            reason,
            running: None,
            fit,
            start_s: (window.from + self.from) as f64 * window.interval_s,
            end_s: (window.from + window.output.len() - 1) as f64 * window.interval_s,
        }
    }
}

/// Covariance of (b0, a1, a0) from the standard deviation of the logarithm of their common scale, and the covariance of
/// the logarithms of their ratios.
pub(super) fn covariance(coefficients: [f64; 3], scale_sd: f64, of_ratios: Matrix2<f64>) -> Matrix3<f64> {
    let mut log = Matrix3::repeat(scale_sd * scale_sd);
    let mut ratios = log.fixed_view_mut::<2, 2>(1, 1);
    ratios += of_ratios;
    let scale = Matrix3::from_diagonal(&Vector3::from(coefficients));
    scale * log * scale
}

/// [`SPEED_S`] in samples.
fn reach(interval_s: f64) -> usize {
    samples_in(SPEED_S, interval_s).max(1)
}

/// The first sample after the start of the movement; `None` if the toe does not move.
fn start(window: &Window) -> Option<usize> {
    let output = &window.output;
    let (travel, reach) = (*output.last()?, reach(window.interval_s));
    (reach..output.len()).find(|&k| output[k] > SKIPPED_SHARE * travel).map(|k| k + reach)
}

/// The load of a movement after its start; `None` if the samples do not determine it. Fills the integrals, for [`of`].
pub(super) fn load(window: &Window, integrals: &mut Integrals, scratch: &mut Vec<f64>) -> Option<Load> {
    let from = start(window).filter(|from| *from < window.output.len())?;
    integrals.fill(window, from);
    Load::of(window, from, integrals, scratch)
}

/// Computes the ratios of a movement from the samples that have this load; `None` if the samples do not determine them
/// or do not fit the equation. `integrals`: those of the load.
pub(super) fn of(window: &Window, load: &Load, integrals: &Integrals) -> Option<Ratios> {
    let Window { output, interval_s, .. } = window;
    let (travel, from) = (*output.last()?, load.from);
    let to = output.len().checked_sub(reach(*interval_s))?;
    if to < from + LEAST_SAMPLES {
        return None;
    }
    let running = (output[to - 1] - output[from]) / ((to - 1 - from) as f64 * interval_s);
    let sums = Sums::over(window, from..to, load, integrals);
    let [charge, time] = [4, 5].map(|signal| sums.with_factors(signal));
    // The charge from an offset of 1 A.
    let input_scale = |step| window.input_scale().map_or(1.0, |scale| mean(&scale[step]));
    let offset: Vector4<f64> =
        load.steps(from..to).zip(&sums.effects).map(|(step, effect)| effect * (input_scale(step) * interval_s)).sum();
    let normal = Matrix4::from_fn(|i, j| sums.products[i][j]);
    // The inverse by cofactors needs no scaling of the units.
    let inverse = normal.try_inverse()?;
    let found = inverse * charge;
    let squares = (sums.products[4][4] - found.dot(&charge)).max(0.0);
    let load_charge = found[0].abs() * (output[to - 1] - output[from]) + found[1].abs() * sums.largest_angle;
    if (squares / (to - from) as f64).sqrt() > LARGEST_RESIDUAL * sums.largest_charge.max(load_charge) {
        return None;
    }
    let drift = inverse * offset;
    let dry = inverse * (time - normal.column(0) / running) * (DRY_SHARE * found[0] * running);
    // With play the rails are ahead of the sensor by a constant distance.
    let hidden = inverse * time * (HIDDEN_SHARE * travel * found[1]);
    let covariance = load.covariance(|step| (inverse * sums.effects[step]).xyz())?;
    let values = [found[0], found[1]];
    if !(values.iter().all(|v| v.is_finite() && *v > 0.0)) {
        return None;
    }
    let log = |i: usize, j: usize, value: f64| value / (values[i] * values[j]);
    let log_covariance =
        Matrix2::from_fn(|i, j| log(i, j, covariance[(i, j)] + window.offsets[0] * drift[i] * drift[j]));
    let log_systematic = Matrix2::from_fn(|i, j| log(i, j, dry[i] * dry[j] + hidden[i] * hidden[j]));
    let log_offset = std::array::from_fn(|i| window.rest_a * drift[i] / values[i]);
    Some(Ratios { values, log_covariance, log_systematic, log_offset, from })
}

/// Sums over the samples of a movement. The factors of a sample are those of the integrated equation, and 1 for its
/// constant: y - `y_s`, ∫(y - `y_eq`) dt, y' - `y'_s` and 1.
struct Sums {
    /// Products of each two of the four factors, the charge ∫u dt, and the time since the first sample.
    products: [[f64; 6]; 6],
    largest_charge: f64,
    largest_angle: f64,
    /// For each step of the load: the sum over its samples of the factors' products with a charge of 1 from that sample
    /// on.
    effects: [Vector4<f64>; STEPS],
}

impl Sums {
    fn over(window: &Window, samples: Range<usize>, load: &Load, integrals: &Integrals) -> Self {
        let Window { output, interval_s, .. } = window;
        let (from, reach) = (samples.start, reach(*interval_s));
        let [charge, angle] = [&integrals.charge, &integrals.angle].map(|signal| &signal[..samples.len()]);
        let per_s = (2.0 * reach as f64 * interval_s).recip();
        let speed = |k: usize| (output[k + reach] - output[k - reach]) * per_s;
        let first_speed = speed(from);
        let mut products = Products::<6>::ZERO;
        let mut before = [[0.0; 2]; 4];
        let mut effects = [Vector4::zeros(); STEPS];
        for (effect, step) in effects.iter_mut().zip(load.steps(samples.clone())) {
            products.add(step.clone(), |k| {
                let (at, time_s) = (k - from, (k - from) as f64 * interval_s);
                [output[k] - output[from], angle[at], speed(k) - first_speed, 1.0, charge[at], time_s]
            });
            // A charge from sample k of the step on adds the factors of the samples from k on: for the samples of the
            // step, the factor times their number in the step up to its own sample.
            let first_s = (step.start - from) as f64 * interval_s;
            *effect = Vector4::from_fn(|i, _| {
                let sums = [3, 5].map(|j| products.sum(i, j));
                let [factor, moment] = std::array::from_fn(|j| sums[j] - before[i][j]);
                before[i] = sums;
                (moment - first_s * factor) / interval_s + factor - step.len() as f64 * sums[0]
            });
        }
        let [largest_charge, largest_angle] = [charge, angle].map(|signal| peak(signal, 0.0));
        let mut sums = Self { products: products.sums(), largest_charge, largest_angle, effects };
        let constant = sums.with_factors(3);
        for (effect, step) in sums.effects.iter_mut().zip(load.steps(samples)) {
            *effect += constant * step.len() as f64;
        }
        sums
    }

    /// The products of the four factors with a signal.
    fn with_factors(&self, signal: usize) -> Vector4<f64> {
        Vector4::from_fn(|factor, _| self.products[factor][signal])
    }
}
