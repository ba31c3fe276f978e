//! From the history of a machine's estimates to one named cause. Time is a parameter; nothing here reads a clock.

mod alarm;
mod baseline;
mod cause;
mod command;
mod condition;
mod correlation;
mod drift;
mod event;
mod explain;
mod monitor;
mod operational;
mod robust;
mod scatter;
mod settings;
mod sym3;
mod text;
mod threshold;
mod track;
mod trend;
mod verdict;

use jiff::Timestamp;
use nalgebra::Matrix3;

pub use baseline::{BaselineRecord, TemperatureSource};
pub use command::{Command, CommandError};
pub use correlation::Correlation;
pub use event::{AlarmEvent, AlarmState, Cause, RunnerUp, Severity};
pub use monitor::{MachineMonitor, MachineState};
pub use settings::{InvalidSetting, Settings, TemperatureCoefficients};
pub use trend::LimitForecast;

use crate::{
    estimate::Features,
    throw::{Direction, ThrowRef},
};

/// One throw as the diagnosis sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Which throw.
    pub throw: ThrowRef,
    /// Its wall time.
    pub started_at: Timestamp,
    /// Its direction, where known.
    pub direction: Option<Direction>,
    /// (b0, a1, a0) and their covariance; `None` when the throw was not evaluated.
    pub estimate: Option<([f64; 3], Matrix3<f64>)>,
    /// The points did not complete their movement (obstruction, no detection).
    pub incomplete: bool,
    /// What maintainers know of a throw.
    pub features: Features,
    /// Temperature \[°C\], where measured.
    pub temperature_c: Option<f64>,
}

/// What the monitor concluded from one observation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Verdict {
    /// Change of b0, a1, a0 from the baseline \[%\]; `None` before there is one, or without an estimate.
    pub change_pct: Option<[f64; 3]>,
    /// Throws in the baseline so far, of how many, for this direction.
    pub baseline: Option<(usize, usize)>,
    /// The baselines that this throw completed or made usable, to be kept in history.
    pub baselines_taken: Vec<BaselineRecord>,
    /// Alarm events that this observation caused, in order.
    pub events: Vec<AlarmEvent>,
}
