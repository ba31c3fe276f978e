//! Commands of operators to the monitor of a machine.

use jiff::Timestamp;
use serde::{Deserialize, Deserializer, Serialize, de::Error as _};

use crate::{
    diagnose::{AlarmEvent, AlarmState, Cause, Settings},
    throw::{Direction, MachineId, counted, utc},
};

/// A command of an operator to the monitor of a machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(tag = "command", rename_all = "snake_case", deny_unknown_fields)]
pub enum Command {
    /// Acknowledge an alarm.
    Ack {
        /// Cause of the alarm.
        cause: Cause,
        /// Name of the operator.
        by: String,
    },
    /// Silence an open alarm until a time.
    Shelve {
        /// Cause of the alarm.
        cause: Cause,
        /// End of the shelving, within `longest_shelving_days`.
        #[serde(deserialize_with = "until")]
        until: Timestamp,
        /// Name of the operator.
        by: String,
        /// Reason given by the operator.
        why: String,
    },
    /// End the shelving of an alarm.
    Unshelve {
        /// Cause of the alarm.
        cause: Cause,
        /// Name of the operator.
        by: String,
    },
    /// Start a new baseline from the next throws; drift alarms end.
    Rebaseline {
        /// Name of the operator.
        by: String,
        /// Reason given by the operator.
        why: String,
    },
    /// End the monitoring of a machine that was removed from the track. Its alarms end, and its monitor is deleted; a
    /// later throw counts as that of a new machine.
    Retire {
        /// Name of the operator.
        by: String,
        /// Reason given by the operator.
        why: String,
    },
    /// Take the machine out of service: its throws are not diagnosed and not added to a baseline. During maintenance,
    /// the command replaces end, operator and reason.
    MaintenanceStart {
        /// End of the maintenance, within `longest_shelving_days`.
        #[serde(deserialize_with = "until")]
        until: Timestamp,
        /// Name of the operator.
        by: String,
        /// Reason given by the operator.
        why: String,
    },
    /// Put the machine back into service.
    MaintenanceEnd {
        /// Name of the operator.
        by: String,
    },
}

/// Decodes `until`; the error names the field, unlike that of serde in a tagged enum.
fn until<'de, D: Deserializer<'de>>(value: D) -> Result<Timestamp, D::Error> {
    Timestamp::deserialize(value)
        .map_err(|error| D::Error::custom(format_args!("`until` is not a time, as 2026-05-04T06:00:00Z: {error}")))
}

/// A maintenance window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Maintenance {
    /// End of the window. `None` only in snapshots of version 1, which allowed windows without end; the next tick sets
    /// it.
    pub(crate) until: Option<Timestamp>,
}

/// A command that was not applied.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    /// No such alarm is open.
    #[error("no {0} alarm is open on this machine")]
    NoSuchAlarm(Cause),
    /// The alarm is acknowledged already.
    #[error("the {cause} alarm is acknowledged already, by {by}")]
    AlreadyAcknowledged {
        /// Cause of the alarm.
        cause: Cause,
        /// Operator who acknowledged it.
        by: String,
    },
    /// The alarm is not shelved.
    #[error("the {0} alarm is not shelved")]
    NotShelved(Cause),
    /// The time is in the past.
    #[error(
        "`until` is {}, but the clock of the daemon is at {}: give a later time, or correct the clock that is wrong",
        utc(until),
        utc(now)
    )]
    UntilIsPast {
        /// The given time.
        until: Timestamp,
        /// Time of the monitor's clock.
        now: Timestamp,
    },
    /// Shelving or maintenance would last longer than the settings allow.
    #[error(
        "`until` is more than {} after the clock of the daemon, which is at {}: give an earlier time (longest_shelving_days), or correct the clock that is wrong",
        counted(*days, "day"), utc(now)
    )]
    UntilTooFar {
        /// Time of the monitor's clock.
        now: Timestamp,
        /// The longest time allowed \[days\].
        days: u32,
    },
    /// The name or the reason is missing, too long or has control characters.
    #[error("`{field}` must hold 1 to {max} characters, no control characters among them", max = Command::MAX_TEXT)]
    Text {
        /// `by` or `why`.
        field: &'static str,
    },
    /// The machine is in service.
    #[error("the machine is not out of service")]
    NotInMaintenance,
}

impl Command {
    /// Longest `by` or `why` \[characters\]; both are part of the snapshot.
    pub const MAX_TEXT: usize = 200;

