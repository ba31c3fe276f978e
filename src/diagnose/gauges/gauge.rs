//! The gauges, and their values in a throw.

use crate::{diagnose::statistics::rounded, estimate::Features, throw::POSSIBLE_SUPPLY_V};

/// A quantity of a throw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Gauge {
    Travel,
    BackEmf,
    Resistance,
    Duration,
    Volts,
    /// The largest current: about the supply voltage divided by the resistance.
    Inrush,
    /// The mean current between 50 % and 90 % of the time in which the motor is on.
    Running,
    /// The integral of the current, which is the energy of the motor divided by the supply voltage.
    Charge,
    /// Supply voltage divided by back-EMF constant; it can be measured without the supply voltage.
    NoLoadSpeed,
    /// Delay of the start \[ms\], as a difference and not as a logarithm, as it has either sign.
    StartDelay,
    /// Acceleration per ampere at the start of the movement: b0 of the start alone.
    StartGain,
    /// Mean current at rest \[A\], as a difference and not as a logarithm, as it has either sign.
    Rest,
    /// Middle between the positions at start and end \[mm\], as a difference: it shifts with the zero of the position
    /// sensor.
    Middle,
    /// Published temperature \[°C\], as a difference.
    Air,
}

/// The gauges of a throw, in the order of [`Gauge`], as [`values`] gives them; `None` for unknown ones.
pub(super) type Values = [Option<f32>; Gauge::COUNT];

/// Temperature coefficient of the resistance of copper \[1/K\], and reference temperature \[°C\].
const COPPER: (f64, f64) = (0.0039, 20.0);

impl Gauge {
    pub(super) const COUNT: usize = 14;

    /// Least standard deviation of a level: the effect of sampling, adjustment and temperature on a healthy machine.
    pub(crate) fn floor(self) -> f64 {
        match self {
            Self::Travel => 0.003,
            Self::BackEmf => 0.005,
            Self::Resistance | Self::Duration | Self::Volts | Self::NoLoadSpeed => 0.01,
            Self::Inrush | Self::Running | Self::Charge | Self::StartGain | Self::Rest => 0.02,
            Self::StartDelay | Self::Middle => 0.2,
            Self::Air => 0.0,
        }
    }

    /// Whether the weather changes the gauge by more than some percent: cold stiffens the drive.
    pub(crate) fn follows_weather(self) -> bool {
        matches!(self, Self::Running | Self::Charge)
    }

    /// Sign of the gauge's change when the field of the magnets grows; 0 if the field has no effect.
    pub(super) fn sign_of_magnets(self) -> f64 {
        match self {
            Self::BackEmf => 1.0,
            Self::NoLoadSpeed => -1.0,
            _ => 0.0,
        }
    }
}

/// Change of the logarithm of a copper resistance with a change of its temperature.
pub(super) fn heat(kelvin: f64) -> f64 {
    (COPPER.0 * kelvin).ln_1p()
}

/// The gauges of a throw, as logarithms except for the delay of the start \[ms\], the current at rest \[A\], the middle
/// \[mm\] and the temperature \[°C\].
pub(super) fn values(features: &Features, celsius: Option<f64>) -> Values {
    let warm = celsius.map_or(1.0, |celsius| 1.0 + COPPER.0 * (celsius - COPPER.1));
    let ln = |value: Option<f64>| value.map(f64::ln);
    let shown = [
        ln(features.travel_mm),
        ln(features.back_emf_v_s_per_rad),
        ln(features.resistance_ohm.map(|ohm| ohm / warm)),
        ln(features.duration_s),
        // The voltage of a failed sensor counts as unknown.
        ln(features.supply_v.filter(|volts| POSSIBLE_SUPPLY_V.contains(volts))),
        ln(features.peak_current_a),
        ln(features.running_current_a),
        ln(features.charge_as),
        ln(features.no_load_speed_rad_per_s),
        features.start_delay_s.map(|delay_s| 1e3 * delay_s),
        ln(features.start_gain),
        features.quiet_current_a,
        features.start_position_mm.zip(features.end_position_mm).map(|(start, end)| f64::midpoint(start, end)),
        celsius,
    ];
    shown.map(|value| value.map(rounded).filter(|value| value.is_finite()))
}
