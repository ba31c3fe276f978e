//! The window of a trace: the part from which the model is estimated.

use super::{movement::Level, rejection::Rejection};

/// The window of the trace, in the units of the model.
pub(super) struct Window {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) interval_s: f64,
    pub(super) shifted: bool,
    /// Variances of white noise on input (per unit scale) and output.
    pub(super) input_noise: f64,
    pub(super) output_noise: f64,
    /// Number of quiet samples for the noise of the output.
    pub(super) noise_samples: usize,
    /// Variances of the offsets removed from input and output.
    pub(super) offsets: [f64; 2],
    /// Whether the input is I |I|; mean magnitude of I.
    pub(super) series: bool,
    pub(super) running: f64,
    /// Departure of the current's rise from that of an armature beyond noise, as share of the peak.
    pub(super) rise: f64,
    /// The reason why the start of the motor is unusable.
    pub(super) doubt: Option<Rejection>,
}

/// Variance of a mean over quiet samples; with noise below half a step of the converter averaging does not help.
pub(super) fn offset_variance(level: Level) -> f64 {
    let rounding = if level.sd < 0.5 * level.quantum { level.quantum * level.quantum / 12.0 } else { 0.0 };
    if level.samples == 0 { 0.0 } else { level.sd * level.sd / level.samples as f64 + rounding }
}
