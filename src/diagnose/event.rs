//! What an alarm says: its cause, severity, state and evidence.

use std::fmt;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::{correlation::Correlation, trend::LimitForecast};
use crate::throw::{Direction, ThrowRef};

/// What an alarm is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// The motor's torque constant.
    Kt,
    /// Friction.
    Friction,
    /// Stiffness.
    Stiffness,
    /// Inertia.
    Inertia,
    /// Drift that none of the four explains alone, or that two explain equally well.
    Unattributed,
    /// The points did not complete a throw.
    IncompleteThrow,
    /// Throws take longer than they did.
    SlowThrow,
    /// No throw of the machine could be evaluated for too long.
    NotMonitored,
    /// Throws were lost between the logger and the database.
    DataLoss,
}

impl Cause {
    /// The four physical causes, in the order of the diagnosis.
    pub const PHYSICAL: [Self; 4] = [Self::Kt, Self::Friction, Self::Stiffness, Self::Inertia];

    /// All causes.
    pub const ALL: [Self; 9] = [
        Self::Kt,
        Self::Friction,
        Self::Stiffness,
        Self::Inertia,
        Self::Unattributed,
        Self::IncompleteThrow,
        Self::SlowThrow,
        Self::NotMonitored,
        Self::DataLoss,
    ];

    /// The word used in messages and in the database.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Kt => "kt",
            Self::Friction => "friction",
            Self::Stiffness => "stiffness",
            Self::Inertia => "inertia",
            Self::Unattributed => "unattributed",
            Self::IncompleteThrow => "incomplete_throw",
            Self::SlowThrow => "slow_throw",
            Self::NotMonitored => "not_monitored",
            Self::DataLoss => "data_loss",
        }
    }

    /// The cause with this word in messages and in the database, if it is one.
    #[must_use]
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|cause| cause.as_str() == word)
    }

    /// Whether it comes from a drift of the coefficients, and not from the throws' coming and going.
    #[must_use]
    pub const fn is_drift(self) -> bool {
        matches!(self, Self::Kt | Self::Friction | Self::Stiffness | Self::Inertia | Self::Unattributed)
    }
}

/// Plain words, for people.
impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Kt => "motor",
            Self::Friction => "friction",
            Self::Stiffness => "stiffness",
            Self::Inertia => "inertia",
            Self::Unattributed => "unattributed drift",
            Self::IncompleteThrow => "incomplete throw",
            Self::SlowThrow => "slow throw",
            Self::NotMonitored => "not monitored",
            Self::DataLoss => "data loss",
        })
    }
}

/// How bad.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Plan a visit.
    Warning,
    /// Visit now.
    Critical,
}

impl Severity {
    /// The word used in messages and in the database.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Warning => "warning",
            Self::Critical => "critical",
        }
    }
}

/// Alarm states in the words of ISA-18.2 and OPC UA Part 9.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AlarmState {
    /// No alarm.
    Normal,
    /// Raised, nobody has seen it.
    ActiveUnacknowledged,
    /// Raised and seen.
    ActiveAcknowledged,
    /// The condition went away before anybody acknowledged it.
    ClearedUnacknowledged,
    /// Silenced until a time, by someone, for a reason.
    Shelved,
    /// The machine is under maintenance.
    OutOfService,
}

impl AlarmState {
    /// The word used in messages and in the database.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::ActiveUnacknowledged => "active_unacknowledged",
            Self::ActiveAcknowledged => "active_acknowledged",
            Self::ClearedUnacknowledged => "cleared_unacknowledged",
            Self::Shelved => "shelved",
            Self::OutOfService => "out_of_service",
        }
    }
}

/// Another cause that nearly explains the drift as well.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RunnerUp {
    /// The next best cause.
    pub cause: Cause,
    /// By how much its misfit is larger than the named cause's (chi-square units).
    pub margin: f64,
}

/// One event in the life of an alarm, with its evidence. `wire::alarm` puts it on zenoh, `store` into SQL.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlarmEvent {
    /// What the alarm is about.
    pub cause: Cause,
    /// When this occurrence of the alarm was raised; with machine and cause it identifies the alarm.
    pub raised_at: Timestamp,
    /// +1 per event of the alarm, from 1.
    pub event_no: u32,
    /// How bad.
    pub severity: Severity,
    /// The state that the event led to.
    pub state: AlarmState,
    /// When the event happened.
    pub event_at: Timestamp,
    /// Size of the drift \[% from baseline\].
    pub change_pct: Option<f64>,
    /// Its standard deviation \[%\].
    pub change_pct_sd: Option<f64>,
    /// The direction in which it shows; `None` for both.
    pub direction: Option<Direction>,
    /// The next best cause.
    pub runner_up: Option<RunnerUp>,
    /// The paper's three numbers.
    pub correlation: Option<Correlation>,
    /// First throw of the evidence.
    pub first_throw: Option<ThrowRef>,
    /// Last throw of the evidence.
    pub last_throw: Option<ThrowRef>,
    /// One plain sentence: what, how sure, what to look at.
    pub text: String,
    /// When it reaches the next limit.
    pub limit_in_throws: Option<LimitForecast>,
    /// Who acted (acknowledge, shelve, rebaseline), where somebody did.
    pub by: Option<String>,
    /// Why.
    pub why: Option<String>,
}
