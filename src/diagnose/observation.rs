//! Observations: the input of the monitor.

use jiff::Timestamp;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::event::SensorChannel;
use crate::{
    estimate::{self, Estimate, Features, Grade, Identification, Motor, Rejection},
    throw::{Direction, Throw, ThrowRef},
};

/// A throw as input of the diagnosis.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Observation {
    /// Boot and number of the throw.
    pub throw: ThrowRef,
    /// Wall time of the first sample.
    pub started_at: Timestamp,
    /// When it was received: judged after the loss of its logger, a throw received earlier is no sign of life. `None` for a
    /// throw without a logger.
    pub received_at: Option<Timestamp>,
    /// Direction; `None` if unknown.
    pub direction: Option<Direction>,
    /// Whether the movement contradicts the direction that the logger names; `None` if the movement has no direction.
    pub direction_contradicted: Option<bool>,
    /// (b0, a1, a0) and their covariance; `None` when the estimate was rejected.
    pub estimate: Option<([f64; 3], Matrix3<f64>)>,
    /// (b0, a1, a0) of an estimate that was rejected because one of them is not positive.
    pub not_positive: Option<[f64; 3]>,
    /// Grade of the estimate; a rough one counts for drifts, not for baselines.
    pub grade: Grade,
    /// Whether only the ratios of the coefficients are known.
    pub ratios_only: bool,
    /// Whether the points did not complete their movement (obstruction, no detection).
    pub incomplete: bool,
    /// The sensor whose values are impossible, stuck or too noisy in this throw, or the clock of the recording.
    pub faulty: Option<SensorChannel>,
    /// Whether the machine has a current sensor only, and its coefficients cannot be determined.
    pub features_only: bool,
    /// Duration, currents and travel, measured without the model.
    pub features: Features,
    /// Temperature \[°C\]; `None` if not measured.
    pub temperature_c: Option<f64>,
    /// Code of the reason why the estimate was rejected.
    pub rejected: Option<&'static str>,
    /// A sentence about the fields of the message whose values are not possible.
    pub unused_fields: Option<String>,
    /// The configured stroke \[mm\], if the travel is too short for it although the throw ended as a complete one.
    pub short_of_stroke_mm: Option<f64>,
}

impl Observation {
    /// An observation of which only identity and time are known.
    pub fn without_trace(throw: ThrowRef, started_at: Timestamp) -> Self {
        Self { throw, started_at, ..Self::default() }
    }

    /// The observation of a throw, with what the estimator found in it.
    pub fn of(throw: &Throw, found: &Identification) -> Self {
        let (estimate, rejection) = (found.outcome.as_ref().ok(), found.outcome.as_ref().err());
        Self {
            direction: found.direction,
            direction_contradicted: found.direction.map(|_| found.direction_contradicted),
            estimate: estimate.map(|estimate| (estimate.coefficients(), estimate.drift_covariance())),
            not_positive: rejection.and_then(|reason| match reason {
                Rejection::NotPositive { b0, a1, a0 } => Some([*b0, *a1, *a0]),
                _ => None,
            }),
            grade: estimate.map(|estimate| estimate.grade).unwrap_or_default(),
            ratios_only: estimate.is_some_and(|estimate| estimate.ratios_only),
            incomplete: rejection.is_some_and(Rejection::is_incomplete),
            faulty: rejection.and_then(|reason| match reason {
                Rejection::TooSlow { .. } => Some(SensorChannel::Clock),
                _ => reason.faulty_channel().map(Into::into),
            }),
            features_only: matches!(rejection, Some(Rejection::NoPosition { .. })),
            features: found.features.clone(),
            temperature_c: throw.temperature_c,
            rejected: rejection.map(Rejection::code),
            unused_fields: found.unused_fields.clone(),
            short_of_stroke_mm: found.short_of_stroke_mm,
            ..Self::without_trace(throw.id.clone(), throw.started_at)
        }
    }

    /// Whether the recording begins or ends during the movement, so that its duration and charge are lower bounds.
    pub(super) fn is_cut_off(&self) -> bool {
        let cut_off = [Rejection::StartMissing { current_a: 0.0 }, Rejection::EndMissing { travel_mm: 0.0 }];
        cut_off.iter().any(|reason| self.rejected == Some(reason.code()))
    }

    /// Whether the recording is too slow for an estimate, which is a property of the logger: its throws have features only.
    pub(super) fn is_too_slow(&self) -> bool {
        self.rejected == Some(Rejection::Undersampled { interval_s: 0.0, rise_samples: 0 }.code())
    }

    /// Whether the throw has no toe position.
    pub(super) fn is_without_position(&self) -> bool {
        self.features_only || self.estimate.is_some() && self.grade == Grade::CurrentOnly
    }
}

/// Why the values of a channel cannot be used in a throw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unusable {
    /// They are impossible, stuck or too noisy.
    Values(SensorChannel),
    /// The position is missing, on a machine with a toe sensor.
    Missing,
    /// The movement and the direction that the logger names contradict each other, unlike before.
    Reversed,
}

impl Unusable {
    /// The channel of the alarm.
    pub(super) fn channel(self) -> SensorChannel {
        match self {
            Self::Values(channel) => channel,
            Self::Missing | Self::Reversed => SensorChannel::Position,
        }
    }
}

/// An irregularity of a logger.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Irregularity<'a> {
    /// The last messages of the logger are not valid throws.
    Invalid {
        /// Number of these messages.
        count: u32,
        /// Reason of the last one.
        reason: &'a str,
    },
    /// The logger sent the same recording before.
    RepeatedTrace,
    /// The logger restarted its throw numbers with the same `boot_id`.
    RepeatedNumber,
}

