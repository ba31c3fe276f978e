//! Settings of the diagnosis. Every key has a default, a unit, and a range that `validate` checks.

use jiff::SignedDuration;
use serde::{Deserialize, Serialize};

use super::event::Cause;
use crate::throw::OutOfRange;

/// Limits, delays and budgets of the diagnosis, for all machines.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Accepted throws of a complete baseline, for each direction. 12 to 200, default 50.
    pub baseline_throws: usize,
    /// Accepted throws from which a baseline is used, with wider limits. 12 to `baseline_throws`, default 12.
    pub baseline_usable_throws: usize,
    /// Years with at most one false drift alarm per machine. 0.001 to 10,000 years, default 20.
    pub false_alarm_years: f64,
    /// Throws of a machine per day, in both directions, to convert years and weeks into throws. 0.1 to 5,000, default 20.
    pub throws_per_day: f64,
    /// Warning limit of the motor's torque constant. 0.001 to 100 %, default 5.
    pub kt_limit_pct: f64,
    /// Warning limit of friction. 0.001 to 100 %, default 15.
    pub friction_limit_pct: f64,
    /// Warning limit of stiffness. 0.001 to 100 %, default 10.
    pub stiffness_limit_pct: f64,
    /// Warning limit of inertia. 0.001 to 100 %, default 5.
    pub inertia_limit_pct: f64,
    /// Critical limit as multiple of the warning limit. 1 to 20, default 3.
    pub critical_factor: f64,
    /// Error of the model: effect of a fault on the other coefficients, as part of its main effect. 0 to 1, default
    /// 0.3.
    pub model_error: f64,
    /// The paper's limit of the cross-correlations for inertia. 0 to 1, default 0.8.
    pub correlation_limit: f64,
    /// Change of b0, a1, a0 with temperature; `None` to fit it if the baseline allows it.
    pub temperature: Option<TemperatureCoefficients>,
    /// Temperature span of a baseline from which its temperature coefficients are fitted. 1 to 100 K, default 10.
    pub temperature_span_k: f64,
    /// Consecutive throws with a drift before its alarm is raised. 1 to 100, default 2.
    pub on_delay_throws: u32,
    /// Consecutive throws with plain health before an alarm is cleared; drift alarms need at least 12. 1 to 10,000,
    /// default 12.
    pub off_delay_throws: u32,
    /// Throws below the deadband after which an alarm just below its limit clears. 1 to 100,000, default 200.
    pub hold_throws: u32,
    /// Distance below the limit that counts as below it. 0 to 90 %, default 20.
    pub deadband_pct: f64,
    /// Longest shelving or maintenance window. 1 to 3,660 days, default 31.
    pub longest_shelving_days: u32,
    /// Excess over the baseline's duration of a slow throw. 1 to 1,000 %, default 20.
    pub slow_throw_pct: f64,
    /// Excess over the baseline's duration of a critically slow throw. `slow_throw_pct` to 10,000 %, default 50.
    pub slow_throw_critical_pct: f64,
    /// Consecutive throws without an estimate until a machine is not monitored. 1 to 10,000, default 20.
    pub not_monitored_throws: u32,
    /// Time without a throw until a machine is not monitored. 0.1 to 100,000 h, default 168.
    pub not_monitored_hours: f64,
    /// Time without the logger's token until a machine is not monitored: longer than a short link failure or a restart
    /// of the logger. 0.01 to 100,000 min, default 10.
    pub logger_gone_minutes: f64,
}

/// Change of the three coefficients with temperature \[% per K\], each -10 to 10.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TemperatureCoefficients {
    /// Of b0 \[% per K\].
    pub b0_pct_per_k: f64,
    /// Of a1 \[% per K\].
    pub a1_pct_per_k: f64,
    /// Of a0 \[% per K\].
    pub a0_pct_per_k: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            baseline_throws: 50,
            baseline_usable_throws: 12,
            false_alarm_years: 20.0,
            throws_per_day: 20.0,
            kt_limit_pct: 5.0,
            friction_limit_pct: 15.0,
            stiffness_limit_pct: 10.0,
            inertia_limit_pct: 5.0,
            critical_factor: 3.0,
            model_error: 0.3,
            correlation_limit: 0.8,
            temperature: None,
            temperature_span_k: 10.0,
            on_delay_throws: 2,
            off_delay_throws: 12,
            hold_throws: 200,
            deadband_pct: 20.0,
            longest_shelving_days: 31,
            slow_throw_pct: 20.0,
            slow_throw_critical_pct: 50.0,
            not_monitored_throws: 20,
            not_monitored_hours: 168.0,
            logger_gone_minutes: 10.0,
        }
    }
}

