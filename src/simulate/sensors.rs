//! Sensors and logger: from the true motion to the recorded trace.
//!
//! The errors are applied in this order, as in a real channel: gain of the sensor, anti-alias filter, sampling with
//! jitter, offset, noise, clipping, quantisation, stuck channel, dropped samples.

use rand::{Rng, RngExt};
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use crate::throw::{
    Channel, Direction, MAX_SAMPLES, OutOfRange,
    Range::{Above, AtLeast, Finite, If, Within},
    Trace, settings,
};

use super::filter::Butterworth;
use super::motion::{Motion, STEP_S};

settings! {
    /// Sensor of one channel. Its values have the unit of the channel, A or mm.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    pub struct Sensor {
        /// Standard deviation of white noise.
        pub noise: f64 = 0.02, AtLeast(0.0);
        /// Constant error.
        pub offset: f64 = 0.0, Finite;
        /// Error of the gain \[%\].
        pub gain_pct: f64 = 0.0, Within(-90.0, 900.0, "%");
        /// Largest magnitude that the sensor shows; larger values are clipped. `None` for no limit.
        pub full_scale: Option<f64> = None, Above(0.0);
        /// Resolution of the converter over the range from minus to plus full scale \[bits\]; needs `full_scale`.
        /// `None` for no quantisation.
        pub bits: Option<u32> = None, Within(4.0, 24.0, "bits");
    }
}

settings! {
    /// Sensors and logger of one machine. The defaults are good sensors: 1 kHz, 20 mA and 20 um of noise.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    pub struct Sensors {
        /// Sampling rate \[Hz\], 25 to 20,000.
        pub sample_rate_hz: f64 = 1000.0, Within(25.0, 20_000.0, "Hz");
        /// Length of the recording before the motor starts \[s\].
        pub before_s: f64 = 0.2, Within(0.0, 5.0, "s");
        /// Length of the recording after the motor is cut off \[s\].
        pub after_s: f64 = 0.2, Within(0.0, 5.0, "s");
        /// Sensor of the motor current \[A\].
        pub current: Sensor = Sensor::default();
        /// Sensor of the toe position \[mm\].
        pub position: Sensor = Sensor::default();
        /// Whether the sign of the current shows the direction: negative from reverse to normal. Else it is positive in
        /// both.
        pub signed_current: bool = false;
        /// Standard deviation of the sampling instants from their nominal times \[s\].
        pub jitter_s: f64 = 0.0, Within(0.0, 1.0, "s");
        /// Share of samples that the logger drops \[%\].
        pub dropped_pct: f64 = 0.0, Within(0.0, 50.0, "%");
        /// Cut-off of the 4th-order Butterworth filter in both channels \[Hz\]; `None` for no filter.
        pub anti_alias_hz: Option<f64> = None;
        /// A stuck channel; `None` if both work.
        pub stuck: Option<Stuck> = None;
    }
}

/// A channel that repeats one value from a given time on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stuck {
    /// The channel at fault.
    pub channel: Channel,
    /// Time of the last correct value, after the start of the motor \[s\].
    pub from_s: f64,
}

/// Recording of a throw as the logger samples it.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Nominal time of each sample from the first one on \[s\]; a dropped sample leaves a gap.
    pub time_s: Vec<f64>,
    /// The samples, without the dropped ones.
    pub trace: Trace,
}

impl Sensors {
    /// Sensors without noise and errors, sampled at `sample_rate_hz`.
    pub fn perfect(sample_rate_hz: f64) -> Self {
        let channel = Sensor { noise: 0.0, ..Sensor::default() };
        Self { sample_rate_hz, current: channel, position: channel, ..Self::default() }
    }

