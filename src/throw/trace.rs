//! The trace of a throw: its two sampled channels.

use std::{iter, sync::Arc};

use serde::{Deserialize, Serialize};

use super::brief;

/// Longest trace, in samples of each channel: 50 s at 20 kHz. Bounds the memory that one message can use.
pub const MAX_SAMPLES: usize = 1_000_000;
/// Lowest sampling rate that a trace accepts \[Hz\].
pub const MIN_SAMPLE_RATE_HZ: f64 = 1.0;
/// Highest sampling rate that a trace accepts \[Hz\].
pub const MAX_SAMPLE_RATE_HZ: f64 = 1_000_000.0;
/// Two sampling rates are the same up to this relative difference: the times in a file have at least six digits.
const SAME_RATE: f64 = 1e-6;

/// One of the two channels of a trace.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, strum::Display)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Channel {
    /// Motor current.
    Current,
    /// Toe position.
    Position,
}

/// Motor current and toe position, sampled together at a constant rate.
///
/// The channels are equally long and have 1 to [`MAX_SAMPLES`] samples. Values may be NaN or infinite: a broken sensor
/// is a fault of the machine that must be stored and reported, so it is not an error here. Clones share the samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    sample_rate_hz: f64,
    current_a: Arc<Vec<f64>>,
    position_mm: Arc<Vec<f64>>,
}

/// The reason why two channels do not form a trace, as a sentence.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct InvalidTrace(String);

impl Trace {
    /// A trace of `current_a` \[A\] and `position_mm` \[mm\] at `sample_rate_hz` \[Hz\].
    ///
    /// # Errors
    /// When the rate is out of range, the channels differ in length, or their length is 0 or above [`MAX_SAMPLES`].
    pub fn new(sample_rate_hz: f64, current_a: Vec<f64>, position_mm: Vec<f64>) -> Result<Self, InvalidTrace> {
        let (current, position) = (current_a.len(), position_mm.len());
        let problem = if !(MIN_SAMPLE_RATE_HZ..=MAX_SAMPLE_RATE_HZ).contains(&sample_rate_hz) {
            let rate = brief(sample_rate_hz);
            format!("sample_rate_hz is {rate}, must be {MIN_SAMPLE_RATE_HZ} to {MAX_SAMPLE_RATE_HZ}")
        } else if current != position {
            format!("current_a has {current} samples and position_mm {position}: they must be equally long")
        } else if !(1..=MAX_SAMPLES).contains(&current) {
            format!("{current} samples a channel, must be 1 to {MAX_SAMPLES}")
        } else {
            let (current_a, position_mm) = (Arc::new(current_a), Arc::new(position_mm));
            return Ok(Self { sample_rate_hz, current_a, position_mm });
        };
        Err(InvalidTrace(problem))
    }

    /// Replaces the sampling rate, which was computed from the times of the samples, by `nominal_hz`, if the two are
    /// the same within the precision of these times.
    #[must_use]
    pub(crate) fn with_exact_rate(self, nominal_hz: Option<f64>) -> Self {
        let is_same = |nominal_hz: &f64| (nominal_hz / self.sample_rate_hz - 1.0).abs() < SAME_RATE;
        let sample_rate_hz = nominal_hz.filter(is_same).unwrap_or(self.sample_rate_hz);
        Self { sample_rate_hz, ..self }
    }

    /// Sampling rate \[Hz\].
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Motor current \[A\], one value a sample.
    pub fn current_a(&self) -> &[f64] {
        &self.current_a
    }

    /// Toe position \[mm\], one value a sample; 0 at normal, the stroke at reverse.
    pub fn position_mm(&self) -> &[f64] {
        &self.position_mm
    }

    /// Whether the trace has a toe position. Loggers without a toe sensor send only missing samples (NaN) or only
    /// zeros.
    pub fn has_position(&self) -> bool {
        self.position_mm.iter().any(|mm| mm.is_finite() && *mm != 0.0)
    }

    /// Number of samples of each channel, at least 1.
    #[expect(clippy::len_without_is_empty, reason = "a trace is never empty")]
    pub fn len(&self) -> usize {
        self.current_a.len()
    }

    /// The lines of the samples as CSV `time_s,current_a,position_mm`, each with its line feed. A position that was not
    /// measured is an empty cell. One line at a time, as all lines can have 60 MB; a value as 1e300 is written short.
    pub fn csv_lines(&self) -> impl Iterator<Item = String> {
        let samples = self.current_a.iter().zip(self.position_mm.iter()).enumerate();
        let lines = samples.map(|(at, (current_a, position_mm))| {
            let (time_s, current_a) = (at as f64 / self.sample_rate_hz, brief(*current_a));
            let position_mm = if position_mm.is_nan() { String::new() } else { brief(*position_mm) };
            format!("{time_s:.7},{current_a},{position_mm}\n")
        });
        iter::once("time_s,current_a,position_mm\n".to_owned()).chain(lines)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_csv_is_short_and_exact_for_any_value() {
        let values = [f64::MAX, f64::MIN, f64::MIN_POSITIVE, 5e-324, -123_456_789.123_456_7, 0.1 + 0.2, 3.0];
        let trace = Trace::new(1e3, values.into(), values.into()).unwrap();
        let lines: Vec<String> = trace.csv_lines().skip(1).collect();
        let read = |line: &String| line.trim().split(',').skip(1).map(|cell| cell.parse::<f64>().unwrap()).collect();
        let read: Vec<Vec<f64>> = lines.iter().map(read).collect();
        assert_eq!(read, values.map(|value| vec![value; 2]));
        assert!(lines.iter().all(|line| line.len() <= 64), "{lines:?}");
        assert_eq!(lines[6], "0.0060000,3,3\n");
        let missing = Trace::new(1e3, vec![f64::NAN], vec![f64::NAN]).unwrap();
        assert_eq!(missing.csv_lines().nth(1).unwrap(), "0.0000000,NaN,\n");
    }

    #[test]
    fn a_trace_is_bounded_and_its_channels_are_equally_long() {
        assert!(Trace::new(1000.0, vec![0.0], vec![f64::NAN]).is_ok());
        let problem = |rate, current, position| Trace::new(rate, current, position).unwrap_err().to_string();
        for rate in [f64::NAN, f64::INFINITY, 0.0, -1.0, 2e6] {
            assert!(problem(rate, vec![0.0], vec![0.0]).starts_with("sample_rate_hz is "));
        }
        assert!(problem(1e3, vec![0.0], vec![]).contains("must be equally long"));
        assert!(problem(1e3, vec![], vec![]).starts_with("0 samples a channel"));
    }
}
