//! `pointsd check`: checks a configuration.

use std::path::PathBuf;

use super::{Exit, Outcome, ResultExt, output, runtime};
use crate::{daemon::config::Config, store};

/// Checks a configuration: every key, type, range and path, the zenoh section, and that the file of the database is
/// neither text nor the database of another program.
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
    let config = Config::load(&arguments.config).or_exit(Exit::Config)?;
    runtime::block_on(async { store::refuse_foreign(&config.store.path).await.or_exit(Exit::Config) })?;
    output::line(format_args!("{}: valid", arguments.config.display()))?;
    Ok(Exit::Ok)
}