impl Settings {
    /// Checks every key against its range.
    ///
    /// # Errors
    /// The first key out of its range.
    pub fn validate(&self) -> Result<(), OutOfRange> {
        let ranges = [
            ("baseline_throws", self.baseline_throws as f64, 12.0, 200.0),
            ("baseline_usable_throws", self.baseline_usable_throws as f64, 12.0, self.baseline_throws as f64),
            ("false_alarm_years", self.false_alarm_years, 0.001, 10_000.0),
            ("throws_per_day", self.throws_per_day, 0.1, 5_000.0),
            ("kt_limit_pct", self.kt_limit_pct, 0.001, 100.0),
            ("friction_limit_pct", self.friction_limit_pct, 0.001, 100.0),
            ("stiffness_limit_pct", self.stiffness_limit_pct, 0.001, 100.0),
            ("inertia_limit_pct", self.inertia_limit_pct, 0.001, 100.0),
            ("critical_factor", self.critical_factor, 1.0, 20.0),
            ("model_error", self.model_error, 0.0, 1.0),
            ("correlation_limit", self.correlation_limit, 0.0, 1.0),
            ("temperature_span_k", self.temperature_span_k, 1.0, 100.0),
            ("on_delay_throws", f64::from(self.on_delay_throws), 1.0, 100.0),
            ("off_delay_throws", f64::from(self.off_delay_throws), 1.0, 10_000.0),
            ("hold_throws", f64::from(self.hold_throws), 1.0, 100_000.0),
            ("deadband_pct", self.deadband_pct, 0.0, 90.0),
            ("longest_shelving_days", f64::from(self.longest_shelving_days), 1.0, 3_660.0),
            ("slow_throw_pct", self.slow_throw_pct, 1.0, 1_000.0),
            ("slow_throw_critical_pct", self.slow_throw_critical_pct, self.slow_throw_pct, 10_000.0),
            ("not_monitored_throws", f64::from(self.not_monitored_throws), 1.0, 10_000.0),
            ("not_monitored_hours", self.not_monitored_hours, 0.1, 100_000.0),
            ("logger_gone_minutes", self.logger_gone_minutes, 0.01, 100_000.0),
        ];
        let temperature = self.temperature.iter().flat_map(|t| {
            [
                ("temperature.b0_pct_per_k", t.b0_pct_per_k, -10.0, 10.0),
                ("temperature.a1_pct_per_k", t.a1_pct_per_k, -10.0, 10.0),
                ("temperature.a0_pct_per_k", t.a0_pct_per_k, -10.0, 10.0),
            ]
        });
        let ranges = ranges.into_iter().chain(temperature);
        OutOfRange::check(ranges.map(|(key, value, low, high)| (key, value, low, high, "")))
    }

    /// Allowed false drift alarms per throw of a machine, on average.
    #[must_use]
    pub fn false_alarms_per_throw(&self) -> f64 {
        const DAYS_PER_YEAR: f64 = 365.25;
        1.0 / (self.false_alarm_years * DAYS_PER_YEAR * self.throws_per_day)
    }

    pub(super) fn longest_shelving(&self) -> SignedDuration {
        SignedDuration::from_hours(24 * i64::from(self.longest_shelving_days))
    }

    /// Warning limit of a physical cause \[%\]; `None` for other causes.
    #[must_use]
    pub fn limit_pct(&self, cause: Cause) -> Option<f64> {
        match cause {
            Cause::Kt => Some(self.kt_limit_pct),
            Cause::Friction => Some(self.friction_limit_pct),
            Cause::Stiffness => Some(self.stiffness_limit_pct),
            Cause::Inertia => Some(self.inertia_limit_pct),
            _ => None,
        }
    }
}
