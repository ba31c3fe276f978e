//! From the history of a machine's estimates to one named cause. Time is a parameter; nothing here reads a clock.

use std::fmt;

use jiff::Timestamp;
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

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

/// How bad.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Plan a visit.
    Warning,
    /// Visit now.
    Critical,
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

/// Another cause that nearly explains the drift as well.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RunnerUp {
    /// The next best cause.
    pub cause: Cause,
    /// By how much its misfit is larger than the named cause's (chi-square units).
    pub margin: f64,
}

/// The paper's cross-correlation of the three inertia estimates, pairwise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// Between J from b0 and J from a1.
    pub b0_a1: f64,
    /// Between J from b0 and J from a0.
    pub b0_a0: f64,
    /// Between J from a1 and J from a0.
    pub a1_a0: f64,
}

/// Throws until a limit is reached, with an interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LimitForecast {
    /// Not sooner than this, 95 %.
    pub low: f64,
    /// Best guess.
    pub mid: f64,
    /// Not later than this, 95 %.
    pub high: f64,
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

/// Limits, windows and budgets of the diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {}

/// What an operator asks of a machine's monitor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "command", rename_all = "snake_case")]
pub enum Command {
    /// Somebody has seen the alarm.
    Ack {
        /// Which alarm.
        cause: Cause,
        /// Who.
        by: String,
    },
    /// Take the baseline again from the next throws.
    Rebaseline {
        /// Who.
        by: String,
        /// Why.
        why: String,
    },
}

/// What the monitor concluded from one observation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Verdict {
    /// Change of b0, a1, a0 from the baseline \[%\]; `None` before there is one, or without an estimate.
    pub change_pct: Option<[f64; 3]>,
    /// Throws in the baseline so far, of how many, for this direction.
    pub baseline: Option<(usize, usize)>,
    /// Alarm events that this observation caused, in order.
    pub events: Vec<AlarmEvent>,
}

/// The monitor of one machine: baselines, windows, alarms. Serialises completely, so that a restart changes nothing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MachineMonitor {}

impl MachineMonitor {
    /// A monitor that has seen nothing; `name` is how its texts call the machine.
    #[must_use]
    pub fn new(name: &str) -> Self {
        let _ = name;
        Self {}
    }

    /// Takes in one throw.
    pub fn observe(&mut self, observation: &Observation, settings: &Settings) -> Verdict {
        let _ = (observation, settings);
        Verdict::default()
    }

    /// Lets time pass: shelving ends, silence is noticed.
    pub fn tick(&mut self, now: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        let _ = (now, settings);
        Vec::new()
    }
}

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
