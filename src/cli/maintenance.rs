//! `pointsd maintenance`: a machine goes out of service, or is back.

use jiff::Timestamp;

use super::{
    Outcome,
    operator::{MachineArgument, Sender},
};
use crate::diagnose::Command;

/// Takes a machine out of service: its throws are stored, but not diagnosed, and never enter a baseline.
///
/// Exit codes: 0 done; 1 the daemon says no; 69 no daemon answers.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  pointsd maintenance north/21B --why 'new slide chairs' --until 2026-05-04T06:00:00Z\n  \
                        pointsd maintenance north/21B --end"
)]
pub(super) struct Arguments {
    #[arg(value_name = "SITE/MACHINE")]
    machine: MachineArgument,
    /// Why.
    #[arg(long, value_name = "TEXT", required_unless_present = "end")]
    why: Option<String>,
    /// When it ends by itself, RFC 3339.
    #[arg(long, value_name = "TIME")]
    until: Option<Timestamp>,
    /// The machine is in service again.
    #[arg(long, conflicts_with_all = ["why", "until"])]
    end: bool,
    #[command(flatten)]
    sender: Sender,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let by = arguments.sender.name()?;
    let command = if arguments.end {
        Command::MaintenanceEnd { by }
    } else {
        Command::MaintenanceStart { until: arguments.until, by, why: arguments.why.clone().unwrap_or_default() }
    };
    arguments.sender.send(&arguments.machine.0, &command)
}
