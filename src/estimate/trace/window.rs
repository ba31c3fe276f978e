//! The window of a trace: the part from which the coefficients are estimated.

use super::{
    held,
    movement::{MIN_QUIET, Movement},
    release,
    samples::Level,
};
use crate::estimate::{
    rejection::Rejection,
    settings::{Motor, Settings},
    sriv::{Problem, filter::Hold},
};

/// Least number of samples, and shortest time, from which three coefficients can be estimated.
const MIN_SAMPLES: usize = 30;
const MIN_DURATION_S: f64 = 0.3;
/// Number of samples in the window before the start of the motor.
const LEAD_IN: usize = 2;
/// Ratio of the equivalent noise bandwidth of a fourth-order Butterworth low-pass to its cut-off.
const NOISE_BANDWIDTH: f64 = 1.026;
/// Standard deviation of the current sensor's offset if the trace does not show it, as share of the peak. The recording
/// of a real machine has an offset of 1.7 % of its peak.
const OFFSET_SHARE: f64 = 0.01;
/// A current at rest may be the sensor's offset, or a current that the machine draws only at rest. This is the standard
/// deviation of the share that the machine draws. Any share is possible, so the 95 % interval contains the whole
/// current, and a third more for its change at the start of the motor.
const REST_SHARE: f64 = 0.7;

/// The window of the trace, in the units of the model. Its buffers are reused from throw to throw.
#[derive(Debug, Default)]
pub(crate) struct Window {
    /// Input, positive if it drives the throw: the current I \[A\], or I |I| \[A²\] for a series motor.
    pub(crate) input: Vec<f64>,
    /// Derivative of each input with respect to the current for a series motor; else empty.
    pub(crate) input_scale: Vec<f64>,
    /// Output: the angle of the screw from the start of the throw \[rad\].
    pub(crate) output: Vec<f64>,
    /// The output at which the spring is unstressed \[rad\].
    pub(crate) equilibrium: f64,
    /// `equilibrium` from the release on, 0 before it, as mean over the interval after each sample.
    pub(crate) shift: Vec<f64>,
    /// First sample in the trace.
    pub(crate) from: usize,
    /// Last sample of the window before the start of the motor.
    pub(crate) foot: usize,
    pub(crate) interval_s: f64,
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
    /// Mean magnitude of the current I \[A\].
    pub(crate) running: f64,
    /// Departure of the current's rise from that of an armature, without that from noise, as share of the peak.
    pub(crate) rise: f64,
}

impl Window {
    /// Cuts the window out of a trace. `filter_hz` is the cut-off of the filter that the trace passed, `released` the
    /// moment of the release \[s\] if it is known already. Returns the reason why the start of the throw is unusable,
    /// so that only the ratios may be known; `None` if it is usable.
    ///
    /// # Errors
    /// When the window is too short.
    pub(crate) fn cut(
        &mut self,
        settings: &Settings,
        movement: &Movement<'_>,
        filter_hz: Option<f64>,
        released: Option<f64>,
    ) -> Result<Option<Rejection>, Rejection> {
        let Movement { current_a: current, position_mm: position, interval_s, .. } = *movement;
        let from = movement.start().saturating_sub(LEAD_IN);
        let to = movement.end().max(from) + 1;
        long_enough(to - from, interval_s)?;
        let radians_per_mm = settings.radians_per_mm();
        let offset = movement.current.mean;
        let drive = movement.drive();
        let start_mm = movement.position.mean;
        (self.from, self.foot, self.interval_s) = (from, movement.start() - from, interval_s);
        self.output.clear();
        self.output.extend(position[from..to].iter().map(|x| movement.sign * (x - start_mm) * radians_per_mm));
        self.input.clear();
        self.input.extend(current[from..to].iter().map(|i| drive * (i - offset)));
        self.input_scale.clear();
        if settings.motor == Motor::Series {
            self.input_scale.extend(self.input.iter().map(|i| 2.0 * i.abs()));
            for i in &mut self.input {
                *i *= i.abs();
            }
        }
        let mut doubt = None;
        self.rise = 0.0;
        if filter_hz.is_none() && settings.motor == Motor::PermanentMagnet {
            (self.rise, doubt) = release::complete_onset(&mut self.input, movement, self.foot);
        }
        let released = released.map_or_else(
            || release::time(&current[from..to], offset, self.foot, interval_s, filter_hz),
            |released| released - from as f64 * interval_s,
        );
        self.equilibrium = movement.sign * (settings.neutral_mm - start_mm) * radians_per_mm;
        release::course(&mut self.shift, (to - from, interval_s), (released, self.equilibrium), filter_hz);
        let (current_sd, position_sd) = sensor_noise(settings, movement);
        // Filtered noise has more power below the cut-off than white noise with the same variance of the samples.
        let colour = filter_hz.map_or(1.0, |hz| (0.5 / (interval_s * NOISE_BANDWIDTH * hz)).max(1.0));
        self.input_noise = current_sd * current_sd * colour;
        self.output_noise =
            (position_sd * radians_per_mm).powi(2) * colour.max(held::noise_power(movement.position_every));
        self.noise_samples = movement.position.samples;
        // Without quiet samples the start is the first position.
        let of_position = offset_variance(movement.position, position_sd.powi(2)) * radians_per_mm.powi(2);
        self.offsets = [current_offset_variance(movement), of_position];
        self.rest_a = rest(movement);
        self.running = movement.mean_a;
        Ok(doubt)
    }

    /// Derivative of each input with respect to the current; `None` if it is 1.
    pub(crate) fn input_scale(&self) -> Option<&[f64]> {
        (!self.input_scale.is_empty()).then_some(&self.input_scale)
    }

    /// The identification of equation (12) from this window.
    pub(crate) fn problem(&self) -> Problem<'_, 1> {
        Problem {
            interval_s: self.interval_s,
            output: &self.output,
            inputs: [(&self.input, Hold::First)],
            equilibrium: (self.equilibrium != 0.0).then_some(&self.shift),
        }
    }
}

/// Rejects a trace or window that is too short.
pub(crate) fn long_enough(samples: usize, interval_s: f64) -> Result<(), Rejection> {
    let duration_s = samples as f64 * interval_s;
    if samples < MIN_SAMPLES || duration_s < MIN_DURATION_S {
        return Err(Rejection::TooShort { samples, duration_s });
    }
    Ok(())
}

/// Standard deviations of the noise of current \[A\] and position \[mm\]. They are measured at rest. Without enough
/// samples at rest that of the current is the configured one, that of the position the smaller one of the configured
/// noise and that of the second differences. Both are at least the rounding error of the converter.
fn sensor_noise(settings: &Settings, movement: &Movement<'_>) -> (f64, f64) {
    let noise = |level: Level, unknown: f64| {
        let sd = if level.samples >= MIN_QUIET { level.sd } else { unknown };
        sd.max(level.quantum / 12.0_f64.sqrt())
    };
    let unknown_mm = movement.position_noise_mm.min(settings.position_noise_mm);
    (noise(movement.current, settings.current_noise_a), noise(movement.position, unknown_mm))
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
fn offset_variance(level: Level, unknown: f64) -> f64 {
    if level.samples == 0 {
        return unknown;
    }
    let rounding = if level.sd < 0.5 * level.quantum { level.quantum * level.quantum / 12.0 } else { 0.0 };
    level.sd * level.sd / level.samples as f64 + rounding
}
