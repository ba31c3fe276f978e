//! `pointsd check`: checks a configuration.

use std::path::PathBuf;

use super::{Exit, Outcome, ResultExt, output, runtime};
use crate::{
    daemon::config::{Config, Document},
    store::{self, StoreError},
};

/// Checks a configuration: every key, type, range and path, the zenoh section, and the file of the database. The file
/// must be writable, and must not be text, or the database of another program or of a newer version.
///
/// Exit codes: 0 valid; 78 invalid, with file, line, key and reason in one line on stderr.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd check --config config/pointsd.toml")]
pub(super) struct Arguments {
    /// The configuration file.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let document = Document::read(&arguments.config).or_exit(Exit::Config)?;
    let config = Config::from_document(&document).or_exit(Exit::Config)?;
    // For the same problem `pointsd run` exits with 74, so that systemd starts it again: the right to write may be
    // missing only for a moment.
    if let Some(file) = store::unwritable(&config.store.path) {
        let problem = format!(
            "this user cannot write to {}: the user of pointsd must own the database, its -wal and its -shm, and may \
             write to them",
            file.display()
        );
        return Err(document.error_at("store.path", problem)).or_exit(Exit::Config);
    }
    runtime::block_on(async {
        let foreign = |error: StoreError| document.error_at("store.path", error.to_string());
        store::refuse_foreign(&config.store.path).await.map_err(foreign).or_exit(Exit::Config)
    })?;
    for warning in config.warnings() {
        output::line(format_args!("{}: warning: {warning}", arguments.config.display()))?;
    }
    output::line(format_args!("{}: valid", arguments.config.display()))?;
    Ok(Exit::Ok)
}
