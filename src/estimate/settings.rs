//! What the estimator has to know of a machine and its sensors.

use serde::{Deserialize, Serialize};

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
    /// Least fit `R²_T` of an accepted estimate \[%\].
    pub fit_floor_pct: f64,
    /// Refine each estimate with the prefilter that matches the noise: half the scatter, where the noise is white.
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
