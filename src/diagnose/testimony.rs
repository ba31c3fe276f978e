//! What the gauges of a machine say about a drift: its part, a sensor, or the supply.

use super::event::{RunnerUp, SensorChannel};

/// What the gauges say about a drift.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) enum Testimony {
    /// The machine drifts.
    #[default]
    Machine,
    /// Part and sensor explain it alike; `waits`: more throws may tell.
    Either { channel: SensorChannel, waits: bool },
    /// The sensor.
    Sensor(Fault),
    /// The supply.
    Supply,
    /// Sensor or supply explained the drift a while ago: windows still hold throws of then.
    Lingers,
}

/// A sensor's fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fault {
    pub(super) channel: SensorChannel,
    /// Its gain, or how much faster the clock runs, as a logarithm, and the standard deviation.
    pub(super) size: f64,
    pub(super) size_sd: f64,
    /// The part that would explain the drift, and by how much worse.
    pub(super) runner_up: RunnerUp,
}

impl Testimony {
    /// Whether no part is at fault.
    pub(super) fn excuses(self) -> bool {
        matches!(self, Self::Sensor(_) | Self::Supply | Self::Lingers)
    }
}
