//! Features of a throw, with or without an estimate.

use serde::{Deserialize, Serialize};

use super::{rejection::Channel, settings::Motor};

/// Features of a throw; `None` if the trace does not show them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Features {
    /// Time from the start of the motor to the end of the movement \[s\]; without a position, to the end of the motor.
    pub duration_s: Option<f64>,
    /// Time from the motor's start until the toe has moved 0.5 % of its travel \[s\].
    pub release_s: Option<f64>,
    /// Delay of the movement behind the current at the start \[s\]; of a healthy machine some milliseconds of either sign.
    /// A late brake, play, lost motion and a position behind the current change it.
    pub start_delay_s: Option<f64>,
    /// b0 of the start alone, without that delay \[rad s⁻² A⁻¹\]. A brake that drags, and inertia, lower it.
    pub start_gain: Option<f64>,
    /// Largest magnitude of the current \[A\]. Below 1 kHz it depends on the sampling instants and scatters by 13 %.
    pub peak_current_a: Option<f64>,
    /// Mean magnitude of the current from the half to nine tenths of the time of the motor \[A\].
    pub running_current_a: Option<f64>,
    /// Mean magnitude of the current while the motor ran \[A\].
    pub mean_current_a: Option<f64>,
    /// Integral of the current's magnitude \[A s\]; unknown if one sample of the inrush is more than a tenth of it.
    pub charge_as: Option<f64>,
    /// Energy of the motor \[J\]: charge times supply voltage; needs `supply_v`.
    pub energy_j: Option<f64>,
    /// Mean current at rest \[A\]: the offset of the current sensor.
    pub quiet_current_a: Option<f64>,
    /// Distance moved \[mm\].
    pub travel_mm: Option<f64>,
    /// Toe position before the throw \[mm\].
    pub start_position_mm: Option<f64>,
    /// Toe position at the end of the trace \[mm\].
    pub end_position_mm: Option<f64>,
    /// Mean supply voltage in the message \[V\].
    pub supply_v: Option<f64>,
    /// Resistance of armature and leads \[ohm\], from the inrush; needs `supply_v` and the position.
    pub resistance_ohm: Option<f64>,
    /// Back-EMF constant at the screw, (V - R i) / omega in steady state \[V s/rad\]; needs `supply_v` and the position.
    pub back_emf_v_s_per_rad: Option<f64>,
    /// No-load speed of the motor at the screw, V / K \[rad/s\]: the supply voltage over the back-EMF constant, without
    /// knowing either; needs the position, and a voltage that is constant during the throw.
    pub no_load_speed_rad_per_s: Option<f64>,
    /// The kind of motor that current and speed show, whatever the settings say; needs the position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motor: Option<Motor>,
}

impl Features {
    /// The features without those that follow from a channel.
    pub(super) fn without(self, channel: Channel) -> Self {
        match channel {
            Channel::Position => Self {
                duration_s: None,
                release_s: None,
                travel_mm: None,
                start_position_mm: None,
                end_position_mm: None,
                ..self
            },
            Channel::Current => {
                Self { peak_current_a: None, running_current_a: None, mean_current_a: None, charge_as: None, ..self }
            }
        }
    }
}
