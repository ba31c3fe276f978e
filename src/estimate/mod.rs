//! From one throw to b0, a1, a0 with their covariance (SRIV, continuous time).

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use crate::throw::{Direction, Throw};

/// How a machine's motor turns current into torque.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Motor {
    /// Torque proportional to the current: the model's input is I.
    #[default]
    PermanentMagnet,
    /// Field and armature in series: torque proportional to I |I|, which is the model's input.
    Series,
}

/// What the estimator has to know of a machine and its sensors.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Ball-screw lead \[mm per revolution\].
    pub lead_mm: f64,
    /// Toe position at which the rails are unstressed \[mm from normal\].
    pub neutral_mm: f64,
    /// Nominal stroke \[mm\]; `None` when unknown, and then only the trace itself tells an incomplete throw.
    pub stroke_mm: Option<f64>,
    /// Kind of motor.
    pub motor: Motor,
    /// Standard deviation of the current sensor's noise \[A\], used when the trace has no quiet samples.
    pub current_noise_a: f64,
    /// Standard deviation of the position sensor's noise \[mm\], used when the trace has no quiet samples.
    pub position_noise_mm: f64,
    /// Least fit R²_T of an accepted estimate \[%\].
    pub fit_floor_pct: f64,
    /// Use the noise-matched prefilter.
    pub refined: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            lead_mm: 10.0,
            neutral_mm: 0.0,
            stroke_mm: None,
            motor: Motor::PermanentMagnet,
            current_noise_a: 0.02,
            position_noise_mm: 0.02,
            fit_floor_pct: 98.0,
            refined: false,
        }
    }
}

/// The coefficients of equation (12) for one throw, with their covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// KT / J \[rad s⁻² A⁻¹\] (rad s⁻² A⁻² for a series motor).
    pub b0: f64,
    /// Kf / J \[s⁻¹\].
    pub a1: f64,
    /// Kspr / J \[s⁻²\].
    pub a0: f64,
    /// Covariance of (b0, a1, a0), in their units.
    pub covariance: Matrix3<f64>,
    /// R²_T \[%\].
    pub fit_pct: f64,
    /// SRIV iterations.
    pub iterations: usize,
    /// First sample used, from the start of the trace \[s\].
    pub start_s: f64,
    /// Last sample used, from the start of the trace \[s\].
    pub end_s: f64,
}

/// What maintainers know of a throw, whether or not a model was identified. `None` where the trace does not tell.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Features {
    /// Time from the motor's start to the end of the movement \[s\].
    pub duration_s: Option<f64>,
    /// Largest magnitude of the current \[A\].
    pub peak_current_a: Option<f64>,
    /// Mean magnitude of the current while the motor ran \[A\].
    pub mean_current_a: Option<f64>,
    /// Integral of the current's magnitude \[A s\].
    pub charge_as: Option<f64>,
    /// Distance moved \[mm\].
    pub travel_mm: Option<f64>,
    /// Toe position at the end of the trace \[mm\].
    pub end_position_mm: Option<f64>,
}

/// Why a throw was not evaluated. `Display` is one sentence for a person; [`Rejection::code`] is stable for programs.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Rejection {
    /// The toe did not move.
    #[error("the toe did not move")]
    NoMovement,
}

impl Rejection {
    /// The stable word for programs, as in the column `quality`.
    #[must_use]
    pub fn code(&self) -> &'static str {
        match self {
            Self::NoMovement => "no_movement",
        }
    }

    /// Whether the machine, not the sensors, is to blame: the points did not complete their movement.
    #[must_use]
    pub fn is_incomplete(&self) -> bool {
        matches!(self, Self::NoMovement)
    }
}

/// All that one throw tells.
#[derive(Debug, Clone, PartialEq)]
pub struct Identification {
    /// The direction of the movement: from the position; the declared one when the position does not tell.
    pub direction: Option<Direction>,
    /// The logger declared the other direction than the toe moved.
    pub direction_contradicted: bool,
    /// What maintainers know of a throw.
    pub features: Features,
    /// The estimate, or why there is none.
    pub outcome: Result<Estimate, Rejection>,
}

/// Identifies throws one after the other, reusing its work buffers.
#[derive(Debug, Default)]
pub struct Identifier {}

impl Identifier {
    /// Identifies one throw. Never panics, whatever the trace holds.
    pub fn identify(&mut self, throw: &Throw, settings: &Settings) -> Identification {
        let _ = settings;
        Identification {
            direction: throw.direction,
            direction_contradicted: false,
            features: Features::default(),
            outcome: Err(Rejection::NoMovement),
        }
    }
}
