//! `pointsd rebaseline`: what is normal has changed.

use super::{
    Outcome,
    operator::{MachineArgument, Sender},
};
use crate::diagnose::Command;

/// Takes the baseline of a machine again from its next throws, for example after maintenance. The old one stays in
/// the history; drift alarms end.
///
/// Exit codes: 0 done; 1 the daemon says no; 69 no daemon answers.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd rebaseline north/21B --why 'motor replaced' --by 'A. Meyer'")]
pub(super) struct Arguments {
    #[arg(value_name = "SITE/MACHINE")]
    machine: MachineArgument,
    /// Why.
    #[arg(long, value_name = "TEXT")]
    why: String,
    #[command(flatten)]
    sender: Sender,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let command = Command::Rebaseline { by: arguments.sender.name()?, why: arguments.why.clone() };
    arguments.sender.send(&arguments.machine.0, &command)
}
