//! Settings of the estimator for a machine.

use serde::{Deserialize, Serialize};

use crate::throw::OutOfRange;

/// Torque law of the motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Motor {
    /// Torque proportional to the current; the input of the model is I.
    #[default]
    PermanentMagnet,
    /// Field and armature in series: torque proportional to I |I|, the input of the model.
    Series,
}

/// Parameters of a machine and its sensors; the `[machines]` section of the configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Ball-screw lead \[mm per revolution\], 0.5 to 500.
    pub lead_mm: f64,
    /// Toe position at which the rails are unstressed \[mm from normal\], -1,000 to 1,000.
    pub neutral_mm: f64,
    /// Nominal stroke \[mm\], 1 to 1,000; `None` if unknown. A throw below 95 % of it is incomplete, unless it
    /// ends as a complete one (above 85 %): then the gain of the sensor, or this stroke, is wrong. A motor that drives a
    /// standing toe for half a second is an obstruction, unless 98 % of a known stroke are done.
    pub stroke_mm: Option<f64>,
    /// Kind of motor.
    pub motor: Motor,
    /// Standard deviation of the current sensor's noise \[A\], 0.000001 to 10; used when the trace has no quiet samples.
    pub current_noise_a: f64,
    /// Standard deviation of the position sensor's noise \[mm\], 0.000001 to 10; used when the trace has no quiet samples.
    pub position_noise_mm: f64,
    /// Least fit `R²_T` of an accepted estimate \[%\], 0 to 100.
    pub fit_floor_pct: f64,
    /// Whether to refine each estimate with a prefilter for the noise; halves the scatter if the noise is white.
    pub refined: bool,
}

impl Settings {
    /// Checks every range.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        OutOfRange::check([
            ("lead_mm", self.lead_mm, 0.5, 500.0, "mm"),
            ("neutral_mm", self.neutral_mm, -1_000.0, 1_000.0, "mm"),
            ("stroke_mm", self.stroke_mm.unwrap_or(1.0), 1.0, 1_000.0, "mm"),
            ("current_noise_a", self.current_noise_a, 1e-6, 10.0, "A"),
            ("position_noise_mm", self.position_noise_mm, 1e-6, 10.0, "mm"),
            ("fit_floor_pct", self.fit_floor_pct, 0.0, 100.0, "%"),
        ])
    }
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
