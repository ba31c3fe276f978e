//! `pointsd rebaseline`: starts a new baseline.

use super::{
    Outcome,
    operator::{MachineArgument, Sender},
};
use crate::diagnose::Command;

/// Starts a new baseline of a machine from its next throws, for example after maintenance. The old baseline stays in
/// the history; drift alarms are cleared.
///
/// Exit codes: 0 done; 1 the daemon refused; 64 an option is wrong; 69 no daemon answers; 78 the file of --config is
/// invalid.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd rebaseline north/21B --why 'motor replaced' --by 'A. Meyer'")]
pub(super) struct Arguments {
    #[arg(value_name = "SITE/MACHINE")]
    machine: MachineArgument,
    /// Reason for the new baseline.
    #[arg(long, value_name = "TEXT")]
    why: String,
    #[command(flatten)]
    sender: Sender,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let command = Command::Rebaseline { by: arguments.sender.name()?, why: arguments.why.clone() };
    arguments.sender.send(&arguments.machine.0, &command)
}
