//! The result of the estimator for a throw: its estimate or the reason why there is none, and its features.

use nalgebra::{Matrix2, Matrix3, Vector3};

use super::{features::Features, rejection::Rejection};
use crate::throw::Direction;

/// How far an estimate can be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum Grade {
    /// The model fits the throw; the covariance is that of the sensors' noise.
    #[default]
    Good,
    /// The movement departs from the model in a way that a machine can cause, and the covariance includes this
    /// departure. The diagnosis compares the estimate with a baseline, but learns no baseline of all three coefficients
    /// from it.
    Rough,
    /// Estimated without a toe position, from current and supply voltage.
    CurrentOnly,
}

impl Grade {
    /// The word in messages and in the column `quality`.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// The coefficients of equation (12) for one throw, with their covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Trust in the estimate.
    pub grade: Grade,
    /// KT / J \[rad s⁻² A⁻¹\] (rad s⁻² A⁻² for a series motor).
    pub b0: f64,
    /// Kf / J \[s⁻¹\].
    pub a1: f64,
    /// Kspr / J \[s⁻²\].
    pub a0: f64,
    /// Whether only the ratios a1/b0 and a0/b0 are known, as the start of the throw is unusable. Then b0 is set to 1,
    /// with a large variance.
    pub ratios_only: bool,
    /// Covariance of (b0, a1, a0) from the sensors' noise, which differs in each throw.
    pub covariance: Matrix3<f64>,
    /// Covariance of the errors of (b0, a1, a0) that the sensors do not cause. Dry friction in the viscous model, and a
    /// possible brake at the start, act equally in every throw of a machine. A random load is part of the scatter of
    /// its baseline. So a comparison with a baseline does not contain these errors.
    pub systematic: Matrix3<f64>,
    /// Errors of (b0, a1, a0) for one standard deviation of the part of the current at rest that the machine does not
    /// draw in motion. They are equal in every throw of a machine, and change the ratios as well.
    pub offset: [f64; 3],
    /// Why the estimate is rough: the check that the throw did not pass. `None` if it is not rough.
    pub reason: Option<Rejection>,
    /// The ratios of a complete estimate as an estimate of ratios only gives them, without the start of the throw. Where
    /// the model fits roughly, both have other errors. So a machine that is compared by ratios compares these.
    pub running: Option<RunningRatios>,
    /// Fit of the model of all three coefficients; `None` if the estimate is from the current alone, or this model has
    /// no solution.
    pub fit: Option<Fit>,
    /// First sample used, from the start of the trace \[s\].
    pub start_s: f64,
    /// Last sample used, from the start of the trace \[s\].
    pub end_s: f64,
}

/// The fit of a model to a throw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// `R²_T` \[%\]: 100 minus the share of the output's variance that the model does not explain.
    pub pct: f64,
    /// Number of SRIV iterations.
    pub iterations: usize,
}

/// The ratios of a throw from its movement after the start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunningRatios {
    /// a1/b0 and a0/b0.
    pub values: [f64; 2],
    /// Covariance of their logarithms.
    pub log_covariance: Matrix2<f64>,
}

impl Estimate {
    /// (b0, a1, a0).
    pub fn coefficients(&self) -> [f64; 3] {
        [self.b0, self.a1, self.a0]
    }

    /// Covariance of the whole error of (b0, a1, a0), from noise and model.
    pub fn total_covariance(&self) -> Matrix3<f64> {
        let offset = Vector3::from(self.offset);
        self.covariance + self.systematic + offset * offset.transpose()
    }

    /// Covariance of (b0, a1, a0) for a comparison with a baseline.
    ///
    /// For a complete estimate this is `covariance`: the errors that are equal in every throw (`systematic`) cancel.
    ///
    /// For an estimate of ratios only, the equal errors do not cancel, as the baseline may consist of complete
    /// estimates. The errors in `covariance` come from the misfit of the model, which repeats from throw to throw. Both
    /// kinds of errors do not average out over the `throws` of a window, so their covariance is multiplied by this
    /// number.
    pub fn drift_covariance(&self, throws: u32) -> Matrix3<f64> {
        if !self.ratios_only {
            return self.covariance;
        }
        let coefficients = Vector3::from(self.coefficients()) / self.b0;
        let of_scale = self.covariance[(0, 0)] * coefficients * coefficients.transpose();
        of_scale + f64::from(throws) * (self.covariance - of_scale + self.systematic)
    }

    /// Standard deviations of the whole error of (b0, a1, a0).
    pub fn sd(&self) -> [f64; 3] {
        let variances: Vector3<f64> = self.total_covariance().diagonal();
        variances.map(f64::sqrt).into()
    }

    /// a1/b0 and a0/b0.
    pub fn ratios(&self) -> [f64; 2] {
        [self.a1 / self.b0, self.a0 / self.b0]
    }

    /// Standard deviations of [`Self::ratios`], from the whole error.
    pub fn ratios_sd(&self) -> [f64; 2] {
        let c = self.total_covariance();
        let ratios = self.ratios();
        let of = |i: usize| {
            let value = ratios[i - 1];
            (c[(i, i)] - 2.0 * value * c[(0, i)] + value * value * c[(0, 0)]).max(0.0).sqrt() / self.b0
        };
        [of(1), of(2)]
    }
}

/// The result of the estimator for a throw.
#[derive(Debug, Clone, PartialEq)]
pub struct Identification {
    /// Direction of the movement from the position, or the direction that the logger declared if the position does not
    /// show it.
    pub direction: Option<Direction>,
    /// Whether the measured movement contradicts the direction that the logger names; `None` if one of the two is
    /// unknown.
    pub direction_contradicted: Option<bool>,
    /// Features of the throw.
    pub features: Features,
    /// The estimate or the rejection.
    pub outcome: Result<Estimate, Rejection>,
    /// A sentence about the fields of the message whose values are not possible; `None` if there are none.
    pub unused_fields: Option<String>,
    /// The configured stroke \[mm\], if the travel is below 95 % of it although the throw ended as a complete one: the
    /// gain of the position sensor, or the configured stroke, is wrong.
    pub short_of_stroke_mm: Option<f64>,
}

impl Identification {
    /// The word in the column `quality`: the grade, or the code of the rejection.
    pub fn quality(&self) -> &'static str {
        self.outcome.as_ref().map_or_else(Rejection::code, |estimate| estimate.grade.as_str())
    }

    /// Why the throw is rejected or rough.
    pub fn reason(&self) -> Option<&Rejection> {
        self.outcome.as_ref().map_or_else(Some, |estimate| estimate.reason.as_ref())
    }

    /// Why the throw is rejected or rough, and which fields of its message are not used, as a sentence.
    pub fn detail(&self) -> Option<String> {
        let short = self.short_of_stroke_mm.map(|stroke_mm| {
            format!("the throw ended as a complete one before the stroke of {stroke_mm} mm: position gain or stroke_mm is wrong")
        });
        let parts: Vec<String> =
            self.reason().map(ToString::to_string).into_iter().chain(short).chain(self.unused_fields.clone()).collect();
        (!parts.is_empty()).then(|| parts.join("; "))
    }
}
