//! The operators' commands that change something: `ack`, `shelve`, `maintenance`, `rebaseline` and `retire`.

use clap::Subcommand;
use jiff::SignedDuration;

use super::{
    Outcome,
    argument::{self, Window},
    operator::Sender,
};
use crate::diagnose::{Cause, Command};

/// Default length of a maintenance window: one shift.
const SHIFT: SignedDuration = SignedDuration::from_hours(8);

#[derive(Debug, Subcommand)]
pub(super) enum Operator {
    /// Acknowledges an open alarm; the daemon stores the name and the time.
    ///
    /// Exit codes: 0 done; 1 the daemon refused; 64 an option is wrong; 69 no daemon answers, or several serve the
    /// machine; 78 the file of --config is invalid.
    #[command(after_help = "Example:\n  pointsd ack north/21B friction --by 'A. Meyer'")]
    Ack {
        #[command(flatten)]
        sender: Sender,
        /// Cause of the alarm, as `pointsd alarms` shows it.
        #[arg(value_parser = argument::cause)]
        cause: Cause,
    },
    /// Shelves an open alarm until a given time, with a reason; or ends the shelving.
    ///
    /// Exit codes: 0 done; 1 the daemon refused; 64 an option is wrong; 69 no daemon answers, or several serve the
    /// machine; 78 the file of --config is invalid.
    #[command(after_help = "Examples:\n  pointsd shelve north/21B friction --for 8h --why 'greased tonight'\n  \
                            pointsd shelve north/21B friction --end")]
    Shelve {
        #[command(flatten)]
        sender: Sender,
        /// Cause of the alarm, as `pointsd alarms` shows it.
        #[arg(value_parser = argument::cause)]
        cause: Cause,
        #[command(flatten)]
        window: Window,
    },
    /// Starts a new baseline of a machine from its next throws, for example after maintenance. The old baseline stays
    /// in the history; drift alarms are cleared.
    ///
    /// Exit codes: 0 done; 1 the daemon refused; 64 an option is wrong; 69 no daemon answers, or several serve the
    /// machine; 78 the file of --config is invalid.
    #[command(after_help = "Example:\n  pointsd rebaseline north/21B --why 'motor replaced' --by 'A. Meyer'")]
    Rebaseline {
        #[command(flatten)]
        sender: Sender,
        /// Reason for the new baseline.
        #[arg(long, value_name = "TEXT")]
        why: String,
    },
    /// Takes a machine out of service: its throws are stored, but not diagnosed and not added to a baseline. The
    /// maintenance ends at the given time, by default after 8 hours. A new maintenance replaces one that has not ended.
    ///
    /// Exit codes: 0 done; 1 the daemon refused; 64 an option is wrong; 69 no daemon answers, or several serve the
    /// machine; 78 the file of --config is invalid.
    #[command(after_help = "Examples:\n  pointsd maintenance north/21B --why 'new slide chairs' --for 3d\n  \
                            pointsd maintenance north/21B --end")]
    Maintenance {
        #[command(flatten)]
        sender: Sender,
        #[command(flatten)]
        window: Window,
    },
    /// Ends the monitoring of a machine that was removed from the track. Its alarms end, and status, pages and
    /// `machine_health` no longer show it. Its history stays. Switch its logger off first: a later throw counts as that
    /// of a new machine, which learns a new baseline.
    ///
    /// Exit codes: 0 done; 1 the daemon refused; 64 an option is wrong; 69 no daemon answers, or several serve the
    /// machine; 78 the file of --config is invalid.
    #[command(after_help = "Example:\n  pointsd retire north/21B --why 'replaced by 21C' --by 'A. Meyer'")]
    Retire {
        #[command(flatten)]
        sender: Sender,
        /// Reason why the monitoring ends.
        #[arg(long, value_name = "TEXT")]
        why: String,
    },
}

pub(super) fn main(arguments: Operator) -> Outcome {
    match arguments {
        Operator::Ack { sender, cause } => sender.send(&Command::Ack { cause, by: sender.name()? }),
        Operator::Shelve { sender, cause, window } => {
            let by = sender.name()?;
            sender.send(&match window.bounds(None)? {
                Some((why, until)) => Command::Shelve { cause, until, by, why },
                None => Command::Unshelve { cause, by },
            })
        }
        Operator::Rebaseline { sender, why } => sender.send(&Command::Rebaseline { by: sender.name()?, why }),
        Operator::Maintenance { sender, window } => {
            let by = sender.name()?;
            sender.send(&match window.bounds(Some(SHIFT))? {
                Some((why, until)) => Command::MaintenanceStart { until, by, why },
                None => Command::MaintenanceEnd { by },
            })
        }
        Operator::Retire { sender, why } => sender.send(&Command::Retire { by: sender.name()?, why }),
    }
}
