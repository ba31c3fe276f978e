//! Observations: the input of the monitor.

use jiff::Timestamp;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{SensorChannel, statistics::LONGEST_WINDOW};
use crate::{
    estimate,
    estimate::{Estimate, Features, Grade, Identification, Motor, Rejection, RunningRatios},
    throw::{Direction, Throw, ThrowRef},
};

/// A throw as input of the diagnosis.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Observation {
    /// Boot and number of the throw.
    pub throw: ThrowRef,
    /// Wall time of the first sample.
    pub started_at: Timestamp,
    /// Time of reception; `None` in a simulation. A throw that was received before the loss of its logger is no sign of
    /// life, even if it is judged after the loss.
    pub received_at: Option<Timestamp>,
    /// Direction; `None` if unknown.
    pub direction: Option<Direction>,
    /// Whether the measured movement contradicts the direction that the logger names; `None` if one of the two is
    /// unknown.
    pub direction_contradicted: Option<bool>,
    /// The estimate, or why it was rejected; `None` without a usable trace.
    pub outcome: Option<Result<Estimated, Rejection>>,
    /// Duration, currents and travel, measured without the model.
    pub features: Features,
    /// Temperature \[°C\]; `None` if not measured.
    pub temperature_c: Option<f64>,
    /// A sentence about fields of the message with impossible values, which are not used.
    pub unused_fields: Option<String>,
    /// The configured stroke \[mm\] of a complete throw whose travel is too short for it; else `None`.
    pub short_of_stroke_mm: Option<f64>,
    /// Whether the throw began where the one before left the toe open, and moved the toe to where that one began. The
    /// monitor sets it.
    pub began_open: bool,
    /// Running time of the motor and its usual time \[s\], if they differ so much that the points of a machine without
    /// toe position may not have closed. The monitor sets it.
    pub unusual_run_s: Option<[f64; 2]>,
}

/// An estimate as input of the diagnosis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimated {
    /// (b0, a1, a0).
    pub coefficients: [f64; 3],
    /// Their covariance, for a comparison with a baseline.
    pub covariance: Matrix3<f64>,
    /// Grade of the estimate. A rough estimate counts for drifts, not for baselines.
    pub grade: Grade,
    /// Whether only the ratios of the coefficients are known, not their common scale.
    pub ratios_only: bool,
    /// The ratios of a complete estimate as an estimate of ratios only gives them.
    pub running: Option<RunningRatios>,
}

impl Estimated {
    /// A good estimate of all coefficients.
    pub fn new(coefficients: [f64; 3], covariance: Matrix3<f64>) -> Self {
        Self { coefficients, covariance, grade: Grade::Good, ratios_only: false, running: None }
    }

    fn of(estimate: &Estimate) -> Self {
        let &Estimate { grade, ratios_only, running, .. } = estimate;
        let covariance = estimate.drift_covariance(LONGEST_WINDOW);
        Self { coefficients: estimate.coefficients(), covariance, grade, ratios_only, running }
    }
}

impl Observation {
    /// An observation with identity and time only.
    pub fn without_trace(throw: ThrowRef, started_at: Timestamp) -> Self {
        Self { throw, started_at, ..Self::default() }
    }

    /// The observation of a throw, from the result of its identification.
    pub fn of(throw: &Throw, found: &Identification) -> Self {
        Self {
            direction: found.direction,
            direction_contradicted: found.direction_contradicted,
            outcome: Some(found.outcome.as_ref().map(Estimated::of).map_err(Clone::clone)),
            features: found.features.clone(),
            temperature_c: throw.temperature_c,
            unused_fields: found.unused_fields.clone(),
            short_of_stroke_mm: found.short_of_stroke_mm,
            ..Self::without_trace(throw.id.clone(), throw.started_at)
        }
    }

    /// The estimate, if it was not rejected.
    pub fn estimate(&self) -> Option<&Estimated> {
        self.outcome.as_ref()?.as_ref().ok()
    }

    /// Why the estimate was rejected.
    pub(super) fn rejection(&self) -> Option<&Rejection> {
        self.outcome.as_ref()?.as_ref().err()
    }

    /// Whether the points did not complete their movement (obstruction, no detection), or may not have without a toe
    /// position. The short movement of an open toe is complete.
    pub(super) fn is_incomplete(&self) -> bool {
        !self.began_open && (self.unusual_run_s.is_some() || self.rejection().is_some_and(Rejection::is_incomplete))
    }

