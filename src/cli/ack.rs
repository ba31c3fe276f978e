//! `pointsd ack`: acknowledges an alarm.

use super::{
    Outcome,
    operator::{CauseArgument, MachineArgument, Sender},
};
use crate::diagnose::Command;

/// Acknowledges an open alarm; the daemon stores the name and the time.
///
/// Exit codes: 0 done; 1 the daemon refused; 64 an option is wrong; 69 no daemon answers; 78 the file of --config is
/// invalid.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd ack north/21B friction --by 'A. Meyer'")]
pub(super) struct Arguments {
    #[arg(value_name = "SITE/MACHINE")]
    machine: MachineArgument,
    /// Cause of the alarm, as `pointsd alarms` shows it.
    cause: CauseArgument,
    #[command(flatten)]
    sender: Sender,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let command = Command::Ack { cause: arguments.cause.0, by: arguments.sender.name()? };
    arguments.sender.send(&arguments.machine.0, &command)
}