/// Throws of a machine that are missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Missing<'a> {
    /// Number of missing throws.
    pub throws: u64,
    /// Of these, throws whose messages were refused.
    pub refused: u64,
    /// Reason of the last refusal; empty without one.
    pub reason: &'a str,
}

impl Missing<'_> {
    /// Largest number of missing throws that is counted: no logger makes as many, so its counter is wrong. The view `data_gaps`
    /// has the same bound.
    pub const MOST: u64 = 1 << 40;
}

/// The parameters of a machine that scale its coefficients.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Parameters {
    /// Ball-screw lead \[mm per revolution\].
    lead_mm: f64,
    /// Toe position at which the rails are unstressed \[mm from normal\].
    pub(super) neutral_mm: f64,
    /// Kind of motor.
    pub(super) motor: Motor,
}

impl Parameters {
    /// The parameters in the settings of the estimator.
    pub fn of(settings: &estimate::Settings) -> Self {
        Self { lead_mm: settings.lead_mm, neutral_mm: settings.neutral_mm, motor: settings.motor }
    }

    /// The first parameter that differs, with its values; `None` without a difference.
    pub(super) fn changed(&self, to: &Self) -> Option<String> {
        let lengths = [("lead_mm", self.lead_mm, to.lead_mm), ("neutral_mm", self.neutral_mm, to.neutral_mm)];
        let mut changed = lengths.into_iter().filter(|(_, from, to)| from.total_cmp(to).is_ne());
        let length = changed.next().map(|(name, from, to)| format!("{name} from {from} to {to}"));
        length.or_else(|| (self.motor != to.motor).then(|| "motor".to_owned()))
    }
}

/// Variance of the common scale of ratios, which has no meaning: any of the size of the usual scatter, so that the covariance
/// can be inverted.
pub(super) const SCALE_VARIANCE: f64 = 1e-4;

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

/// The covariance of differences to the component `fixed`.
pub(super) fn relative_to(fixed: usize, covariance: &Matrix3<f64>) -> Matrix3<f64> {
    let of_fixed = covariance.column(fixed).into_owned();
    Matrix3::from_fn(|i, j| covariance[(i, j)] - of_fixed[i] - of_fixed[j] + of_fixed[fixed])
}

/// Apparent loss of a1 by a spring that is unstressed `shift` times the travel nearer to reverse than configured: it seems to be
/// stressed by k dx less in a throw to reverse and more in one to normal, which in a steady movement (equation 12 without
/// acceleration) is a0 dx / v.
pub(super) fn seeming_friction(shift: f64, direction: Direction, a0: f64, duration_s: f64) -> f64 {
    direction.sign() * shift * duration_s * a0
}

impl Evaluated {
    /// `None` unless the direction is known and the estimate is positive with a finite, positive covariance.
    pub(super) fn of(observation: &Observation) -> Option<Self> {
        /// Largest relative standard deviation of a usable estimate, or ratio; above it the logarithm is not linear. A
        /// change that doubles a1/b0 may double the error of a0/b0 too.
        const WORST_SD: f64 = 0.5;
        let (estimate, covariance) = observation.estimate.as_ref()?;
        let direction = observation.direction?;
        if observation.incomplete || !estimate.iter().all(|v| v.is_finite() && *v > 0.0) {
            return None;
        }
        let scale = Matrix3::from_diagonal(&Vector3::from(*estimate).map(f64::recip));
        let sensor = scale * covariance * scale;
        // Of ratios, the variance of the common scale is only a large number.
        let of_scale = |i: usize| if observation.ratios_only { sensor[(0, 0)] - 2.0 * sensor[(0, i)] } else { 0.0 };
        let repeats = if observation.ratios_only { Estimate::LONGEST_WINDOW } else { 1.0 };
        let most = repeats * WORST_SD * WORST_SD;
        let usable = sensor.iter().all(|v| v.is_finite())
            && sensor.diagonal().iter().all(|v| *v >= 0.0)
            && (0..3).all(|i| sensor[(i, i)] + of_scale(i) < most);
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

    /// The ratios of the throw, for a baseline of ratios: the logarithms of b0/b0, a1/b0, a0/b0, so that friction, which varies
    /// most, varies in one of them. Errors that are equal in every throw cancel in a comparison with such a baseline.
    pub(super) fn ratios(self) -> Self {
        let repeats = if self.ratios_only { Estimate::LONGEST_WINDOW } else { 1.0 };
        Self {
            log: self.log.map(|log| log - self.log[0]),
            sensor: relative_to(0, &self.sensor) / repeats + Matrix3::repeat(SCALE_VARIANCE),
            ratios_only: true,
            ..self
        }
    }

    /// The same throw without the effect of a spring that is unstressed `shift` times the travel nearer to reverse than configured,
    /// or of a position sensor that reads the normal end shifted by this.
    pub(super) fn without_shift(self, shift: f64) -> Self {
        let [b0, a1, a0] = self.log;
        let seeming = seeming_friction(shift, self.direction, a0.exp(), self.duration_s.unwrap_or_default());
        let corrected = (a1.exp() + seeming).ln();
        if !corrected.is_finite() {
            return self;
        }
        let kept = (a1 - corrected).exp();
        let change = Matrix3::new(1.0, 0.0, 0.0, 0.0, kept, 1.0 - kept, 0.0, 0.0, 1.0);
        Self { log: [b0, corrected, a0], sensor: change * self.sensor * change.transpose(), ..self }
    }
}
