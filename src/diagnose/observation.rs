//! What the monitor is given: one throw, as the diagnosis sees it.

use jiff::Timestamp;
use nalgebra::{Matrix3, Vector3};

use crate::{
    estimate::{Features, Grade},
    throw::{Direction, ThrowRef},
};

/// One throw as the diagnosis sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Boot and number of the throw.
    pub throw: ThrowRef,
    /// Wall time of the first sample.
    pub started_at: Timestamp,
    /// Direction, where known.
    pub direction: Option<Direction>,
    /// (b0, a1, a0) and their covariance; `None` when the estimate was rejected.
    pub estimate: Option<([f64; 3], Matrix3<f64>)>,
    /// Grade of the estimate: a rough one counts for drift and never for a baseline.
    pub grade: Grade,
    /// Only the ratios of the coefficients are known, their common scale is not.
    pub ratios_only: bool,
    /// The points did not complete their movement (obstruction, no detection).
    pub incomplete: bool,
    /// Duration, currents and travel, measured without the model.
    pub features: Features,
    /// Temperature \[°C\], where measured.
    pub temperature_c: Option<f64>,
}

/// What is wrong with the way in which a logger sends its throws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Irregularity {
    /// It sends a recording that it sent before.
    RepeatedTrace,
    /// It counts its throws again from the start under the same `boot_id`.
    RepeatedNumber,
}

/// A throw with a direction and a usable estimate, in logarithms.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Evaluated {
    pub(super) direction: Direction,
    /// ln b0, ln a1, ln a0.
    pub(super) log: [f64; 3],
    /// The estimator's covariance of the logarithms.
    pub(super) sensor: Matrix3<f64>,
    pub(super) grade: Grade,
    pub(super) ratios_only: bool,
    pub(super) temperature_c: Option<f64>,
    pub(super) duration_s: Option<f64>,
}

impl Evaluated {
    /// `None` unless the direction is known and the estimate is positive with a finite, positive covariance.
    pub(super) fn of(observation: &Observation) -> Option<Self> {
        /// Relative standard deviation from which an estimate is useless: its logarithm is no longer linear in it.
        const WORST_SD: f64 = 0.5;
        let (estimate, covariance) = observation.estimate.as_ref()?;
        let direction = observation.direction?;
        if observation.incomplete || !estimate.iter().all(|v| v.is_finite() && *v > 0.0) {
            return None;
        }
        let scale = Matrix3::from_diagonal(&Vector3::from(*estimate).map(f64::recip));
        let sensor = scale * covariance * scale;
        let usable = sensor.iter().all(|v| v.is_finite())
            && sensor.diagonal().iter().all(|v| (0.0..WORST_SD * WORST_SD).contains(v));
        usable.then(|| Self {
            direction,
            log: estimate.map(f64::ln),
            sensor: 0.5 * (sensor + sensor.transpose()),
            grade: observation.grade,
            ratios_only: observation.ratios_only,
            temperature_c: observation.temperature_c.filter(|t| t.is_finite()),
            duration_s: observation.features.duration_s.filter(|d| d.is_finite() && *d > 0.0),
        })
    }
}
