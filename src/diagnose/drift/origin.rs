//! Origin of a drift, by the gauges: a part, a sensor or the clock, or the supply.

use crate::diagnose::{Cause, RunnerUp, SensorChannel, statistics::Level};

/// Origin of a drift, by the gauges.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) enum Origin {
    /// A part of the machine causes the drift.
    #[default]
    Machine,
    /// A part and a sensor explain the drift about equally well; `waits`: evidence that would decide.
    Either { channel: SensorChannel, waits: Awaited },
    /// A sensor, or the clock, causes the drift.
    Sensor(SensorFault),
    /// The supply causes the drift.
    Supply,
    /// A past fault of a sensor or the supply causes the drift: its throws are still in the windows. `is_alike`: the
    /// sensor may also have its fault again.
    Past { is_alike: bool },
}

/// Evidence that would decide between a part and a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Awaited {
    /// More throws.
    Throws,
    /// The resistance of the motor, which is unknown although the voltage is published.
    Resistance,
    /// A published supply voltage.
    Voltage,
}

/// A fault of a sensor or of the clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SensorFault {
    /// [`Cause::Sensor`]. On a machine without toe sensor, the gain of the position is that of the assumed stroke: then
    /// [`Cause::Unattributed`], as the points may stop at another place.
    pub(crate) cause: Cause,
    pub(crate) channel: SensorChannel,
    /// Logarithm of the gain, or of the rate of the clock.
    pub(crate) size: Level,
    /// The part that explains the drift best, and the lead of the sensor over it.
    pub(crate) runner_up: RunnerUp,
}

impl Origin {
    /// Whether a sensor, the clock or the supply causes the drift, so that it is no evidence of a faulty part.
    pub(crate) fn is_instrument(self) -> bool {
        matches!(self, Self::Sensor(_) | Self::Supply | Self::Past { .. })
    }
}
