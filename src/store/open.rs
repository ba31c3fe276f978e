//! Opening: create, check after an unclean stop, set aside what is broken, bring the schema up to date.
//!
//! The daemon must start whatever it finds. Files whose content is broken are renamed, never deleted, and a fresh
//! database takes their place; the report says so, and the daemon raises an alarm from it.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use jiff::Timestamp;
use sqlx::{
    ConnectOptions, Connection, SqliteConnection,
    migrate::{MigrateError, Migrator},
    sqlite::{SqliteAutoVacuum, SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous},
};

use super::{
    disk::Disk,
    error::{StoreError, is_corrupt, is_full},
    place::Place,
    settings::{MIB, Settings, Synchronous},
    statements as sql,
};

/// The schema's history, inside the program.
static MIGRATIONS: Migrator = sqlx::migrate!();

/// The log file is cut to this size when it is started anew \[bytes\].
const LOG_KEPT: u64 = 16 * MIB;
/// Longest wait for another program's write lock.
const BUSY: Duration = Duration::from_secs(5);

/// How the database was found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Found {
    /// There was none.
    Fresh,
    /// As a clean stop left it.
    Clean,
    /// As a crash or a power cut left it; checked, and sound.
    Unclean,
    /// Broken: renamed, and a fresh one begun. Somebody should look at it.
    SetAside {
        /// Where the broken database is now.
        to: PathBuf,
        /// What is wrong with it.
        why: String,
    },
}

/// What opening found and did.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Report {
    /// How the database was found.
    pub found: Found,
    /// Migrations that were applied now.
    pub upgraded_by: usize,
    /// A newer version of the program has used this database. Its additions are left alone.
    pub newer_schema: bool,
}

/// How the writer opens the database.
pub(super) fn writing(settings: &Settings) -> SqliteConnectOptions {
    let synchronous = match settings.synchronous {
        Synchronous::Full => SqliteSynchronous::Full,
        Synchronous::Normal => SqliteSynchronous::Normal,
    };
    SqliteConnectOptions::new()
        .filename(&settings.path)
        .create_if_missing(true)
        .auto_vacuum(SqliteAutoVacuum::Incremental)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(synchronous)
        .busy_timeout(BUSY)
        .pragma("journal_size_limit", LOG_KEPT.to_string())
        .disable_statement_logging()
}

/// How readers open the database.
pub(super) fn reading(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new().filename(path).read_only(true).busy_timeout(BUSY).disable_statement_logging()
}

/// Opens the writing connection; a broken database is set aside first.
pub(super) async fn open(
    settings: &Settings,
    disk: &Disk,
    place: &Place,
    now: Timestamp,
) -> Result<(SqliteConnection, Report), StoreError> {
    place.clear_leftovers()?;
    refuse_foreign(&settings.path).await?;
    if place.is_fresh() && place.log_bytes() > 0 {
        // SQLite would delete it, and with it what was committed last.
        let why = "the database is gone, and its write-ahead log is still there".to_owned();
        let to = place.set_log_aside(now)?;
        tracing::error!(to = %to.display(), %why, "the log was set aside; a fresh database begins");
        let (connection, report) = prepare(settings, disk, true).await.map_err(|trouble| trouble.told(settings))?;
        return Ok((connection, Report { found: Found::SetAside { to, why }, ..report }));
    }
    match prepare(settings, disk, place.is_fresh()).await {
        Err(Trouble::Broken(why)) => {
            let to = place.set_aside(now)?;
            tracing::error!(to = %to.display(), %why, "the database is broken and was set aside; a fresh one begins");
            let (connection, report) = prepare(settings, disk, true).await.map_err(|trouble| trouble.told(settings))?;
            Ok((connection, Report { found: Found::SetAside { to, why }, ..report }))
        }
        outcome => outcome.map_err(|trouble| trouble.told(settings)),
    }
}

/// Makes sure that a file, where there is one, is not the database of another program, which must not be written to. What
/// cannot be read here is looked into when it is opened for writing.
///
/// # Errors
/// When it is.
pub async fn refuse_foreign(path: &Path) -> Result<(), StoreError> {
    if Place::new(path).is_fresh() {
        return Ok(());
    }
    let Ok(mut connection) = SqliteConnection::connect_with(&reading(path)).await else { return Ok(()) };
    let table: sqlx::Result<Option<String>> =
        sqlx::query_scalar(sql::FOREIGN_TABLE).fetch_optional(&mut connection).await;
    // It was read; how the file is let go changes nothing.
    let _ = connection.close().await;
    match table {
        Ok(Some(table)) => Err(StoreError::Foreign { path: path.to_owned(), table }),
        _ => Ok(()),
    }
}

