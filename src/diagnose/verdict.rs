//! What the monitor concludes from one throw: the state of the machine, its drifts as they are now, and alarm events.

use serde::{Deserialize, Serialize};

use super::{
    baseline::BaselineRecord,
    course::LimitForecast,
    event::{AlarmEvent, Cause},
};
use crate::throw::Direction;

/// The state of a machine, the same word in SQL, on pages, in `status` and in Health.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Hash,
    PartialOrd,
    Ord,
    Default,
    Serialize,
    Deserialize,
    strum::IntoStaticStr,
    strum::EnumString,
    strum::VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum MachineState {
    /// No baseline is usable yet.
    #[default]
    Learning,
    /// Monitored, and no alarm is active.
    Healthy,
    /// An alarm of severity warning is active.
    Warning,
    /// An alarm of severity critical is active.
    Critical,
    /// Its throws cannot be evaluated, or none arrive.
    NotMonitored,
    /// Out of service.
    Maintenance,
}

impl MachineState {
    /// The word in messages and in the database.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// A drift with an active alarm, as it is now: renewed after every throw. The alarm's events keep how it was then.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Drifting {
    /// The cause that the alarm names.
    pub cause: Cause,
    /// Size now \[% from baseline\].
    pub change_pct: f64,
    /// Standard deviation of the size \[%\].
    pub change_pct_sd: f64,
    /// The direction in which the drift shows; `None` for both.
    pub direction: Option<Direction>,
    /// When the drift reaches the critical limit; `None` without a clear trend, or past that limit.
    pub limit_in_throws: Option<LimitForecast>,
}

/// At its present temperature the machine's throws cannot show a fault: what the temperature does is not known well enough.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Blindness {
    /// The cause that is hidden most, in multiples of its warning limit.
    pub cause: Cause,
    /// Changes below this size cannot be told from the temperature's effect \[%\].
    pub below_pct: f64,
    /// The present temperature \[°C\].
    pub temperature_c: f64,
    /// The temperature that the baseline belongs to \[°C\].
    pub baseline_c: f64,
}

/// What the monitor concludes from one observation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Verdict {
    /// State of the machine after this throw.
    pub state: MachineState,
    /// One for each active drift alarm, as the drift is now; the largest in multiples of its warning limit first.
    pub drifts: Vec<Drifting>,
    /// A change at the warning limit cannot be seen at this temperature.
    pub blind: Option<Blindness>,
    /// Change of b0, a1, a0 from the baseline \[%\]; `None` before there is one, or without an estimate.
    pub change_pct: Option<[f64; 3]>,
    /// Throws in the baseline so far, of how many, for this direction.
    pub baseline: Option<(usize, usize)>,
    /// The baselines that this throw completed or made usable, to be kept in history.
    pub baselines_taken: Vec<BaselineRecord>,
    /// Alarm events that this observation caused, in order.
    pub events: Vec<AlarmEvent>,
}
