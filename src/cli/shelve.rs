//! `pointsd shelve`: silences an open alarm for some time.

use super::{
    Outcome,
    operator::{CauseArgument, End, MachineArgument, Sender},
};
use crate::diagnose::Command;

/// Shelves an open alarm until a given time, with a reason; or ends the shelving.
///
/// Exit codes: 0 done; 1 the daemon refused; 64 an option is wrong; 69 no daemon answers; 78 the file of --config is
/// invalid.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  pointsd shelve north/21B friction --for 8h --why 'greased tonight'\n  \
                        pointsd shelve north/21B friction --end")]
pub(super) struct Arguments {
    #[arg(value_name = "SITE/MACHINE")]
    machine: MachineArgument,
    /// Cause of the alarm, as `pointsd alarms` shows it.
    cause: CauseArgument,
    #[command(flatten)]
    end_at: End,
    /// Reason for the shelving.
    #[arg(long, value_name = "TEXT", required_unless_present = "end")]
    why: Option<String>,
    /// End the shelving now.
    #[arg(long, conflicts_with_all = ["length", "until", "why"])]
    end: bool,
    #[command(flatten)]
    sender: Sender,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let (cause, by) = (arguments.cause.0, arguments.sender.name()?);
    let command = if arguments.end {
        Command::Unshelve { cause, by }
    } else {
        let until = arguments.end_at.at(None)?;
        Command::Shelve { cause, until, by, why: arguments.why.clone().unwrap_or_default() }
    };
    arguments.sender.send(&arguments.machine.0, &command)
}
