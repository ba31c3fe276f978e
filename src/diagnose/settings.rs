//! Settings of the diagnosis. Every key has a default, a unit, and a range that [`Settings::validate`] checks.

use jiff::SignedDuration;
use serde::{Deserialize, Serialize};

use super::{Cause, statistics::percent};
use crate::throw::{
    OutOfRange,
    Range::{If, Within},
    settings,
};

/// Longest shelving or maintenance that `longest_shelving_days` may allow \[days\].
pub const LONGEST_SHELVING_DAYS: f64 = 3_660.0;

settings! {
    /// Limits, delays and false-alarm budget of the diagnosis, for all machines.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Settings {
        /// Accepted throws in a complete baseline, for each direction. 12 to 200.
        pub baseline_throws: usize = 50, Within(12.0, 200.0, "");
        /// Accepted throws from which a baseline is used, with wider limits. 12 to `baseline_throws`.
        pub baseline_usable_throws: usize = 12;
        /// Years with at most one false drift alarm per machine. 0.001 to 10,000 years.
        pub false_alarm_years: f64 = 20.0, Within(0.001, 10_000.0, "");
        /// Throws of a machine per day, in both directions, to convert years and weeks into throws. 0.1 to 5,000.
        pub throws_per_day: f64 = 20.0, Within(0.1, 5_000.0, "");
        /// Warning limit of the motor's torque constant. 0.001 to 100 %.
        pub kt_limit_pct: f64 = 5.0, Within(0.001, 100.0, "");
        /// Warning limit of friction. 0.001 to 100 %.
        pub friction_limit_pct: f64 = 15.0, Within(0.001, 100.0, "");
        /// Warning limit of stiffness. 0.001 to 100 %.
        pub stiffness_limit_pct: f64 = 10.0, Within(0.001, 100.0, "");
        /// Warning limit of inertia. 0.001 to 100 %.
        pub inertia_limit_pct: f64 = 5.0, Within(0.001, 100.0, "");
        /// Critical limit as multiple of the warning limit. 1 to 20.
        pub critical_factor: f64 = 3.0, Within(1.0, 20.0, "");
        /// Error of the model: largest effect of a fault on other coefficients, as part of its main effect. 0 to 1.
        pub model_error: f64 = 0.3, Within(0.0, 1.0, "");
        /// The paper's limit of the cross-correlations for inertia. 0 to 1.
        pub correlation_limit: f64 = 0.8, Within(0.0, 1.0, "");
        /// Change of b0, a1, a0 with temperature; `None`: fitted if the baseline has enough temperatures.
        pub temperature: Option<TemperatureCoefficients> = None;
        /// Temperature span of a baseline from which its temperature coefficients are fitted. 1 to 100 K.
        pub temperature_span_k: f64 = 10.0, Within(1.0, 100.0, "");
        /// Consecutive throws with a drift until its alarm is raised. 1 to 100.
        pub on_delay_throws: u32 = 2, Within(1.0, 100.0, "");
        /// Consecutive throws without a fault until its alarm is cleared. Some alarms need more, as those about drifts at
        /// least 12. 1 to 10,000.
        pub off_delay_throws: u32 = 12, Within(1.0, 10_000.0, "");
        /// Throws below the deadband until an alarm just below its limit clears. 1 to 100,000.
        pub hold_throws: u32 = 200, Within(1.0, 100_000.0, "");
        /// Distance below a limit from which a value counts as below it, as part of the limit. 0 to 90 %.
        pub deadband_pct: f64 = 20.0, Within(0.0, 90.0, "");
        /// Longest shelving or maintenance window. 1 to 3,660 days.
        pub longest_shelving_days: u32 = 31, Within(1.0, LONGEST_SHELVING_DAYS, "");
        /// Excess over the baseline's duration of a slow throw. 1 to 1,000 %.
        pub slow_throw_pct: f64 = 20.0, Within(1.0, 1_000.0, "");
        /// Excess over the baseline's duration of a critically slow throw. `slow_throw_pct` to 10,000 %.
        pub slow_throw_critical_pct: f64 = 50.0;
        /// Consecutive throws without an estimate and without monitored features until a machine, or a direction, is not
        /// monitored. 1 to 10,000.
        pub not_monitored_throws: u32 = 20, Within(1.0, 10_000.0, "");
        /// Time without a throw until a machine is not monitored. 0.1 to 100,000 h.
        pub not_monitored_hours: f64 = 168.0, Within(0.1, 100_000.0, "");
        /// Time without the logger's token until a machine is not monitored. It should be longer than a short link
        /// failure or a restart of the logger. 0.01 to 100,000 min.
        pub logger_gone_minutes: f64 = 10.0, Within(0.01, 100_000.0, "");
    }
}

settings! {
    /// Change of the three coefficients with temperature. All three must be given.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct TemperatureCoefficients {
        /// Change of b0. -10 to 10 % per K.
        pub b0_pct_per_k: f64 = 0.0, Within(-10.0, 10.0, "");
        /// Change of a1. -10 to 10 % per K.
        pub a1_pct_per_k: f64 = 0.0, Within(-10.0, 10.0, "");
        /// Change of a0. -10 to 10 % per K.
        pub a0_pct_per_k: f64 = 0.0, Within(-10.0, 10.0, "");
    }
}

impl Settings {
    /// Checks every key against its range.
    ///
    /// # Errors
    /// The first key out of its range.
    pub fn validate(&self) -> Result<(), OutOfRange> {
        self.check_ranges()?;
        let usable = self.baseline_usable_throws as f64;
        Within(12.0, self.baseline_throws as f64, "").check("baseline_usable_throws", usable)?;
        let critical_pct = self.slow_throw_critical_pct;
        // If the file lowers only the critical limit, the error names that one.
        If(
            self.slow_throw_pct <= critical_pct || critical_pct < Self::default().slow_throw_critical_pct,
            "at most slow_throw_critical_pct (50 by default)",
        )
        .check("slow_throw_pct", self.slow_throw_pct)?;
        Within(self.slow_throw_pct, 10_000.0, "").check("slow_throw_critical_pct", critical_pct)?;
        self.temperature.map_or(Ok(()), |t| t.check_ranges().map_err(|error| error.within("temperature")))
    }

    /// The false-alarm budget: false drift alarms per throw of a machine, on average.
    pub fn false_alarms_per_throw(&self) -> f64 {
        const DAYS_PER_YEAR: f64 = 365.25;
        1.0 / (self.false_alarm_years * DAYS_PER_YEAR * self.throws_per_day)
    }

    pub(super) fn longest_shelving(&self) -> SignedDuration {
        SignedDuration::from_hours(24 * i64::from(self.longest_shelving_days))
    }

    /// Warning limit of a physical cause \[%\]; `None` for other causes.
    pub fn limit_pct(&self, cause: Cause) -> Option<f64> {
        match cause {
            Cause::Kt => Some(self.kt_limit_pct),
            Cause::Friction => Some(self.friction_limit_pct),
            Cause::Stiffness => Some(self.stiffness_limit_pct),
            Cause::Inertia => Some(self.inertia_limit_pct),
            _ => None,
        }
    }

    /// Size of a change (a logarithm) relative to the warning limit of its cause; 0 for causes without a limit.
    pub(super) fn relevance(&self, cause: Cause, size: f64) -> f64 {
        self.limit_pct(cause).map_or(0.0, |limit| percent(size).abs() / limit)
    }
}
