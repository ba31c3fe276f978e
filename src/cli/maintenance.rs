//! `pointsd maintenance`: starts or ends the maintenance of a machine.

use jiff::SignedDuration;

use super::{
    Outcome,
    operator::{End, MachineArgument, Sender},
};
use crate::diagnose::Command;

/// Default length of a maintenance window: one shift.
const SHIFT: SignedDuration = SignedDuration::from_hours(8);

/// Takes a machine out of service: its throws are stored, but not diagnosed and not added to a baseline. The window
/// ends at the given time, by default after 8 hours.
///
/// Exit codes: 0 done; 1 the daemon refused; 64 an option is wrong; 69 no daemon answers; 78 the file of --config is
/// invalid.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  pointsd maintenance north/21B --why 'new slide chairs' --for 3d\n  \
                        pointsd maintenance north/21B --end")]
pub(super) struct Arguments {
    #[arg(value_name = "SITE/MACHINE")]
    machine: MachineArgument,
    /// Reason for the maintenance.
    #[arg(long, value_name = "TEXT", required_unless_present = "end")]
    why: Option<String>,
    #[command(flatten)]
    end_at: End,
    /// End the maintenance now.
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