    /// Name of the command, as `ack`.
    pub fn name(&self) -> &'static str {
        self.into()
    }

    /// Name of the operator.
    pub fn by(&self) -> &str {
        match self {
            Self::Ack { by, .. }
            | Self::Shelve { by, .. }
            | Self::Unshelve { by, .. }
            | Self::Rebaseline { by, .. }
            | Self::Retire { by, .. }
            | Self::MaintenanceStart { by, .. }
            | Self::MaintenanceEnd { by } => by,
        }
    }

    /// Reason given by the operator.
    pub fn why(&self) -> Option<&str> {
        match self {
            Self::Shelve { why, .. }
            | Self::Rebaseline { why, .. }
            | Self::Retire { why, .. }
            | Self::MaintenanceStart { why, .. } => Some(why),
            Self::Ack { .. } | Self::Unshelve { .. } | Self::MaintenanceEnd { .. } => None,
        }
    }

    /// A further sentence for the operator, about the alarms that the command ended or brought back; empty without such
    /// alarms. `events` are those of the command.
    pub fn consequence(&self, events: &[AlarmEvent]) -> String {
        let is_last = |at: usize| events[at + 1..].iter().all(|later| later.cause != events[at].cause);
        let named = |are_active: bool| {
            let last = events.iter().enumerate().filter(|(at, _)| is_last(*at)).map(|(_, event)| event);
            let of_state = last.filter(|event| event.state.is_active() == are_active);
            let names: Vec<String> =
                of_state.map(|event| format!("{} {}", event.severity.as_str(), event.cause)).collect();
            names.join(", ")
        };
        let (ended, active) = (named(false), named(true));
        match self {
            Self::Rebaseline { .. } if !ended.is_empty() => {
                let in_maintenance = events.iter().any(|event| event.state == AlarmState::OutOfService);
                let when = if in_maintenance { " when the maintenance ends" } else { "" };
                format!(". Alarms that this ends{when}: {ended}. A fault that still exists is learned as normal")
            }
            Self::Retire { .. } if !ended.is_empty() => format!(". Alarms that this ends: {ended}"),
            Self::MaintenanceEnd { .. } if !active.is_empty() => {
                format!(". Alarms from before: {active}; the next throws show whether they are over")
            }
            _ => String::new(),
        }
    }

    /// A sentence for the operator after the command: the new state, its end, operator and reason. `learning`: for a
    /// machine that was learning before the command, the number of throws in the baseline of each direction, and the
    /// number needed; a second sentence says that a new baseline discards these throws.
    pub fn confirmation(&self, machine: &MachineId, learning: Option<[(usize, usize); 2]>) -> String {
        match self {
            Self::Ack { cause, by } => format!("the {cause} alarm of {machine} is acknowledged by {by}"),
            Self::Shelve { cause, until, by, why } => {
                format!("the {cause} alarm of {machine} is shelved until {} by {by}: {why}", utc(until))
            }
            Self::Unshelve { cause, by } => {
                format!("the {cause} alarm of {machine} is no longer shelved, ended by {by}")
            }
            Self::Rebaseline { by, why } => {
                let discarded = learning.map_or_else(String::new, |progress| {
                    let [normal, reverse] = progress.map(|(throws, needed)| format!("{throws} of {needed} throws"));
                    format!(
                        ". It was already learning, with {normal} {} and {reverse} {}, and begins again without them",
                        Direction::NormalToReverse,
                        Direction::ReverseToNormal
                    )
                });
                format!("{machine} takes a new baseline from its next throws, ordered by {by}: {why}{discarded}")
            }
            Self::Retire { by, why } => {
                format!("{machine} is no longer monitored, retired by {by}: {why}. Its history stays")
            }
            Self::MaintenanceStart { until, by, why } => {
                format!("{machine} is in maintenance until {} by {by}: {why}", utc(until))
            }
            Self::MaintenanceEnd { by } => format!("{machine} is in service again, ended by {by}"),
        }
    }

    /// Checks the texts and the time.
    ///
    /// # Errors
    /// When `by` or `why` is empty or too long, or `until` is past or too far ahead.
    pub fn validate(&self, now: Timestamp, settings: &Settings) -> Result<(), CommandError> {
        // Control characters could be commands to the terminal on which the text is shown.
        let fits = |text: &str| {
            !text.trim().is_empty() && text.chars().count() <= Self::MAX_TEXT && !text.chars().any(char::is_control)
        };
        if !fits(self.by()) {
            return Err(CommandError::Text { field: "by" });
        }
        if self.why().is_some_and(|why| !fits(why)) {
            return Err(CommandError::Text { field: "why" });
        }
        let (Self::Shelve { until, .. } | Self::MaintenanceStart { until, .. }) = *self else { return Ok(()) };
        if until <= now {
            Err(CommandError::UntilIsPast { until, now })
        } else if until.duration_since(now) > settings.longest_shelving() {
            Err(CommandError::UntilTooFar { days: settings.longest_shelving_days, now })
        } else {
            Ok(())
        }
    }
}
