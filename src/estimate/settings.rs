//! Settings of the estimator for a machine.

use serde::{Deserialize, Serialize};

use crate::throw::{Range::Within, settings};

/// Torque law of the motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Motor {
    /// Torque proportional to the current; the input of the model is I.
    #[default]
    PermanentMagnet,
    /// Field and armature in series: torque proportional to I |I|, the input of the model.
    Series,
    /// Three-phase induction: the current does not show the torque, so a throw has features only.
    ThreePhase,
}

settings! {
    /// Parameters of a machine and its sensors that the estimator needs; the `[machines]` section of the configuration.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Settings {
        /// Ball-screw lead \[mm per revolution\], 0.5 to 500.
        pub lead_mm: f64 = 10.0, Within(0.5, 500.0, "mm");
        /// Toe position at which the rails are unstressed \[mm from normal\], -1,000 to 1,000.
        pub neutral_mm: f64 = 0.0, Within(-1_000.0, 1_000.0, "mm");
        /// Nominal stroke \[mm\], 1 to 1,000; `None` if unknown. A throw of less than 95 % of it is incomplete. But if
        /// a throw of more than 85 % ends as a complete one, the gain of the position sensor, or this setting, is
        /// wrong. A throw is obstructed if the motor drives a standing toe for half a second, unless 98 % of a known
        /// stroke are done.
        pub stroke_mm: Option<f64> = None, Within(1.0, 1_000.0, "mm");
        /// Torque law of the motor.
        pub motor: Motor = Motor::PermanentMagnet;
        /// Standard deviation of the current sensor's noise \[A\], 0.000001 to 10. Stands in for the measured noise
        /// of a trace without quiet samples; a trace with more than 3.5 times this noise is rough.
        pub current_noise_a: f64 = 0.02, Within(1e-6, 10.0, "A");
        /// Standard deviation of the position sensor's noise \[mm\], 0.000001 to 10. Stands in for the measured noise
        /// of a trace without quiet samples; a trace with more than 25 times this noise is rough.
        pub position_noise_mm: f64 = 0.02, Within(1e-6, 10.0, "mm");
        /// Least fit `R²_T` of an accepted estimate \[%\], 0 to 100.
        pub fit_floor_pct: f64 = 98.0, Within(0.0, 100.0, "%");
        /// Whether to refine each estimate with a prefilter for the noise. This halves the scatter if the noise is
        /// white.
        pub refined: bool = false;
    }
}

impl Settings {
    /// Angle of the screw for 1 mm of toe travel \[rad/mm\].
    pub(super) fn radians_per_mm(&self) -> f64 {
        std::f64::consts::TAU / self.lead_mm
    }
}
