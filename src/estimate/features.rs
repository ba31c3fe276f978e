//! Features of a throw that maintainers know, whether or not a model was identified.

use serde::{Deserialize, Serialize};

/// Features of a throw. Each is `None` where the trace does not show it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Features {
    /// Time from the motor's start to the end of the movement \[s\]; without a position, to the motor's end.
    pub duration_s: Option<f64>,
    /// Time from the motor's start until the toe has moved 0.5 % of its travel \[s\].
    pub release_s: Option<f64>,
    /// Largest magnitude of the current \[A\]. Below 1 kHz it depends on the sampling instants: 13 % from throw to throw.
    pub peak_current_a: Option<f64>,
    /// Median magnitude of the current in the second half of the motor's time \[A\].
    pub running_current_a: Option<f64>,
    /// Mean magnitude of the current while the motor ran \[A\].
    pub mean_current_a: Option<f64>,
    /// Integral of the current's magnitude \[A s\].
    pub charge_as: Option<f64>,
    /// Energy that the motor took \[J\]: charge times supply voltage; needs `supply_v`.
    pub energy_j: Option<f64>,
    /// Mean current while nothing happens \[A\]: the offset of the current sensor.
    pub quiet_current_a: Option<f64>,
    /// Distance moved \[mm\].
    pub travel_mm: Option<f64>,
    /// Toe position before the throw \[mm\].
    pub start_position_mm: Option<f64>,
    /// Toe position at the end of the trace \[mm\].
    pub end_position_mm: Option<f64>,
    /// Mean supply voltage that the logger published \[V\].
    pub supply_v: Option<f64>,
    /// Resistance of armature and leads \[ohm\], from the inrush; needs `supply_v` and the position.
    pub resistance_ohm: Option<f64>,
    /// Back-EMF constant at the screw, (V - R i) / omega in steady state \[V s/rad\]; needs `supply_v` and the position.
    pub back_emf_v_s_per_rad: Option<f64>,
}
