//! The option that selects the database of a command.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::Args;
use serde::Deserialize;

use super::{Exit, Failure, ResultExt};
use crate::{
    daemon::config::{Document, check_sections},
    store::{self, StoreError},
};

/// Configuration of the installed service.
const SERVICE: &str = "/etc/pointsd/pointsd.toml";

/// The options for the path of the database.
#[derive(Debug, Args)]
pub(super) struct Location {
    /// The database file [default without --config: points.db in this folder, else that of the installed service].
    #[arg(long, value_name = "FILE", conflicts_with = "config")]
    database: Option<PathBuf>,
    /// The configuration file with the path of the database.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

impl Location {
    /// The configuration file with the path of the database, from --config, or that of the installed service. `None` if
    /// --database is given, or this folder has a `points.db`.
    pub(super) fn config(&self) -> Option<&Path> {
        let may_be_service = self.database.is_none() && !store::Settings::default().path.exists();
        let service = || Some(Path::new(SERVICE)).filter(|service| may_be_service && service.exists());
        self.config.as_deref().or_else(service)
    }

    /// The path of an existing database: from --database, from --config, in this folder, or of the installed service.
    pub(super) fn find(&self) -> Result<PathBuf, Failure> {
        let path = match (&self.database, self.config()) {
            (Some(path), _) => path.clone(),
            (None, Some(config)) => configured(config)?,
            (None, None) => store::Settings::default().path,
        };
        match std::fs::metadata(&path) {
            Ok(file) if file.is_file() && file.len() == 0 => {
                Err(anyhow!("no database at {}: the file is empty", path.display())).or_exit(Exit::NoInput)
            }
            Ok(_) => Ok(path),
            Err(error) => Err(anyhow::Error::new(error))
                .with_context(|| {
                    format!("no database at {}; name it with --database FILE or --config FILE", path.display())
                })
                .or_exit(Exit::NoInput),
        }
    }
}

/// The failure of reading a database: it cannot be opened, reading or writing failed, or the file or the statement is
/// not usable.
pub(super) fn unreadable(error: StoreError) -> Failure {
    let exit = match error {
        StoreError::Open { .. } | StoreError::Empty(_) | StoreError::Damaged { .. } => Exit::NoInput,
        StoreError::Foreign(_) | StoreError::Schema(_) | StoreError::Statement(_) | StoreError::SeveralStatements => {
            Exit::Data
        }
        _ => Exit::Io,
    };
    Failure::new(exit, error)
}

/// The path of the database in a configuration file. Only the names of the sections and `[store]` are checked: a misspelt
/// one would select another database. The content of the other sections may be invalid.
fn configured(config: &Path) -> Result<PathBuf, Failure> {
    #[derive(Deserialize)]
    struct Section {
        #[serde(default)]
        store: store::Settings,
    }
    let section = Document::read(config).and_then(|document| {
        check_sections(&document)?;
        document.deserialize::<Section>()
    });
    Ok(section.or_exit(Exit::Config)?.store.path)
}
