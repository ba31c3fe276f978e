//! `pointsd check`: checks a configuration.

use std::path::{Path, PathBuf};

use rustix::fs::{Access, access};

use super::{Exit, Outcome, ResultExt, output, runtime};
use crate::{
    daemon::config::{Config, Document},
    store::{self, StoreError},
};

/// Checks a configuration: every key, type, range and path, the zenoh section, and that the file of the database is
/// neither text nor the database of another program, and writable.
///
/// Exit codes: 0 valid; 78 invalid, with file, line, key and reason in one line on stderr.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd check --config config/pointsd.toml")]
pub(super) struct Arguments {
    /// The configuration file.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
}

/// A file of the database that exists and that this user may not write. The daemon itself is restarted then, as the file
/// may be that of another program for a moment.
fn unwritable(database: &Path) -> Option<PathBuf> {
    let closed = |file: &PathBuf| access(file, Access::READ_OK | Access::WRITE_OK).is_err();
    ["", "-wal", "-shm"]
        .map(|suffix| store::beside(database, suffix))
        .into_iter()
        .find(|file| file.exists() && closed(file))
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let document = Document::read(&arguments.config).or_exit(Exit::Config)?;
    let config = Config::from_document(&document).or_exit(Exit::Config)?;
    if let Some(file) = unwritable(&config.store.path) {
        let problem = format!(
            "this user cannot write to {}: the database, its -wal and its -shm must belong to the user of pointsd",
            file.display()
        );
        return Err(document.complain("store.path", problem)).or_exit(Exit::Config);
    }
    runtime::block_on(async {
        let foreign = |error: StoreError| document.complain("store.path", error.to_string());
        store::refuse_foreign(&config.store.path).await.map_err(foreign).or_exit(Exit::Config)
    })?;
    for warning in config.warnings() {
        output::line(format_args!("{}: warning: {warning}", arguments.config.display()))?;
    }
    output::line(format_args!("{}: valid", arguments.config.display()))?;
    Ok(Exit::Ok)
}
