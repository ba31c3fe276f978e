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

use nalgebra::{Matrix2, Matrix3, Matrix4, Vector3, Vector4};

use super::{
    identification::{Estimate, Fit, Grade, RunningRatios},
    load::{DRY_SHARE, Load, STEPS},
    matrix::unit_diagonal,
    rejection::Rejection,
    trace::{samples::samples_in, window::Window},
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
/// Largest root mean square of the residual, as share of the charge of the movement. Dry friction on every slide chair
/// causes 0.3 %; a current that does not belong to the position causes more.
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
pub(super) fn start(window: &Window) -> Option<usize> {
    let output = &window.output;
    let (travel, reach) = (*output.last()?, reach(window.interval_s));
    (reach..output.len()).find(|&k| output[k] > SKIPPED_SHARE * travel).map(|k| k + reach)
}

/// Computes the ratios of a movement; `None` if the samples do not determine them or do not fit the equation.
pub(super) fn of(window: &Window) -> Option<Ratios> {
    let Window { input, output, .. } = window;
    let (equilibrium, interval_s) = (window.equilibrium, window.interval_s);
    let travel = *output.last()?;
    let (reach, from) = (reach(interval_s), start(window)?);
    let to = output.len().checked_sub(reach)?;
    if to < from + LEAST_SAMPLES {
        return None;
    }
    let speed = |k: usize| (output[k + reach] - output[k - reach]) / (2.0 * reach as f64 * interval_s);
    let rows = || {
        let (mut charge, mut angle) = (0.0, 0.0);
        (from..to).map(move |k| {
            if k > from {
                charge += 0.5 * (input[k - 1] + input[k]) * interval_s;
                angle += (0.5 * (output[k - 1] + output[k]) - equilibrium) * interval_s;
            }
            (Vector4::new(output[k] - output[from], angle, speed(k) - speed(from), 1.0), charge)
        })
    };
    let (mut normal, mut right, mut later) = (Matrix4::zeros(), Vector4::zeros(), Vector4::zeros());
    for (row, charge) in rows() {
        normal += row * row.transpose();
        right += row * charge;
        later += row;
    }
    let (scaled, scale) = unit_diagonal(&normal);
    let inverse = scaled.try_inverse()?;
    let inverse = Matrix4::from_fn(|i, j| inverse[(i, j)] * scale[i] * scale[j]);
    let found = inverse * right;
    let load = Load::of(window, from)?;
    // A charge of the load changes all later rows.
    let mut effects = [Vector4::zeros(); STEPS];
    let (mut squares, mut total) = (0.0, 0.0_f64);
    let running = (output[to - 1] - output[from]) / ((to - 1 - from) as f64 * interval_s);
    let (mut drift, mut dry, mut hidden) = (Vector4::zeros(), Vector4::zeros(), Vector4::zeros());
    // Charge from an offset of 1 A.
    let (mut extra, input_scale) = (0.0, window.input_scale());
    for (at, (row, charge)) in rows().enumerate() {
        let time_s = at as f64 * interval_s;
        extra += input_scale.map_or(1.0, |scale| scale[from + at]) * interval_s;
        drift += row * extra;
        dry += row * (time_s - row[0] / running);
        hidden += row * time_s;
        let residual = charge - row.dot(&found);
        squares += residual * residual;
        effects[load.step_of(from + at)] += later;
        later -= row;
        total = total.max(charge.abs());
    }
    if (squares / (to - from) as f64).sqrt() > LARGEST_RESIDUAL * total {
        return None;
    }
    let (drift, dry) = (inverse * drift, inverse * dry * (DRY_SHARE * found[0] * running));
    // With play the rails are ahead of the sensor by a constant distance.
    let hidden = inverse * hidden * (HIDDEN_SHARE * travel * found[1]);
    let covariance = load.covariance(|step| (inverse * effects[step]).xyz())?;
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