    /// Whether the points completed a movement over the whole stroke.
    pub(super) fn covers_stroke(&self) -> bool {
        !self.is_incomplete() && !self.began_open
    }

    /// The sensor with unusable values in this throw, and in which way.
    pub(super) fn unusable(&self) -> Option<Unusable> {
        self.faulty_sensor().map(|channel| match self.rejection() {
            Some(Rejection::Clipped { .. }) => Unusable::Clipped,
            Some(Rejection::NoCurrent { .. }) => Unusable::NoCurrent,
            _ => Unusable::Values(channel),
        })
    }

    /// The sensor whose values are impossible, stuck or too noisy in this throw; the clock if the movement lasts too
    /// long.
    pub(super) fn faulty_sensor(&self) -> Option<SensorChannel> {
        match self.rejection()? {
            Rejection::TooSlow { .. } => Some(SensorChannel::Clock),
            reason => reason.faulty_channel().map(Into::into),
        }
    }

    /// Whether the recording has a whole throw, which the points completed. If it begins or ends during the movement,
    /// or the movement began with an open toe, duration and charge are lower bounds.
    pub(super) fn is_whole(&self) -> bool {
        let is_cut_off = matches!(
            self.rejection(),
            Some(Rejection::StartMissing { .. } | Rejection::MovedBeforeCurrent { .. } | Rejection::EndMissing { .. })
        );
        self.covers_stroke() && !is_cut_off
    }

    /// Whether the sampling rate is too low for an estimate. All throws of such a logger have features only.
    pub(super) fn is_undersampled(&self) -> bool {
        matches!(self.rejection(), Some(Rejection::Undersampled { .. }))
    }

    /// Whether the throw has features and no estimate: the machine has a current sensor only, or a three-phase motor.
    pub(super) fn has_features_only(&self) -> bool {
        matches!(self.rejection(), Some(Rejection::NoPosition { .. }))
    }

    /// Whether the coefficients of the throw, if it has any, are not from the toe position.
    pub(super) fn is_current_only(&self) -> bool {
        self.has_features_only() || self.estimate().is_some_and(|estimate| estimate.grade == Grade::CurrentOnly)
    }

    /// Whether the throw has coefficients, or the features of a throw without them.
    pub(super) fn has_result(&self) -> bool {
        self.estimate().is_some() || self.is_current_only()
    }

    /// Whether the throw has no toe position. That of a three-phase motor may have one.
    pub(super) fn is_without_position(&self) -> bool {
        self.is_current_only() && self.features.travel_mm.is_none()
    }
}

/// Why the values of a channel cannot be used in a throw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unusable {
    /// The values are impossible, stuck or too noisy.
    Values(SensorChannel),
    /// The current reaches the end of the measuring range.
    Clipped,
    /// The toe moves, and the current shows no motor.
    NoCurrent,
    /// The position is missing, and the machine had one before.
    Missing,
    /// Measured movement and named direction contradict each other, and did not before.
    Reversed,
}

impl Unusable {
    /// The sensor that the alarm names.
    pub(super) fn channel(self) -> SensorChannel {
        match self {
            Self::Values(channel) => channel,
            Self::Clipped | Self::NoCurrent => SensorChannel::Current,
            Self::Missing | Self::Reversed => SensorChannel::Position,
        }
    }
}

/// An irregularity of a logger.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Irregularity<'a> {
    /// The last messages of the logger were not valid throws.
    Invalid {
        /// Number of these messages.
        count: u32,
        /// Reason why the last of them is not valid.
        reason: &'a str,
    },
    /// The logger sent this recording before, with another throw number.
    RepeatedTrace,
    /// The logger restarted its throw numbers with the same `boot_id`.
    RepeatedNumber,
}

/// A gap: throws of a machine that never arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Missing<'a> {
    /// Number of missing throws.
    pub throws: u64,
    /// Number of them that arrived in a message that was refused.
    pub refused: u64,
    /// Reason of the last refusal; empty if none was refused.
    pub reason: &'a str,
}

impl Missing<'_> {
    /// Largest counted number of missing throws. No machine makes as many, so a larger number is an error of the
    /// logger's counter. The view `data_gaps` has the same bound.
    pub const MOST: u64 = 1 << 40;
}

