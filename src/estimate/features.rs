//! Features of a throw: values that maintainers know. Nearly all are known without an estimate of the coefficients.

use serde::Serialize;

use crate::throw::Channel;

/// Features of a throw; `None` if the trace does not show them.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Features {
    /// Time from the start of the motor to the arrival of the toe \[s\]; without a position, to the end of the motor.
    pub duration_s: Option<f64>,
    /// Time from the motor's start until the toe has moved 0.5 % of its travel \[s\].
    pub release_s: Option<f64>,
    /// Delay of the movement behind the current at the start \[s\]. A healthy machine has some milliseconds of either
    /// sign. A brake that releases late, play, lost motion or a late position signal changes it.
    pub start_delay_s: Option<f64>,
    /// b0 from the start of the movement alone, without that delay \[rad s⁻² A⁻¹\]. A brake that drags, or more
    /// inertia, lowers it.
    pub start_gain: Option<f64>,
    /// Largest magnitude of the current \[A\]. Below 1 kHz it depends on the sampling instants and scatters by 13 %.
    pub peak_current_a: Option<f64>,
    /// Mean magnitude of the current from 50 % to 90 % of the motor's running time \[A\].
    pub running_current_a: Option<f64>,
    /// Mean magnitude of the current while the motor ran \[A\].
    pub mean_current_a: Option<f64>,
    /// Current from 98 % to 99.5 % of the travel, less that from 50 % to 85 % \[A\]: the force that closes or locks the
    /// points. It is negative if a spring pulls the toe to the end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end_rise_a: Option<f64>,
    /// Time for which the motor ran after the arrival of the toe \[s\]; needs the position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run_on_s: Option<f64>,
    /// Integral of the current's magnitude \[A s\]; `None` also if one sample of the inrush is more than a tenth of it.
    pub charge_as: Option<f64>,
    /// Time for which the motor ran until the end of a recording that ends before the motor \[s\]: the duration is longer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub driven_s: Option<f64>,
    /// Charge in this time \[A s\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub driven_as: Option<f64>,
    /// Energy that the motor takes from the supply \[J\]: charge times supply voltage; needs `supply_v`.
    pub energy_j: Option<f64>,
    /// Mean current at rest \[A\]: the offset of the current sensor.
    pub quiet_current_a: Option<f64>,
    /// Distance that the toe moved \[mm\].
    pub travel_mm: Option<f64>,
    /// Toe position before the throw \[mm\].
    pub start_position_mm: Option<f64>,
    /// Toe position at the end of the trace \[mm\].
    pub end_position_mm: Option<f64>,
    /// Mean supply voltage in the message \[V\].
    pub supply_v: Option<f64>,
    /// Resistance of armature and leads \[ohm\], from the inrush; needs `supply_v`, and the position or the stroke. For
    /// a series-wound motor whose iron saturates it is too small, and only its changes are used.
    pub resistance_ohm: Option<f64>,
    /// Back-EMF constant K at the screw \[V s/rad\]: (V - R i) / ω in steady state, with supply voltage V, resistance R
    /// and screw speed ω; needs `supply_v`, and the position or the stroke.
    pub back_emf_v_s_per_rad: Option<f64>,
    /// No-load speed of the motor, as speed of the screw, V / K \[rad/s\]. It needs the position, and a voltage that is
    /// constant during the throw, but not its value.
    pub no_load_speed_rad_per_s: Option<f64>,
}

impl Features {
    /// The features without those that depend on the sampling rate.
    pub(super) fn without_times(self) -> Self {
        Self { duration_s: None, release_s: None, run_on_s: None, charge_as: None, ..self }
    }

    /// The features without those that depend on a channel that is not reliable. Single wrong values of the current change
    /// neither the duration nor the current at rest.
    pub(super) fn without(self, channel: Channel) -> Self {
        match channel {
            Channel::Position => Self {
                duration_s: None,
                release_s: None,
                travel_mm: None,
                start_position_mm: None,
                end_position_mm: None,
                end_rise_a: None,
                run_on_s: None,
                ..self
            },
            Channel::Current => Self {
                peak_current_a: None,
                running_current_a: None,
                mean_current_a: None,
                end_rise_a: None,
                charge_as: None,
                ..self
            },
        }
    }
}
