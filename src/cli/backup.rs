//! `pointsd backup`: a consistent copy of the database, also while the daemon runs.

use std::{path::PathBuf, time::Duration};

use clap::Args;

use super::{Exit, Failure, Outcome, database::Location, output, runtime::block_on};
use crate::{
    daemon::clock,
    store::{Backup, StoreError},
};

/// Time between two updates of the progress bar.
const REDRAW: Duration = Duration::from_millis(100);

/// Copies the database to a new file, also while the daemon runs.
///
/// The copy is one consistent state, compact and checked. FILE appears when the copy is complete. To restore it, stop
/// the daemon, move away all files whose names begin with the name of the database (which may be a link to one of
/// them), and put the copy in its place.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  pointsd backup --config /etc/pointsd/pointsd.toml /mnt/usb/points-2026-03-01.db\n\n\
    Exit codes: 0 copied, 65 the file is no database of pointsd, 66 there is no database, or it cannot be opened, 73 the copy cannot be created, 74 reading or writing failed, 78 the configuration is invalid."
)]
pub(super) struct Arguments {
    /// The new file.
    #[arg(value_name = "FILE")]
    to: PathBuf,
    #[command(flatten)]
    location: Location,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let from = arguments.location.find()?;
    let failure = |error: StoreError| {
        let exit = match error {
            StoreError::File { .. } => Exit::CannotCreate,
            StoreError::Open { .. } => Exit::NoInput,
            StoreError::Foreign(_) => Exit::Data,
            _ => Exit::Io,
        };
        Failure::new(exit, error)
    };
    let backup = Backup::new(&from, &arguments.to).map_err(failure)?;
    let template = "copying {wide_bar} {bytes} of about {total_bytes}, {eta} left";
    let bar = output::progress(backup.total_bytes(), template);
    let bytes = block_on(async {
        let copy = backup.run();
        tokio::pin!(copy);
        let mut redraw = clock::every(REDRAW);
        loop {
            tokio::select! {
                outcome = &mut copy => return outcome.map_err(failure),
                _ = redraw.tick() => bar.set_position(backup.copied_bytes()),
            }
        }
    })?;
    bar.finish_and_clear();
    output::line(format_args!("{} copied to {}: {bytes} bytes, checked", from.display(), arguments.to.display()))?;
    Ok(Exit::Ok)
}