/// Parameters of a machine on which its coefficients depend.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Parameters {
    /// Stroke \[mm\]. Only coefficients without a toe position depend on it.
    #[serde(skip_serializing_if = "Option::is_none")]
    stroke_mm: Option<f64>,
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
        let &estimate::Settings { stroke_mm, lead_mm, neutral_mm, motor, .. } = settings;
        Self { stroke_mm, lead_mm, neutral_mm, motor }
    }

    /// The parameters with the stroke of those `before`, if they have none: a stroke that is removed and set again is
    /// compared with the last known one.
    pub(super) fn with_last_stroke(self, before: Option<Self>) -> Self {
        Self { stroke_mm: self.stroke_mm.or(before.and_then(|before| before.stroke_mm)), ..self }
    }

    /// The first parameter that differs, with both values; `None` without a difference. A stroke that was not known
    /// before gives the first coefficients, and changes none.
    pub(super) fn changed(&self, to: &Self, has_position: bool) -> Option<String> {
        let known = |from: Option<f64>, to: Option<f64>| from.zip(to).filter(|_| !has_position).unwrap_or_default();
        let (stroke_mm, new_stroke_mm) = known(self.stroke_mm, to.stroke_mm);
        let lengths = [
            ("stroke_mm", stroke_mm, new_stroke_mm),
            ("lead_mm", self.lead_mm, to.lead_mm),
            ("neutral_mm", self.neutral_mm, to.neutral_mm),
        ];
        let mut changed = lengths.into_iter().filter(|(_, from, to)| from.total_cmp(to).is_ne());
        let length = changed.next().map(|(name, from, to)| format!("{name} from {from} to {to}"));
        length.or_else(|| (self.motor != to.motor).then(|| "motor".to_owned()))
    }
}

/// Variance given to the unknown common scale of ratios, so that their covariance can be inverted: as usual scatter.
pub(super) const SCALE_VARIANCE: f64 = 1e-4;

/// A throw with a direction and a usable estimate, in logarithms.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Evaluated {
    pub(super) direction: Direction,
    /// ln b0, ln a1, ln a0.
    pub(super) log: [f64; 3],
    /// The estimator's covariance of `log`.
    pub(super) sensor: Matrix3<f64>,
    pub(super) grade: Grade,
    pub(super) ratios_only: bool,
    /// Logarithms (0, ln a1/b0, ln a0/b0) of a complete estimate as an estimate of ratios only gives them, with their
    /// covariance.
    pub(super) running: Option<([f64; 3], Matrix3<f64>)>,
    pub(super) temperature_c: Option<f64>,
    pub(super) duration_s: Option<f64>,
}

/// Covariance of the differences of all components to the component `fixed`.
pub(super) fn relative_to(fixed: usize, covariance: &Matrix3<f64>) -> Matrix3<f64> {
    let of_fixed = covariance.column(fixed).into_owned();
    Matrix3::from_fn(|i, j| covariance[(i, j)] - of_fixed[i] - of_fixed[j] + of_fixed[fixed])
}

/// Apparent loss of a1 \[1/s\] by a spring whose neutral position is `shift` times the travel nearer to reverse than
/// configured. The spring force differs by a0 dx from the assumed one, where dx is the distance of the two neutral
/// positions. In a steady movement at speed v (equation 12 of the study, without acceleration) this looks like a0 dx /
/// v in a1.
pub(super) fn apparent_friction(shift: f64, direction: Direction, a0: f64, duration_s: f64) -> f64 {
    direction.sign() * shift * duration_s * a0
}

