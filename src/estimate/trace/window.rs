//! The window of a trace: the part from which the coefficients are estimated.

use super::movement::{Level, Movement};
use crate::estimate::rejection::Rejection;

/// Standard deviation of the current sensor's offset if the trace does not show it, as share of the peak. The recording
/// of a real machine has an offset of 1.7 % of its peak.
const OFFSET_SHARE: f64 = 0.01;
/// A current at rest may be the sensor's offset, or a current that the machine draws only at rest. This is the standard
/// deviation of the share that the machine draws. Any share is possible, so the 95 % interval contains the whole
/// current, and a third more for its change at the start of the motor.
const REST_SHARE: f64 = 0.7;

/// The window of the trace, in the units of the model: input \[A\], or \[A²\] for a series motor, and output \[rad\].
pub(crate) struct Window {
    /// First sample, and the sample after the last one.
    pub(crate) from: usize,
    pub(crate) to: usize,
    pub(crate) interval_s: f64,
    /// The output at which the spring is unstressed \[rad\].
    pub(crate) equilibrium: f64,
    /// Variances of white noise on the current and on the output.
    pub(crate) input_noise: f64,
    pub(crate) output_noise: f64,
    /// Number of samples at rest from which the noise of the output was measured.
    pub(crate) noise_samples: usize,
    /// Variances of the offsets that were removed from the current and from the output.
    pub(crate) offsets: [f64; 2],
    /// Standard deviation of the part of the current at rest that the machine does not draw in motion \[A\]:
    /// electronics, a brake, a detection circuit. The whole current at rest is subtracted as an offset of the sensor,
    /// so the error is equal in every throw.
    pub(crate) rest_a: f64,
    /// Whether the motor is series-wound, so that the input is I |I|.
    pub(crate) series: bool,
    /// Mean magnitude of the current I \[A\].
    pub(crate) running: f64,
    /// Departure of the current's rise from that of an armature, without that from noise, as share of the peak.
    pub(crate) rise: f64,
    /// The reason why the start of the throw is unusable, so that only the ratios may be known; `None` if it is usable.
    pub(crate) doubt: Option<Rejection>,
}

/// Variance of the offset of the current \[A²\].
pub(crate) fn current_offset_variance(movement: &Movement<'_>) -> f64 {
    offset_variance(movement.current, (OFFSET_SHARE * movement.peak_a).powi(2))
}

/// Standard deviation of the part of the current at rest that the machine does not draw in motion \[A\].
pub(crate) fn rest(movement: &Movement<'_>) -> f64 {
    REST_SHARE * movement.current.mean.abs()
}

/// Variance of an offset that is the mean of the samples at rest; `unknown` without such samples. If the noise is below
/// half a step of the converter, the rounding error of a sample is added, as all samples may have the same.
pub(crate) fn offset_variance(level: Level, unknown: f64) -> f64 {
    if level.samples == 0 {
        return unknown;
    }
    let rounding = if level.sd < 0.5 * level.quantum { level.quantum * level.quantum / 12.0 } else { 0.0 };
    level.sd * level.sd / level.samples as f64 + rounding
}
