//! Verdict of the gauges on a drift: caused by a part, by a sensor or the clock, or by the supply.

use super::event::{RunnerUp, SensorChannel};

/// Verdict of the gauges on a drift.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) enum Testimony {
    /// A part of the machine.
    #[default]
    Machine,
    /// Part and sensor explain the drift equally well, and what they wait for.
    Either { channel: SensorChannel, waits: Awaited },
    /// A sensor.
    Sensor(Fault),
    /// The supply.
    Supply,
    /// A past fault of sensor or supply, whose throws are still in the windows; `is_alike`: the sensor may explain this
    /// drift too.
    Lingers { is_alike: bool },
}

/// Evidence that would distinguish part and sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Awaited {
    /// More throws.
    Throws,
    /// The resistance of the motor, which is not known although the voltage is published.
    Resistance,
    /// A published voltage.
    Voltage,
}

/// A fault of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fault {
    pub(super) channel: SensorChannel,
    /// Logarithm of the gain, or of the rate of the clock, and its standard deviation.
    pub(super) size: f64,
    pub(super) size_sd: f64,
    /// The best part for the drift, and the lead of the sensor over it.
    pub(super) runner_up: RunnerUp,
}

impl Testimony {
    /// Whether no part is faulty.
    pub(super) fn excuses(self) -> bool {
        matches!(self, Self::Sensor(_) | Self::Supply | Self::Lingers { .. })
    }
}
