//! What an operator asks of a machine's monitor.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::{event::Cause, settings::Settings};
use crate::throw::MachineId;

/// A command of an operator to a machine's monitor.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(tag = "command", rename_all = "snake_case", deny_unknown_fields)]
pub enum Command {
    /// Somebody has seen the alarm.
    Ack {
        /// Which alarm.
        cause: Cause,
        /// Who.
        by: String,
    },
    /// Silence an open alarm until a time.
    Shelve {
        /// Which alarm.
        cause: Cause,
        /// Until when.
        until: Timestamp,
        /// Who.
        by: String,
        /// Why.
        why: String,
    },
    /// End the shelving of an alarm.
    Unshelve {
        /// Which alarm.
        cause: Cause,
        /// Who.
        by: String,
    },
    /// Take the baseline again from the next throws; drift alarms end.
    Rebaseline {
        /// Who.
        by: String,
        /// Why.
        why: String,
    },
    /// The machine goes out of service: its throws are not diagnosed and never enter a baseline.
    MaintenanceStart {
        /// When the window ends by itself: within `longest_shelving_days`.
        until: Timestamp,
        /// Who.
        by: String,
        /// Why.
        why: String,
    },
    /// The machine is in service again.
    MaintenanceEnd {
        /// Who.
        by: String,
    },
}

/// Why a command was not carried out.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    /// No such alarm is open.
    #[error("no {} alarm is open on this machine", cause.as_str())]
    NoSuchAlarm {
        /// The cause asked for.
        cause: Cause,
    },
    /// The alarm was acknowledged before.
    #[error("the {} alarm is acknowledged already, by {by}", cause.as_str())]
    AlreadyAcknowledged {
        /// The cause asked for.
        cause: Cause,
        /// Who acknowledged it.
        by: String,
    },
    /// The alarm is not shelved.
    #[error("the {} alarm is not shelved", cause.as_str())]
    NotShelved {
        /// The cause asked for.
        cause: Cause,
    },
    /// The time is past.
    #[error("`until` is {until}, which is past: give a time after {now}")]
    UntilIsPast {
        /// The time given.
        until: Timestamp,
        /// The monitor's clock.
        now: Timestamp,
    },
    /// Shelving or maintenance would last longer than the settings allow.
    #[error("`until` is more than {days} days ahead: give an earlier time (longest_shelving_days)")]
    UntilTooFar {
        /// The longest time allowed \[days\].
        days: u32,
    },
    /// Who, or why, is missing or too long.
    #[error("`{field}` must hold 1 to {max} characters, no control characters among them", max = Command::MAX_TEXT)]
    Text {
        /// `by` or `why`.
        field: &'static str,
    },
    /// The machine is out of service already.
    #[error("the machine is out of service already")]
    InMaintenance,
    /// The machine is in service.
    #[error("the machine is not out of service")]
    NotInMaintenance,
}

impl Command {
    /// Longest `by` or `why` \[characters\]: both are kept in the monitor's state.
    pub const MAX_TEXT: usize = 200;

    /// The command's word, as `ack`.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.into()
    }

    /// Who asks.
    #[must_use]
    pub fn by(&self) -> &str {
        match self {
            Self::Ack { by, .. }
            | Self::Shelve { by, .. }
            | Self::Unshelve { by, .. }
            | Self::Rebaseline { by, .. }
            | Self::MaintenanceStart { by, .. }
            | Self::MaintenanceEnd { by } => by,
        }
    }

    /// Why, where the command says so.
    #[must_use]
    pub fn why(&self) -> Option<&str> {
        match self {
            Self::Shelve { why, .. } | Self::Rebaseline { why, .. } | Self::MaintenanceStart { why, .. } => Some(why),
            Self::Ack { .. } | Self::Unshelve { .. } | Self::MaintenanceEnd { .. } => None,
        }
    }

    /// One sentence for the operator once the command is carried out: what holds now, until when, by whom and why.
    #[must_use]
    pub fn confirmation(&self, machine: &MachineId) -> String {
        let time = |at: &Timestamp| at.strftime("%Y-%m-%d %H:%M:%S UTC").to_string();
        match self {
            Self::Ack { cause, by } => format!("the {cause} alarm of {machine} is acknowledged by {by}"),
            Self::Shelve { cause, until, by, why } => {
                format!("the {cause} alarm of {machine} is shelved until {} by {by}: {why}", time(until))
            }
            Self::Unshelve { cause, by } => {
                format!("the {cause} alarm of {machine} is no longer shelved, ended by {by}")
            }
            Self::Rebaseline { by, why } => {
                format!("{machine} takes a new baseline from its next throws, ordered by {by}: {why}")
            }
            Self::MaintenanceStart { until, by, why } => {
                format!("{machine} is in maintenance until {} by {by}: {why}", time(until))
            }
            Self::MaintenanceEnd { by } => format!("{machine} is in service again, ended by {by}"),
        }
    }

    /// Checks the texts and the time.
    ///
    /// # Errors
    /// When `by` or `why` is empty or too long, or `until` is past or too far ahead.
    pub fn validate(&self, now: Timestamp, settings: &Settings) -> Result<(), CommandError> {
        // A control character could rewrite the terminal on which the text is read.
        let fits = |text: &str| {
            (1..=Self::MAX_TEXT).contains(&text.trim().chars().count()) && !text.chars().any(char::is_control)
        };
        if !fits(self.by()) {
            return Err(CommandError::Text { field: "by" });
        }
        if self.why().is_some_and(|why| !fits(why)) {
            return Err(CommandError::Text { field: "why" });
        }
        let until = match self {
            Self::Shelve { until, .. } | Self::MaintenanceStart { until, .. } => Some(*until),
            _ => None,
        };
        let days = settings.longest_shelving_days;
        match until {
            Some(until) if until <= now => Err(CommandError::UntilIsPast { until, now }),
            Some(until) if until.duration_since(now) > settings.longest_shelving() => {
                Err(CommandError::UntilTooFar { days })
            }
            _ => Ok(()),
        }
    }
}
