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

use tokio::time::Instant;

use super::{
    disk::Disk,
    error::{StoreError, is_corrupt, is_full, is_interrupted},
    place::Place,
    salvage::{Salvaged, salvage},
    settings::{MIB, Settings, Synchronous},
    statements as sql,
};

/// The schema's history, inside the program.
static MIGRATIONS: Migrator = sqlx::migrate!();

/// The log file is cut to this size when it is started anew \[bytes\].
const LOG_KEPT: u64 = 16 * MIB;
/// Longest check of a database that was stopped cleanly: 644 MB take 0.3 s, so this reads about 10 GB.
const CHECK_LIMIT: Duration = Duration::from_secs(5);
/// Steps of SQLite's machine between two looks at the clock.
const CHECK_STEPS: i32 = 10_000;
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
    /// Broken: renamed, and a fresh one begun with what could be read of it. Somebody should look at it.
    SetAside {
        /// Where the broken database is now.
        to: PathBuf,
        /// Why it is no throw, or no throw to be stored.
        why: String,
        /// What of it could be read and is in the fresh one.
        salvaged: Salvaged,
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

/// How the writer opens the database. Only a fresh one is told how to reuse its free pages: SQLite writes that into the
/// header each time, and a file that turns out to be broken, or too new, must stay as it was.
pub(super) fn writing(settings: &Settings, fresh: bool) -> SqliteConnectOptions {
    let synchronous = match settings.synchronous {
        Synchronous::Full => SqliteSynchronous::Full,
        Synchronous::Normal => SqliteSynchronous::Normal,
    };
    let options = SqliteConnectOptions::new();
    let options = if fresh { options.auto_vacuum(SqliteAutoVacuum::Incremental) } else { options };
    options
        .filename(&settings.path)
        .create_if_missing(true)
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
        let found = Found::SetAside { to, why, salvaged: Salvaged::default() };
        return Ok((connection, Report { found, ..report }));
    }
    match prepare(settings, disk, place.is_fresh()).await {
        Err(Trouble::Broken(why)) => {
            let to = place.set_aside(now)?;
            tracing::error!(to = %to.display(), %why, "the database is broken and was set aside; a fresh one begins");
            let (mut connection, report) =
                prepare(settings, disk, true).await.map_err(|trouble| trouble.told(settings))?;
            let size = std::fs::metadata(&to).map_or(0, |file| file.len());
            let with_traces = disk.free_bytes().is_none_or(|free| free > size + size / 4);
            let salvaged = match salvage(&mut connection, &to, with_traces).await {
                Ok(salvaged) => salvaged,
                Err(error) => {
                    // Rows that were copied so far are sound; the connection may not be.
                    tracing::error!(%error, "the salvage of the broken database ended early");
                    connection = prepare(settings, disk, false).await.map_err(|trouble| trouble.told(settings))?.0;
                    Salvaged::default()
                }
            };
            tracing::warn!(saved = ?salvaged.rows, lost = ?salvaged.lost, "salvaged from the broken database");
            Place::describe_set_aside(&to, &salvaged.text())?;
            Ok((connection, Report { found: Found::SetAside { to, why, salvaged }, ..report }))
        }
        outcome => outcome.map_err(|trouble| trouble.told(settings)),
    }
}

/// Refuses the database of another program, which must not be written to. A file that cannot be read here is checked when it
/// is opened for writing.
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
    // The table was read; a failing close changes nothing.
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
    let mut connection = SqliteConnection::connect_with(&writing(settings, fresh)).await?;
    match bring_up_to_date(&mut connection, fresh).await {
        Ok(report) => Ok((connection, report)),
        Err(trouble) => {
            // Dropped, it would be closed some time later, perhaps when its file has another name.
            let _ = connection.close().await;
            Err(trouble)
        }
    }
}

async fn bring_up_to_date(connection: &mut SqliteConnection, fresh: bool) -> Result<Report, Trouble> {
    let needed: i64 = sqlx::query_scalar("PRAGMA user_version").fetch_one(&mut *connection).await?;
    let known = newest_known();
    if needed > known {
        return Err(Trouble::TooNew { needed, known });
    }
    let before = applied(&mut *connection).await?;
    let found = match (fresh, before.is_empty()) {
        (true, _) | (false, true) => Found::Fresh,
        (false, false) if stopped_cleanly(&mut *connection).await? => {
            // A clean stop says nothing about what happened to the file since.
            check(&mut *connection, Some(CHECK_LIMIT)).await?;
            Found::Clean
        }
        (false, false) => {
            check(&mut *connection, None).await?;
            Found::Unclean
        }
    };
    migrator().run(&mut *connection).await?;
    sqlx::query(sql::SET_CLEAN).bind(false).execute(&mut *connection).await?;
    let known = |version: &i64| MIGRATIONS.iter().any(|migration| migration.version == *version);
    let newer_schema = before.iter().any(|version| !known(version));
    let upgraded_by = applied(&mut *connection).await?.len() - before.len();
    Ok(Report { found, upgraded_by, newer_schema })
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

/// Checks every page, at most for `limit`: SQLite ends the check then, and what it read until then was sound.
async fn check(connection: &mut SqliteConnection, limit: Option<Duration>) -> Result<(), Trouble> {
    if let Some(limit) = limit {
        let end = Instant::now() + limit;
        connection.lock_handle().await?.set_progress_handler(CHECK_STEPS, move || Instant::now() < end);
    }
    let findings = sqlx::query_scalar::<_, String>("PRAGMA quick_check(5)").fetch_all(&mut *connection).await;
    connection.lock_handle().await?.remove_progress_handler();
    match findings {
        Ok(findings) if findings == ["ok"] => Ok(()),
        Ok(findings) => Err(Trouble::Broken(findings.join("; "))),
        Err(error) if is_interrupted(&error) => {
            tracing::info!(?limit, "the database is large: a part of it was checked, and sound");
            Ok(())
        }
        Err(error) => Err(error.into()),
    }
}
