//! The verdict of the monitor on a throw: state of the machine, present drifts, alarm events.

use serde::{Deserialize, Serialize};

use super::{AlarmEvent, Cause, baseline::BaselineRecord, drift::LimitForecast};
use crate::throw::Direction;

/// The state of a machine, the same word in SQL, on pages, in `status` and in Health.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[derive(strum::IntoStaticStr, strum::EnumString, strum::VariantArray)]
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
    /// No throw can be evaluated, or none arrives.
    NotMonitored,
    /// Out of service, in maintenance.
    Maintenance,
}

impl MachineState {
    /// The word in messages and in the database.
    pub fn as_str(self) -> &'static str {
        self.into()
    }

    /// Whether nothing is known to be wrong with the machine, and it is in service.
    pub fn is_well(self) -> bool {
        matches!(self, Self::Healthy | Self::Learning)
    }
}

/// The present drift of an active alarm, updated after every throw. Alarm events describe the drift at their own time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Drifting {
    /// Cause of the alarm.
    pub cause: Cause,
    /// Present size \[% from baseline\].
    pub change_pct: f64,
    /// Standard deviation of the size \[%\].
    pub change_pct_sd: f64,
    /// Direction of the drift; `None` for both.
    pub direction: Option<Direction>,
    /// Forecast of the throws to the critical limit; `None` without a clear trend, or beyond the limit.
    pub limit_in_throws: Option<LimitForecast>,
}

/// Half width of an interval \[%\] up to which the size is published, however small it is. It is the critical limit of
/// friction, the highest of the default limits: a narrower interval around 0 says that no part has a critical fault.
const OF_USE_PCT: f64 = 45.0;

impl Drifting {
    /// Whether the size is certain enough to publish. The 95 % interval must be at most three times as wide as the
    /// size, or its half width at most [`OF_USE_PCT`].
    pub(super) fn has_size(&self) -> bool {
        let half_width_pct = 1.96 * self.change_pct_sd;
        half_width_pct <= OF_USE_PCT || 2.0 * half_width_pct <= 3.0 * self.change_pct.abs()
    }
}

/// A fault that the throws of a machine cannot show: because the effect of the present temperature is too uncertain, or
/// because the throws scatter too much.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Blindness {
    /// The cause hidden most, in relation to its warning limit.
    pub cause: Cause,
    /// Size \[%\] below which a change cannot be distinguished from scatter or from the effect of the temperature.
    pub below_pct: f64,
    /// The temperature that hides the cause; `None` for scatter.
    #[serde(flatten)]
    pub temperature: Option<HidingTemperature>,
}

/// A temperature too far from the temperature of the baseline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HidingTemperature {
    /// The present temperature \[°C\].
    pub temperature_c: f64,
    /// Reference temperature of the baseline \[°C\].
    pub baseline_c: f64,
}

/// The present condition of a machine.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Present {
    /// State of the machine.
    pub state: MachineState,
    /// Drifts with an active alarm whose size is known: named parts first, then the most severe.
    pub drifts: Vec<Drifting>,
    /// Sentences about limits of the monitoring at present, such as blindness or a trend in the baseline.
    pub caveats: Vec<String>,
}

/// The verdict of the monitor on a throw.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Verdict {
    /// The machine after this throw.
    pub present: Present,
    /// Blindness, if temperature hides a change at the warning limit, or scatter one at the critical limit.
    pub blind: Option<Blindness>,
    /// Whether an incomplete baseline has a trend.
    pub has_trend: bool,
    /// Change of b0, a1, a0 from the baseline \[%\]; `None` without a baseline or an estimate.
    pub change_pct: Option<[f64; 3]>,
    /// Throws in the baseline of this direction, and throws that a complete baseline needs; `None` if the direction is
    /// unknown, or if the throw has features only and the machine already has a baseline of coefficients.
    pub baseline: Option<(usize, usize)>,
    /// Baselines that became usable or complete with this throw.
    pub baselines_taken: Vec<BaselineRecord>,
    /// Alarm events of this throw, in order; also those of its date, its boot and its configuration.
    pub events: Vec<AlarmEvent>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_with_a_useless_interval_is_none() {
        let has_size = |change_pct: f64, change_pct_sd: f64| {
            let cause = Cause::Unattributed;
            Drifting { cause, change_pct, change_pct_sd, direction: None, limit_in_throws: None }.has_size()
        };
        assert!(!has_size(7.0, 107.0) && !has_size(-20.0, 40.0));
        assert!(has_size(42.0, 3.5) && has_size(90.0, 60.0), "a change for certain, and a large one");
        assert!(has_size(0.5, 2.0), "the drift is over for certain");
    }
}
