//! `pointsd check`: is this configuration right?

use std::path::PathBuf;

use super::{Exit, Outcome, ResultExt, database, output};
use crate::{daemon::config::Config, store};

/// Checks a configuration: every key, type, range, path and the zenoh section, and that the database is no other program's.
///
/// Exit codes: 0 it can be used; 78 it cannot, and one line on stderr says file, line, key and why.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd check --config config/pointsd.toml")]
pub(super) struct Arguments {
    /// The configuration.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let config = Config::load(&arguments.config).or_exit(Exit::Config)?;
    database::block_on(async { store::refuse_foreign(&config.store.path).await.or_exit(Exit::Config) })?;
    output::line(format_args!("{}: right", arguments.config.display()))?;
    Ok(Exit::Ok)
}
