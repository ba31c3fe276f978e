//! The window of a trace: the part from which the model is estimated.

use super::{
    movement::{Level, Movement},
    rejection::Rejection,
};

/// Standard deviation of an unknown offset of the current, as share of its peak. A recorded machine has an offset of 1.7 %
/// of its peak.
const OFFSET_SHARE: f64 = 0.01;
/// Standard deviation of the share of a current at rest that is not the sensor's offset. Any share is possible, so the 95 %
/// interval contains the whole current, with a third more for its step at the start of the motor.
const REST_SHARE: f64 = 0.7;

/// The window of the trace, in the units of the model.
pub(super) struct Window {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) interval_s: f64,
    /// The output at which the spring is unstressed \[rad\].
    pub(super) equilibrium: f64,
    /// Variances of white noise on input (per unit scale) and output.
    pub(super) input_noise: f64,
    pub(super) output_noise: f64,
    /// Number of quiet samples for the noise of the output.
    pub(super) noise_samples: usize,
    /// Variances of the offsets removed from input (per unit scale) and output.
    pub(super) offsets: [f64; 2],
    /// Standard deviation of the part of the current at rest that the machine does not draw in motion \[A\]: electronics,
    /// a brake, a detection circuit. It is subtracted as an offset of the sensor. Equal in every throw.
    pub(super) rest_a: f64,
    /// Whether the motor is series-wound, so that the input is I |I|.
    pub(super) series: bool,
    /// Mean magnitude of the current I \[A\].
    pub(super) running: f64,
    /// Departure of the current's rise from that of an armature beyond noise, as share of the peak.
    pub(super) rise: f64,
    /// The reason why the start of the motor is unusable.
    pub(super) doubt: Option<Rejection>,
}

/// Variance of the offset of the current \[A²\].
pub(super) fn current_offset_variance(movement: &Movement<'_>) -> f64 {
    offset_variance(movement.current, (OFFSET_SHARE * movement.peak_a).powi(2))
}

/// Standard deviation of the part of the current at rest that the machine does not draw in motion \[A\].
pub(super) fn rest(movement: &Movement<'_>) -> f64 {
    REST_SHARE * movement.current.mean.abs()
}

/// Variance of a mean over quiet samples; `unknown` without samples. With noise below half a step of the converter averaging
/// does not help.
pub(super) fn offset_variance(level: Level, unknown: f64) -> f64 {
    if level.samples == 0 {
        return unknown;
    }
    let rounding = if level.sd < 0.5 * level.quantum { level.quantum * level.quantum / 12.0 } else { 0.0 };
    level.sd * level.sd / level.samples as f64 + rounding
}
