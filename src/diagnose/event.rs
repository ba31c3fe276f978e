//! Alarm events: cause, severity, state and evidence.

use std::fmt;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use strum::VariantArray as _;

use super::{
    drift::LimitForecast,
    statistics::{Correlation, Level},
};
use crate::throw::{Channel, Direction, MachineId, ThrowRef};

/// Cause of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[derive(strum::IntoStaticStr, strum::EnumString, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum Cause {
    /// Torque constant of the motor. Messages and configuration may also say `motor`.
    #[serde(alias = "motor")]
    Kt,
    /// Friction of drive and slide chairs.
    Friction,
    /// Stiffness of the rails.
    Stiffness,
    /// Inertia of the machine.
    Inertia,
    /// A change that names no part: of coefficients, features, start, travel or end of the stroke, or a motor that runs
    /// on.
    Unattributed,
    /// The points did not complete a throw.
    IncompleteThrow,
    /// Throws take longer than in the baseline.
    SlowThrow,
    /// No throw of the machine could be evaluated for too long.
    NotMonitored,
    /// Lost throws, or a problem of the daemon.
    DataLoss,
    /// A sensor gives implausible values, or explains a drift at least as well as the machine.
    Sensor,
    /// The supply of the motor changed: its voltage, or the resistance between it and the motor.
    Supply,
}

impl Cause {
    /// The four physical causes: the three that change one coefficient each (b0, a1, a0, in this order), and inertia,
    /// which changes all of them.
    pub const PHYSICAL: [Self; 4] = [Self::Kt, Self::Friction, Self::Stiffness, Self::Inertia];
    /// The causes that change one coefficient each, in the order of b0, a1, a0.
    pub(super) const OF_COEFFICIENTS: [Self; 3] = [Self::Kt, Self::Friction, Self::Stiffness];

    /// The causes that a drift of the coefficients may have; `Unattributed` also comes from rules that name no part.
    pub(super) const DRIFTS: [Self; 5] = [Self::Kt, Self::Friction, Self::Stiffness, Self::Inertia, Self::Unattributed];
    /// The pairs of physical causes.
    pub(super) const PAIRS: [[Self; 2]; 6] = {
        let [a, b, c, d] = Self::PHYSICAL;
        [[a, b], [a, c], [a, d], [b, c], [b, d], [c, d]]
    };

    /// Name in messages and in the database.
    pub fn as_str(self) -> &'static str {
        self.into()
    }

    /// The cause with this name, that of messages or that for people; a space or hyphen counts as an underscore.
    pub fn named(text: &str) -> Option<Self> {
        let word = text.replace([' ', '-'], "_");
        let is_named = |cause: &&Self| cause.to_string().replace(' ', "_") == word;
        word.parse().ok().or_else(|| Self::VARIANTS.iter().find(is_named).copied())
    }

    /// Whether the cause is one of [`Self::PHYSICAL`], which name a part of the machine.
    pub fn is_part(self) -> bool {
        Self::PHYSICAL.contains(&self)
    }

    /// Whether a drift of the coefficients may have this cause: a part, or `Unattributed`.
    pub fn is_drift(self) -> bool {
        Self::DRIFTS.contains(&self)
    }
}

/// Name for people.
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

/// The faulty sensor of an alarm with [`Cause::Sensor`]. `Display` is its name for people.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, strum::Display)]
#[serde(rename_all = "snake_case")]
pub enum SensorChannel {
    /// Sensor of the motor current.
    #[strum(to_string = "current sensor")]
    Current,
    /// Sensor of the toe position.
    #[strum(to_string = "position sensor")]
    Position,
    /// Clock of the logger, which sets the sampling rate.
    #[strum(to_string = "logger's clock")]
    Clock,
    /// Sensor of the temperature.
    #[strum(to_string = "temperature sensor")]
    Temperature,
    /// Sensor of the supply voltage.
    #[strum(to_string = "sensor of the supply voltage")]
    Supply,
}

impl From<Channel> for SensorChannel {
    fn from(channel: Channel) -> Self {
        match channel {
            Channel::Current => Self::Current,
            Channel::Position => Self::Position,
        }
    }
}

