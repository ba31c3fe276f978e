//! What an alarm says: its cause, severity, state and evidence.

use std::fmt;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::{correlation::Correlation, course::LimitForecast};
use crate::throw::{Direction, ThrowRef};

/// What an alarm is about.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Hash,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    strum::IntoStaticStr,
    strum::EnumString,
    strum::VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
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
    /// A sensor says what cannot be, or explains a drift as well as the machine does.
    Sensor,
    /// The supply of the motor changed.
    Supply,
}

impl Cause {
    /// The four physical causes, in the order of the diagnosis.
    pub const PHYSICAL: [Self; 4] = [Self::Kt, Self::Friction, Self::Stiffness, Self::Inertia];

    /// The word used in messages and in the database.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        self.into()
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
            Self::Sensor => "sensor",
            Self::Supply => "supply",
        })
    }
}

/// The sensor that an alarm with [`Cause::Sensor`] is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorChannel {
    /// Of the motor current.
    Current,
    /// Of the toe position.
    Position,
    /// The logger's clock, which gives the sampling rate.
    Clock,
    /// Of the temperature.
    Temperature,
    /// Of the supply voltage.
    Supply,
}

/// Plain words, for people.
impl fmt::Display for SensorChannel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Current => "current sensor",
            Self::Position => "position sensor",
            Self::Clock => "logger's clock",
            Self::Temperature => "temperature sensor",
            Self::Supply => "sensor of the supply voltage",
        })
    }
}

/// How bad.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, strum::IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Severity {
    /// Plan a visit.
    Warning,
    /// Visit now.
    Critical,
}

impl Severity {
    /// The word used in messages and in the database.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// Alarm states in the words of ISA-18.2 and OPC UA Part 9.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, strum::IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
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
    /// The state in words, the same on pages and on the command line.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Normal => "over",
            Self::ActiveUnacknowledged => "not acknowledged",
            Self::ActiveAcknowledged => "acknowledged",
            Self::ClearedUnacknowledged => "over, not acknowledged",
            Self::Shelved => "shelved",
            Self::OutOfService => "in maintenance",
        }
    }

    /// The word used in messages and in the database.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        self.into()
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

/// One event in the life of an alarm, with its evidence: the same in the monitor's snapshot, on zenoh and in SQL. Its JSON
/// has the names of the alarm message.
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
    /// The sensor, of an alarm about one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channel: Option<SensorChannel>,
    /// The next best cause.
    pub runner_up: Option<RunnerUp>,
    /// The paper's three numbers.
    pub correlation: Option<Correlation>,
    /// First throw of the evidence.
    #[serde(flatten, with = "first_throw")]
    pub first_throw: Option<ThrowRef>,
    /// Last throw of the evidence.
    #[serde(flatten, with = "last_throw")]
    pub last_throw: Option<ThrowRef>,
    /// One plain sentence: what, how sure, what to look at.
    pub text: String,
    /// When it reaches the next limit.
    pub limit_in_throws: Option<LimitForecast>,
    /// Who acted (acknowledge, shelve, rebaseline), where somebody did. Not published.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
    /// Why. Not published.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

/// The JSON of a throw of the evidence: its number, as published, and its boot, which is not published.
macro_rules! evidence_throw {
    ($name:ident, $throw_no:literal, $boot_id:literal) => {
        mod $name {
            use serde::{Deserialize, Deserializer, Serialize, Serializer};

            use crate::throw::ThrowRef;

            #[derive(Serialize, Deserialize)]
            struct Json {
                #[serde(rename = $throw_no)]
                throw_no: Option<u64>,
                #[serde(rename = $boot_id, default, skip_serializing_if = "String::is_empty")]
                boot_id: String,
                /// Snapshots of earlier versions have the whole reference here.
                #[serde(default, skip_serializing)]
                $name: Option<ThrowRef>,
            }

            #[expect(clippy::ref_option, reason = "serde gives a reference to the field")]
            pub(super) fn serialize<S: Serializer>(throw: &Option<ThrowRef>, to: S) -> Result<S::Ok, S::Error> {
                let boot_id = throw.as_ref().map(|throw| throw.boot_id.clone()).unwrap_or_default();
                Json { throw_no: throw.as_ref().map(|throw| throw.throw_no), boot_id, $name: None }.serialize(to)
            }

            pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<ThrowRef>, D::Error> {
                let Json { throw_no, boot_id, $name } = Json::deserialize(from)?;
                Ok($name.or(throw_no.map(|throw_no| ThrowRef { boot_id, throw_no })))
            }
        }
    };
}

evidence_throw!(first_throw, "first_throw_no", "first_boot_id");
evidence_throw!(last_throw, "last_throw_no", "last_boot_id");