impl Evaluated {
    /// `None` unless the direction is known, and the estimate is positive with a finite and positive covariance.
    pub(super) fn of(observation: &Observation) -> Option<Self> {
        /// Largest relative standard deviation of a usable coefficient or ratio; a larger one makes the logarithm
        /// nonlinear. It must not be small, as a change that doubles a1/b0 may double the error of a0/b0.
        const WORST_SD: f64 = 0.5;
        let &Estimated { coefficients, covariance, grade, ratios_only, running } = observation.estimate()?;
        let direction = observation.direction?;
        if !coefficients.iter().all(|v| v.is_finite() && *v > 0.0) {
            return None;
        }
        let scale = Matrix3::from_diagonal(&Vector3::from(coefficients).map(f64::recip));
        let sensor = scale * covariance * scale;
        // For ratios, the variance of the common scale is an arbitrary large number, so the ratios to b0 are checked.
        let of_scale = |i: usize| if ratios_only { sensor[(0, 0)] - 2.0 * sensor[(0, i)] } else { 0.0 };
        // Most of the error of ratios is a misfit that is equal in every throw of the machine, and cancels in a
        // comparison; the part that differs shows as scatter.
        let most = if ratios_only { f64::from(LONGEST_WINDOW) } else { WORST_SD * WORST_SD };
        let usable = sensor.iter().all(|v| v.is_finite())
            && sensor.diagonal().iter().all(|v| *v >= 0.0)
            && (0..3).all(|i| sensor[(i, i)] + of_scale(i) < most);
        usable.then(|| Self {
            direction,
            log: coefficients.map(f64::ln),
            sensor: 0.5 * (sensor + sensor.transpose()),
            grade,
            ratios_only,
            running: running.map(|RunningRatios { values: [a1, a0], log_covariance }| {
                let mut sensor = Matrix3::zeros();
                sensor.fixed_view_mut::<2, 2>(1, 1).copy_from(&log_covariance);
                ([0.0, a1.ln(), a0.ln()], sensor)
            }),
            temperature_c: observation.temperature_c.filter(|t| t.is_finite()),
            duration_s: observation.features.duration_s.filter(|d| d.is_finite() && *d > 0.0),
        })
    }

    /// The throw for a comparison with a baseline of ratios: the logarithms of b0/b0, a1/b0 and a0/b0. Friction, which
    /// varies most, varies in only one of them. An error that is equal in every throw cancels in this comparison. The
    /// errors of a complete estimate are not those of ratios, so its ratios come from [`Self::running`] if it has them.
    pub(super) fn ratios(self) -> Self {
        let repeats = if self.ratios_only { f64::from(LONGEST_WINDOW) } else { 1.0 };
        let own = || (self.log.map(|log| log - self.log[0]), relative_to(0, &self.sensor) / repeats);
        let (log, sensor) = self.running.unwrap_or_else(own);
        Self { log, sensor: sensor + Matrix3::repeat(SCALE_VARIANCE), ratios_only: true, ..self }
    }

    /// The throw without the effect of a neutral position that is `shift` times the travel nearer to reverse than
    /// configured, or of a position sensor whose normal end is shifted by as much. See [`apparent_friction`].
    pub(super) fn without_shift(self, shift: f64) -> Self {
        let corrected = |(log, sensor): ([f64; 3], Matrix3<f64>)| {
            let [b0, a1, a0] = log;
            let apparent = apparent_friction(shift, self.direction, a0.exp(), self.duration_s.unwrap_or_default());
            let corrected = (a1.exp() + apparent).ln();
            if !corrected.is_finite() {
                return (log, sensor);
            }
            let kept = (a1 - corrected).exp();
            let change = Matrix3::new(1.0, 0.0, 0.0, 0.0, kept, 1.0 - kept, 0.0, 0.0, 1.0);
            ([b0, corrected, a0], change * sensor * change.transpose())
        };
        let (log, sensor) = corrected((self.log, self.sensor));
        Self { log, sensor, running: self.running.map(corrected), ..self }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2;

    use super::*;

    /// A machine of ratios has complete estimates too, whose ratios have other errors: they must not look like a
    /// change.
    #[test]
    fn ratios_of_a_complete_estimate_are_those_of_an_estimate_of_ratios() {
        let running = RunningRatios { values: [0.38, 0.037], log_covariance: Matrix2::identity() * 1e-4 };
        let evaluated = |estimate: Estimated| {
            let outcome = Some(Ok(estimate));
            Evaluated::of(&Observation { direction: Some(Direction::BOTH[0]), outcome, ..Observation::default() })
                .unwrap()
        };
        let estimated = |coefficients| Estimated::new(coefficients, Matrix3::identity() * 1e-4);
        let complete = Estimated { running: Some(running), ..estimated([6.0, 6.0 * 0.38, 6.0 * 0.045]) };
        let complete = evaluated(complete);
        let rough = evaluated(Estimated { ratios_only: true, ..estimated([1.0, 0.38, 0.037]) });
        for shift in [0.0, 0.2] {
            let of = |throw: &Evaluated| throw.clone().without_shift(shift).ratios().log;
            let differences: Vec<f64> = of(&complete).iter().zip(of(&rough)).map(|(a, b)| (a - b).abs()).collect();
            assert!(differences.iter().all(|difference| *difference < 1e-12), "{differences:?} with {shift}");
        }
    }
}
