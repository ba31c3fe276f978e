//! Which database a command is about.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;

use super::{Exit, Failure, ResultExt};
use crate::store;

/// The configuration of the service, where its package puts it.
const SERVICE: &str = "/etc/pointsd/pointsd.toml";

/// Where the database is.
#[derive(Debug, Args)]
pub(super) struct Location {
    /// The database file. Without this and --config: points.db in this folder, else the one of the installed service.
    #[arg(long, value_name = "FILE", conflicts_with = "config")]
    database: Option<PathBuf>,
    /// Take the path from this configuration.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

impl Location {
    /// The database file: as given, as configured, the one in this folder, or that of the service; it is there.
    pub(super) fn find(&self) -> Result<PathBuf, Failure> {
        let path = match (&self.database, &self.config) {
            (Some(path), _) => path.clone(),
            (None, Some(config)) => configured(config)?,
            (None, None) => {
                let here = store::Settings::default().path;
                let service = Path::new(SERVICE);
                if !here.exists() && service.exists() { configured(service)? } else { here }
            }
        };
        match std::fs::metadata(&path) {
            Ok(_) => Ok(path),
            Err(error) => Err(anyhow::Error::new(error))
                .with_context(|| {
                    format!("no database at {}; name it with --database FILE or --config FILE", path.display())
                })
                .or_exit(Exit::NoInput),
        }
    }
}

/// The key `path` of the section `[store]`.
fn configured(config: &Path) -> Result<PathBuf, Failure> {
    let text = std::fs::read_to_string(config)
        .with_context(|| format!("cannot read {}", config.display()))
        .or_exit(Exit::NoInput)?;
    let table: toml::Table =
        toml::from_str(&text).with_context(|| config.display().to_string()).or_exit(Exit::Config)?;
    let path = table.get("store").and_then(|section| section.get("path")).and_then(toml::Value::as_str);
    Ok(path.map_or_else(|| store::Settings::default().path, PathBuf::from))
}

/// Runs one command's database work.
pub(super) fn block_on<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the runtime")
        .or_exit(Exit::Software)?;
    runtime.block_on(work)
}
