//! What maintainers know of a throw, whether or not a model was identified.

use serde::{Deserialize, Serialize};

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