    /// Checks that every value is finite and in its range.
    ///
    /// # Errors
    /// The first value out of its range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        self.check_ranges()?;
        self.current.check().map_err(|error| error.within("current"))?;
        self.position.check().map_err(|error| error.within("position"))?;
        if let Some(stuck) = self.stuck {
            stuck.check().map_err(|error| error.within("stuck"))?;
        }
        match self.anti_alias_hz {
            Some(hz) => {
                let is_low = hz > 0.0 && hz < self.sample_rate_hz / 2.0;
                If(is_low, "above 0 and below half the sampling rate").check("anti_alias_hz", hz)
            }
            None => Ok(()),
        }
    }

    /// The simulation step for these sensors: a whole fraction of the sampling period, at most [`STEP_S`], and with an
    /// anti-alias filter at most a quarter of the period.
    pub fn step_s(&self) -> f64 {
        let oversampling = if self.anti_alias_hz.is_some() { 4.0 } else { 1.0 };
        let steps = (1.0 / (STEP_S * self.sample_rate_hz)).ceil().max(oversampling);
        1.0 / (self.sample_rate_hz * steps)
    }

    /// Records `motion` with the errors of the sensors, the filter and the sampling.
    ///
    /// # Errors
    /// When a value is out of its range.
    pub fn record<R: Rng>(&self, motion: &Motion, direction: Direction, rng: &mut R) -> Result<Recording, OutOfRange> {
        self.check()?;
        let sign = if self.signed_current { direction.sign() } else { 1.0 };
        let current = self.filtered(motion, &motion.current_a, sign * (1.0 + self.current.gain_pct / 100.0));
        let position = self.filtered(motion, &motion.toe_mm, 1.0 + self.position.gain_pct / 100.0);
        let period = 1.0 / self.sample_rate_hz;
        let off_s = motion.cut_off as f64 * motion.step_s;
        let count = (whole((self.before_s + off_s + self.after_s) * self.sample_rate_hz) + 1).min(MAX_SAMPLES);
        let lead = self.before_s;
        let mut time = Vec::with_capacity(count);
        let (mut current_a, mut position_mm) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let mut stuck_at: Option<f64> = None;
        for at in 0..count {
            let nominal_s = at as f64 * period - lead;
            let time_s = if self.jitter_s > 0.0 { nominal_s + self.jitter_s * normal(rng) } else { nominal_s };
            let mut a = self.current.reading(interpolate(&current, time_s / motion.step_s), rng);
            let mut mm = self.position.reading(interpolate(&position, time_s / motion.step_s), rng);
            if let Some(stuck) = self.stuck.filter(|stuck| nominal_s >= stuck.from_s) {
                let value = match stuck.channel {
                    Channel::Current => &mut a,
                    Channel::Position => &mut mm,
                };
                *value = *stuck_at.get_or_insert(*value);
            }
            if at > 0 && self.dropped_pct > 0.0 && rng.random::<f64>() * 100.0 < self.dropped_pct {
                continue;
            }
            time.push(at as f64 * period);
            current_a.push(a);
            position_mm.push(mm);
        }
        Ok(recording(self.sample_rate_hz, time, current_a, position_mm))
    }

    /// The channel at each step of the simulation, after gain and anti-alias filter.
    fn filtered(&self, motion: &Motion, truth: &[f64], gain: f64) -> Vec<f64> {
        let mut channel: Vec<f64> = truth.iter().map(|value| value * gain).collect();
        if let Some(cut_off_hz) = self.anti_alias_hz {
            Butterworth::new(cut_off_hz, 1.0 / motion.step_s).run(&mut channel);
        }
        channel
    }
}

impl Stuck {
    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        Within(0.0, 40.0, "s").check("from_s", self.from_s)
    }
}

impl Sensor {
    fn check(&self) -> Result<(), OutOfRange> {
        self.check_ranges()?;
        if self.bits.is_none() {
            return Ok(());
        }
        let must = "given with bits: the converter's range";
        If(self.full_scale.is_some(), must).check("full_scale", self.full_scale.unwrap_or(f64::NAN))
    }

    /// The output of the sensor for the value `truth`, to which the gain is already applied.
    fn reading<R: Rng>(&self, truth: f64, rng: &mut R) -> f64 {
        let mut value = truth + self.offset;
        if self.noise > 0.0 {
            value += self.noise * normal(rng);
        }
        let Some(scale) = self.full_scale else { return value };
        value = value.clamp(-scale, scale);
        match self.bits {
            Some(bits) => {
                let step = 2.0 * scale / 2.0_f64.powi(bits.cast_signed());
                (value / step).round() * step
            }
            None => value,
        }
    }
}

#[expect(
    clippy::expect_used,
    reason = "the checks keep the rate in range, `record` the length, and the first sample is never dropped"
)]
fn recording(sample_rate_hz: f64, time_s: Vec<f64>, current_a: Vec<f64>, position_mm: Vec<f64>) -> Recording {
    let trace = Trace::new(sample_rate_hz, current_a, position_mm).expect("a recorded trace");
    Recording { time_s, trace }
}

/// Linear interpolation between the values of `grid` at a fractional index; constant beyond both ends.
fn interpolate(grid: &[f64], index: f64) -> f64 {
    let last = grid.len() - 1;
    if index <= 0.0 {
        return grid[0];
    }
    let low = whole(index);
    if low >= last {
        return grid[last];
    }
    let part = index - low as f64;
    grid[low] + part * (grid[low + 1] - grid[low])
}

/// The integer part of a number that is not negative.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not negative, and bounded by the checks")]
fn whole(value: f64) -> usize {
    value as usize
}

/// A random number from the standard normal distribution.
pub(super) fn normal<R: Rng>(rng: &mut R) -> f64 {
    rng.sample(StandardNormal)
}
