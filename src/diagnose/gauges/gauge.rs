//! The gauges, and their values in a throw.

use strum::VariantArray;

use crate::{diagnose::statistics::to_rounded_f32, estimate::Features, throw::POSSIBLE_SUPPLY_V};

/// A quantity of a throw.
#[derive(Debug, Clone, Copy, PartialEq, Eq, VariantArray)]
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
    /// Current at the end of the stroke, less the running current \[A\], as a difference.
    EndRise,
}

/// The gauges of a throw, in the order of [`Gauge`]; `None` for unknown ones.
pub(super) type Values = [Option<f32>; Gauge::COUNT];

/// Temperature coefficient of the resistance of copper \[1/K\], and reference temperature \[°C\].
const COPPER: (f64, f64) = (0.0039, 20.0);

impl Gauge {
    pub(super) const COUNT: usize = Self::VARIANTS.len();

    /// The gauge in a throw, as a logarithm unless it is a difference.
    fn value(self, features: &Features, celsius: Option<f64>) -> Option<f64> {
        let warm = celsius.map_or(1.0, |celsius| 1.0 + COPPER.0 * (celsius - COPPER.1));
        let quantity = match self {
            Self::Travel => features.travel_mm,
            Self::BackEmf => features.back_emf_v_s_per_rad,
            Self::Resistance => features.resistance_ohm.map(|ohm| ohm / warm),
            Self::Duration => features.duration_s,
            // The voltage of a failed sensor counts as unknown.
            Self::Volts => features.supply_v.filter(|volts| POSSIBLE_SUPPLY_V.contains(volts)),
            Self::Inrush => features.peak_current_a,
            Self::Running => features.running_current_a,
            Self::Charge => features.charge_as,
            Self::NoLoadSpeed => features.no_load_speed_rad_per_s,
            Self::StartGain => features.start_gain,
            Self::StartDelay => return features.start_delay_s.map(|delay_s| 1e3 * delay_s),
            Self::Rest => return features.quiet_current_a,
            Self::EndRise => return features.end_rise_a,
            Self::Middle => {
                let ends = features.start_position_mm.zip(features.end_position_mm);
                return ends.map(|(start, end)| f64::midpoint(start, end));
            }
            Self::Air => return celsius,
        };
        quantity.map(f64::ln)
    }

    /// Least standard deviation of a level: the effect of sampling, adjustment and temperature on a healthy machine.
    pub(crate) fn floor(self) -> f64 {
        match self {
            Self::Travel => 0.003,
            Self::BackEmf => 0.005,
            Self::Resistance | Self::Duration | Self::Volts | Self::NoLoadSpeed => 0.01,
            Self::Inrush | Self::Running | Self::Charge | Self::StartGain | Self::Rest => 0.02,
            Self::StartDelay | Self::Middle => 0.2,
            Self::Air | Self::EndRise => 0.0,
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

/// The gauges of a throw.
pub(super) fn values(features: &Features, celsius: Option<f64>) -> Values {
    let value =
        |at: usize| Gauge::VARIANTS[at].value(features, celsius).map(to_rounded_f32).filter(|value| value.is_finite());
    std::array::from_fn(value)
}
