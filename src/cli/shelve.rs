//! `pointsd shelve`: silence an open alarm for a while.

use jiff::{SignedDuration, Timestamp};

use super::{
    Exit, Failure, Outcome,
    operator::{CauseArgument, MachineArgument, Sender},
};
use crate::{daemon::clock, diagnose::Command};

/// Shelves an open alarm until a time, for a reason; or ends that.
///
/// Exit codes: 0 done; 1 the daemon says no; 64 an option is wrong; 69 no daemon answers.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  pointsd shelve north/21B friction --for 8h --why 'greased tonight'\n  \
                        pointsd shelve north/21B friction --end")]
pub(super) struct Arguments {
    #[arg(value_name = "SITE/MACHINE")]
    machine: MachineArgument,
    /// The alarm's cause, as `pointsd alarms` shows it.
    cause: CauseArgument,
    /// How long, as 90m, 8h or 72h.
    #[arg(long = "for", value_name = "DURATION", conflicts_with = "until")]
    duration: Option<SignedDuration>,
    /// Until when, RFC 3339, as 2026-05-04T06:00:00Z.
    #[arg(long, value_name = "TIME")]
    until: Option<Timestamp>,
    /// Why.
    #[arg(long, value_name = "TEXT", required_unless_present = "end")]
    why: Option<String>,
    /// End the shelving now.
    #[arg(long, conflicts_with_all = ["duration", "until", "why"])]
    end: bool,
    #[command(flatten)]
    sender: Sender,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let (cause, by) = (arguments.cause.0, arguments.sender.name()?);
    let command = if arguments.end {
        Command::Unshelve { cause, by }
    } else {
        Command::Shelve { cause, until: until(arguments)?, by, why: arguments.why.clone().unwrap_or_default() }
    };
    arguments.sender.send(&arguments.machine.0, &command)
}

fn until(arguments: &Arguments) -> Result<Timestamp, Failure> {
    let usage = |problem: &str| Failure { exit: Exit::Usage, error: anyhow::anyhow!(problem.to_owned()) };
    match (arguments.until, arguments.duration) {
        (Some(until), _) => Ok(until),
        (None, Some(duration)) => clock::now().checked_add(duration).map_err(|_| usage("--for is too long")),
        (None, None) => Err(usage("until when? --for 8h, or --until 2026-05-04T06:00:00Z")),
    }
}