/// Severity of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, strum::IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Severity {
    /// Maintenance should be planned.
    Warning,
    /// Maintenance is urgent.
    Critical,
}

impl Severity {
    /// Name in messages and in the database.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// Alarm states in the words of ISA-18.2 and OPC UA Part 9.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, strum::IntoStaticStr, strum::EnumString)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum AlarmState {
    /// No alarm.
    Normal,
    /// Raised, not acknowledged.
    ActiveUnacknowledged,
    /// Raised and acknowledged.
    ActiveAcknowledged,
    /// The condition ended before an acknowledgement.
    ClearedUnacknowledged,
    /// Silenced by an operator until a time.
    Shelved,
    /// The machine is under maintenance.
    OutOfService,
}

impl AlarmState {
    /// The text for people, on pages and on the command line.
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

    /// Whether the condition exists, and no operator has silenced the alarm.
    pub const fn is_active(self) -> bool {
        matches!(self, Self::ActiveUnacknowledged | Self::ActiveAcknowledged)
    }

    /// Whether an operator has silenced the alarm.
    pub const fn is_silenced(self) -> bool {
        matches!(self, Self::Shelved | Self::OutOfService)
    }

    /// Name in messages and in the database.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// The watched daemons that do not run or are not connected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Away {
    /// Name of each, and the time when it disappeared; `None` if it was away at the start of this daemon.
    pub daemons: Vec<(MachineId, Option<Timestamp>)>,
    /// Whether this daemon itself has a link to others; without one, the fault may be its own.
    pub has_link: bool,
}

/// The second-best cause of a drift.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RunnerUp {
    /// The second-best cause.
    pub cause: Cause,
    /// Lead of the named cause: twice the logarithm of the odds between the two.
    pub margin: f64,
}

/// An event of an alarm with its evidence. Alarm message, snapshots and SQL have the same JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlarmEvent {
    /// Cause of the alarm.
    pub cause: Cause,
    /// Time of the raise; with machine and cause it identifies the alarm.
    pub raised_at: Timestamp,
    /// Number of the event, from 1.
    pub event_no: u32,
    /// Severity of the alarm.
    pub severity: Severity,
    /// State after the event.
    pub state: AlarmState,
    /// Time of the event.
    pub event_at: Timestamp,
    /// Size of the drift \[% from baseline\].
    pub change_pct: Option<f64>,
    /// Standard deviation of the size \[%\].
    pub change_pct_sd: Option<f64>,
    /// Direction of the drift; `None` for both.
    pub direction: Option<Direction>,
    /// The sensor, for alarms with [`Cause::Sensor`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub channel: Option<SensorChannel>,
    /// The second-best cause.
    pub runner_up: Option<RunnerUp>,
    /// The paper's three correlations.
    pub correlation: Option<Correlation>,
    /// First throw of the evidence.
    #[serde(flatten, with = "first_throw")]
    pub first_throw: Option<ThrowRef>,
    /// Last throw of the evidence.
    #[serde(flatten, with = "last_throw")]
    pub last_throw: Option<ThrowRef>,
    /// Text for people: what happened, how certain it is, what to check.
    pub text: String,
    /// Time of the text. If an operator's command caused this event, the text is that of an earlier event. `None` in
    /// databases of earlier versions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub text_at: Option<Timestamp>,
    /// Whether the condition ended; a shelved alarm shows it here only.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub over: bool,
    /// Operator who acknowledged the alarm, if it is acknowledged. Not published.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acknowledged_by: Option<String>,
    /// Forecast of the critical limit.
    pub limit_in_throws: Option<LimitForecast>,
    /// Operator whose command caused the event. Not published.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
    /// Reason given by the operator. Not published.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

impl AlarmEvent {
    /// The event with this size of the drift.
    pub(super) fn of_size(self, size: Level) -> Self {
        Self { change_pct: Some(size.pct()), change_pct_sd: Some(size.sd_pct()), ..self }
    }
}

/// JSON of a throw in the evidence: its number, and its boot, which is not published.
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
                /// Earlier versions stored the whole reference here.
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
