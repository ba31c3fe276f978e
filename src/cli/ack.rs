//! `pointsd ack`: somebody has seen an alarm.

use super::{
    Outcome,
    operator::{CauseArgument, MachineArgument, Sender},
};
use crate::diagnose::Command;

/// Acknowledges an open alarm: who and when are kept.
///
/// Exit codes: 0 done; 1 the daemon says no; 69 no daemon answers.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd ack north/21B friction --by 'A. Meyer'")]
pub(super) struct Arguments {
    #[arg(value_name = "SITE/MACHINE")]
    machine: MachineArgument,
    /// The alarm's cause, as `pointsd alarms` shows it.
    cause: CauseArgument,
    #[command(flatten)]
    sender: Sender,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let command = Command::Ack { cause: arguments.cause.0, by: arguments.sender.name()? };
    arguments.sender.send(&arguments.machine.0, &command)
}
