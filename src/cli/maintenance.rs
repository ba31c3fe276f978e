//! `pointsd maintenance`: a machine goes out of service, or is back.

use jiff::SignedDuration;

use super::{
    Outcome,
    operator::{End, MachineArgument, Sender},
};
use crate::diagnose::Command;

/// Length of a maintenance window that the command line does not limit: one shift.
const SHIFT: SignedDuration = SignedDuration::from_hours(8);

/// Takes a machine out of service: its throws are stored, but not diagnosed, and never enter a baseline. The window always
/// ends, after 8 hours where neither --for nor --until says when.
///
/// Exit codes: 0 done; 1 the daemon says no; 64 an option is wrong; 69 no daemon answers.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  pointsd maintenance north/21B --why 'new slide chairs' --for 3d\n  \
                        pointsd maintenance north/21B --end")]
pub(super) struct Arguments {
    #[arg(value_name = "SITE/MACHINE")]
    machine: MachineArgument,
    /// Why.
    #[arg(long, value_name = "TEXT", required_unless_present = "end")]
    why: Option<String>,
    #[command(flatten)]
    end_at: End,
    /// The machine is in service again.
    #[arg(long, conflicts_with_all = ["why", "length", "until"])]
    end: bool,
    #[command(flatten)]
    sender: Sender,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let by = arguments.sender.name()?;
    let command = if arguments.end {
        Command::MaintenanceEnd { by }
    } else {
        let until = arguments.end_at.at(Some(SHIFT))?;
        Command::MaintenanceStart { until, by, why: arguments.why.clone().unwrap_or_default() }
    };
    arguments.sender.send(&arguments.machine.0, &command)
}