enum Trouble {
    /// The content is broken.
    Broken(String),
    /// The files cannot be accessed.
    Access(sqlx::Error),
    Migration(MigrateError),
    TooNew {
        needed: i64,
        known: i64,
    },
}

impl Trouble {
    fn told(self, settings: &Settings) -> StoreError {
        let path = settings.path.clone();
        match self {
            Self::Broken(why) => StoreError::Open { path, source: Box::new(sqlx::Error::Protocol(why)) },
            Self::Access(error) if is_full(&error) => StoreError::Full,
            Self::Access(source) => StoreError::Open { path, source: Box::new(source) },
            Self::Migration(source) => StoreError::Migrate { path, source: Box::new(source) },
            Self::TooNew { needed, known } => StoreError::TooNew { path, needed, known },
        }
    }
}

impl From<sqlx::Error> for Trouble {
    fn from(error: sqlx::Error) -> Self {
        if is_corrupt(&error) { Self::Broken(error.to_string()) } else { Self::Access(error) }
    }
}

impl From<MigrateError> for Trouble {
    fn from(error: MigrateError) -> Self {
        match error {
            MigrateError::Execute(error) | MigrateError::ExecuteMigration(error, _) => error.into(),
            error @ (MigrateError::VersionMismatch(_) | MigrateError::Dirty(_)) => Self::Broken(error.to_string()),
            error => Self::Migration(error),
        }
    }
}

/// Opens, and once more with the ballast given up when the disk is full.
async fn prepare(settings: &Settings, disk: &Disk, fresh: bool) -> Result<(SqliteConnection, Report), Trouble> {
    match prepare_once(settings, fresh).await {
        Err(Trouble::Access(error)) if is_full(&error) => {
            disk.note_failure(true);
            prepare_once(settings, fresh).await
        }
        outcome => outcome,
    }
}

async fn prepare_once(settings: &Settings, fresh: bool) -> Result<(SqliteConnection, Report), Trouble> {
    let mut connection = SqliteConnection::connect_with(&writing(settings)).await?;
    let needed: i64 = sqlx::query_scalar("PRAGMA user_version").fetch_one(&mut connection).await?;
    let known = newest_known();
    if needed > known {
        return Err(Trouble::TooNew { needed, known });
    }
    let before = applied(&mut connection).await?;
    let found = match (fresh, before.is_empty()) {
        (true, _) | (false, true) => Found::Fresh,
        (false, false) if stopped_cleanly(&mut connection).await? => Found::Clean,
        (false, false) => {
            check(&mut connection).await?;
            Found::Unclean
        }
    };
    migrator().run(&mut connection).await?;
    sqlx::query(sql::SET_CLEAN).bind(false).execute(&mut connection).await?;
    let known = |version: &i64| MIGRATIONS.iter().any(|migration| migration.version == *version);
    let newer_schema = before.iter().any(|version| !known(version));
    let upgraded_by = applied(&mut connection).await?.len() - before.len();
    Ok((connection, Report { found, upgraded_by, newer_schema }))
}

/// The newest migration of this program.
fn newest_known() -> i64 {
    MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0)
}

/// A database of a newer version is opened too, so that an upgrade can be rolled back: migrations add, and what they add
/// an older program leaves alone. One that an older program must not write to says so by `PRAGMA user_version = N`,
/// its own number: then only programs that know migration N open the database.
fn migrator() -> Migrator {
    let mut migrator = Migrator { migrations: MIGRATIONS.migrations.clone(), ..Migrator::DEFAULT };
    migrator.set_ignore_missing(true);
    migrator
}

/// Versions of the migrations that the database has.
async fn applied(connection: &mut SqliteConnection) -> sqlx::Result<Vec<i64>> {
    let there: bool = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = '_sqlx_migrations')")
        .fetch_one(&mut *connection)
        .await?;
    if !there {
        return Ok(Vec::new());
    }
    sqlx::query_scalar("SELECT version FROM _sqlx_migrations WHERE success ORDER BY version")
        .fetch_all(connection)
        .await
}

async fn stopped_cleanly(connection: &mut SqliteConnection) -> sqlx::Result<bool> {
    let there: bool = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = 'shutdown')")
        .fetch_one(&mut *connection)
        .await?;
    Ok(there && sqlx::query_scalar(sql::CLEAN).fetch_optional(connection).await?.unwrap_or(false))
}

async fn check(connection: &mut SqliteConnection) -> Result<(), Trouble> {
    let findings: Vec<String> = sqlx::query_scalar("PRAGMA quick_check(5)").fetch_all(connection).await?;
    if findings == ["ok"] { Ok(()) } else { Err(Trouble::Broken(findings.join("; "))) }
}
