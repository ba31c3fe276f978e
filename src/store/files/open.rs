//! Opening of the database: creation, check, recovery of a broken file, migration.
//!
//! The daemon starts with a broken file: it is renamed, never deleted, and a new database replaces it. The alarm about it
//! lasts while the renamed file is there. The daemon does not start with the database of another program or of a newer
//! version, nor without space for the new database.

use std::{
    fs::File,
    io::Read,
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
    DatabaseFiles,
    disk::Disk,
    salvage::{Extent, Salvaged, salvage},
};
use crate::store::{
    error::{StoreError, is_corrupt, is_full, is_interrupted},
    settings::{MIB, Settings},
    statements as sql,
};

/// The migrations, compiled into the program.
static MIGRATIONS: Migrator = sqlx::migrate!();

/// Size to which SQLite truncates the log after a checkpoint \[bytes\].
const LOG_KEPT: u64 = 16 * MIB;
/// Time limit of the check after a clean stop. The check of 644 MB takes 0.3 s, so the limit covers about 6 GB. With 10
/// million throws the whole start takes less than 5 s.
const CHECK_LIMIT: Duration = Duration::from_secs(3);
/// Instructions of SQLite's virtual machine between two checks of the clock.
const CHECK_STEPS: i32 = 10_000;
/// Bytes at the start of a file that are searched for text: sixteen pages, as single pages of a database may be
/// damaged.
const TEXT_BYTES: u64 = 64 * 1024;
/// Start of the header of SQLite's files.
const HEADER: &str = "SQLite format 3";
/// Longest wait for a lock that another program holds.
pub(crate) const BUSY: Duration = Duration::from_secs(5);

/// Condition of the database when it was opened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Found {
    /// There was no database.
    Fresh,
    /// The last stop was clean.
    Clean,
    /// After a crash or a power cut; the check found no damage.
    Unclean,
    /// The last stop was not clean, and the write-ahead log is missing: it was removed, or was not copied.
    WithoutLog,
    /// The database was broken. It was renamed, and replaced by a new database with the readable rows.
    SetAside {
        /// New path of the broken database.
        to: PathBuf,
        /// The error that SQLite reported.
        why: String,
        /// The rows copied into the new database.
        salvaged: Salvaged,
    },
}

/// Report on the opening of the database: its condition, and what was changed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Report {
    /// Condition of the database when it was opened.
    pub found: Found,
    /// Number of migrations applied.
    pub upgraded_by: usize,
    /// Whether a newer version has used the database; its additions are ignored.
    pub newer_schema: bool,
}

/// Options of the writing connection. Only a `fresh` database gets the auto-vacuum mode: SQLite writes it to the header
/// at each opening, and a broken or too new file must not be changed.
pub(crate) fn write_options(settings: &Settings, fresh: bool) -> SqliteConnectOptions {
    let options = SqliteConnectOptions::new();
    let options = if fresh { options.auto_vacuum(SqliteAutoVacuum::Incremental) } else { options };
    options
        .filename(&settings.path)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .busy_timeout(BUSY)
        .pragma("journal_size_limit", LOG_KEPT.to_string())
        .disable_statement_logging()
}

/// Options of reading connections.
pub(crate) fn read_options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new().filename(path).read_only(true).busy_timeout(BUSY).disable_statement_logging()
}

/// Opens the writing connection; sets a broken database aside first.
pub(crate) async fn open(
    settings: &Settings,
    disk: &Disk,
    files: &DatabaseFiles,
    now: Timestamp,
) -> Result<(SqliteConnection, Report), StoreError> {
    // Checked before a reader opens the database, which creates an empty log. An empty one is from such a reader too, as
    // from a query before this start: the daemon writes to its log as soon as it has opened it.
    let has_log = files.log_bytes() > 0;
    refuse_foreign(&settings.path).await?;
    files.clear_leftovers(now)?;
    // If only the log exists, SQLite would delete it, and with it the last commits.
    let log = (files.is_fresh() && files.log_bytes() > 0).then(|| files.set_log_aside(now)).transpose()?;
    if let Some(broken) = files.unfinished() {
        return recover(settings, disk, files, broken, "copying its rows was interrupted".to_owned()).await;
    }
    match prepare(settings, disk, files.is_fresh()).await {
        Err(OpenFailure::Broken(why)) => recover(settings, disk, files, files.set_aside(now)?, why).await,
        Ok((connection, report)) if !has_log && report.found == Found::Unclean => {
            Ok((connection, Report { found: Found::WithoutLog, ..report }))
        }
        Ok((connection, report)) => {
            let Some(to) = log else { return Ok((connection, report)) };
            let why = "the database is missing, but its write-ahead log exists".to_owned();
            tracing::error!(to = %to.display(), %why, "log set aside; a new database was created");
            let found = Found::SetAside { to, why, salvaged: Salvaged::default() };
            Ok((connection, Report { found, ..report }))
        }
        Err(failure) => Err(failure.into_error(settings)),
    }
}

/// Copies the readable rows of a broken database into a new file. The file gets the configured path when it is
/// complete, so an interrupted copy begins again at the next start. If there is no space for all rows, the most
/// valuable ones are copied. If there is no space for these, the start fails: otherwise every machine would learn a new
/// baseline, although the broken file still has a readable one.
async fn recover(
    settings: &Settings,
    disk: &Disk,
    files: &DatabaseFiles,
    to: PathBuf,
    why: String,
) -> Result<(SqliteConnection, Report), StoreError> {
    tracing::error!(to = %to.display(), %why, "the database is broken: set aside; creating a new one");
    let size = std::fs::metadata(&to).map_or(0, |file| file.len());
    let with_traces = disk.free_bytes().is_none_or(|free| free > size + size / 4);
    let mut salvaged = Salvaged::default();
    for extent in Extent::LARGEST_FIRST.into_iter().skip(usize::from(!with_traces)) {
        files.remove_unfinished()?;
        let copy = Settings { path: files.salvage_path(), ..settings.clone() };
        match copy_readable(&copy, disk, &to, extent).await {
            Ok(copied) => {
                files.adopt(&copy.path)?;
                salvaged = copied;
                break;
            }
            Err(failure) => {
                let error = failure.into_error(&copy);
                tracing::error!(%error, ?extent, "copying rows from the broken database failed");
                let is_full = matches!(error, StoreError::Full);
                disk.note_failure(is_full);
                if is_full && extent == Extent::Diagnosis {
                    // No new database is created, so the next start copies the rows of the broken file.
                    files.remove_unfinished()?;
                    return Err(error);
                }
            }
        }
    }
    files.remove_unfinished()?;
    let (connection, report) =
        prepare(settings, disk, files.is_fresh()).await.map_err(|failure| failure.into_error(settings))?;
    tracing::warn!(saved = ?salvaged.rows, lost = ?salvaged.lost, "the broken database: {}", salvaged.text());
    if let Err(error) = DatabaseFiles::describe_set_aside(&to, &salvaged.text()) {
        tracing::warn!(%error, "the summary of the copied rows is in this log only");
    }
    Ok((connection, Report { found: Found::SetAside { to, why, salvaged }, ..report }))
}

/// Copies the readable rows into a new database, and closes it, so that it is one file without a log.
async fn copy_readable(copy: &Settings, disk: &Disk, broken: &Path, extent: Extent) -> Result<Salvaged, OpenFailure> {
    let (mut connection, _) = prepare(copy, disk, true).await?;
    let copied = async {
        let salvaged = salvage(&mut connection, broken, &copy.path, extent).await?;
        sqlx::query(sql::SET_CLEAN).bind(true).execute(&mut connection).await?;
        sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut connection).await?;
        Ok(salvaged)
    };
    let copied = copied.await;
    // An error is ignored: the checkpoint has reported a full disk already.
    let _ = connection.close().await;
    copied
}

/// Refuses a file that pointsd must not change: a text file, the database of another program, or the database of a
/// newer version that this version could damage. A file that cannot be read here is checked when it is opened for
/// writing.
pub(crate) async fn refuse_foreign(path: &Path) -> Result<(), StoreError> {
    if DatabaseFiles::new(path).is_fresh() {
        return Ok(());
    }
    if is_text(path) {
        return Err(StoreError::foreign(path, "is a text file, not a database"));
    }
    let Ok(mut connection) = SqliteConnection::connect_with(&read_options(path)).await else { return Ok(()) };
    let table = foreign_table(&mut connection).await;
    let needed = needed_schema(&mut connection).await;
    // An error of the close does not change the result.
    let _ = connection.close().await;
    match table {
        Ok(Some(table)) => {
            let what = format!("is the database of another program (it has the table {table})");
            Err(StoreError::foreign(path, &what))
        }
        _ => refuse_newer(path, needed.unwrap_or(0)),
    }
}

/// A table of the database of another program; `None` for a database of pointsd.
pub(crate) async fn foreign_table(connection: &mut SqliteConnection) -> sqlx::Result<Option<String>> {
    sqlx::query_scalar(sql::FOREIGN_TABLE).fetch_optional(connection).await
}

pub(crate) fn refuse_newer(path: &Path, needed: i64) -> Result<(), StoreError> {
    let known = newest_known();
    if needed <= known {
        return Ok(());
    }
    Err(StoreError::Schema(format!(
        "the database {} was changed by a newer version of pointsd (schema {needed}), and this version (schema {known}) \
         cannot read it: install the newer version again, or restore the backup from before the upgrade",
        path.display()
    )))
}

/// Version of the last migration that a program must know to use the database: see [`migrator`].
pub(crate) async fn needed_schema(connection: &mut SqliteConnection) -> sqlx::Result<i64> {
    sqlx::query_scalar("PRAGMA user_version").fetch_one(connection).await
}

/// Whether the start of a file is printable text only. A database has zero bytes in its undamaged pages.
fn is_text(path: &Path) -> bool {
    let mut start = Vec::new();
    let read = File::open(path).and_then(|file| file.take(TEXT_BYTES).read_to_end(&mut start));
    let text = match std::str::from_utf8(&start) {
        Ok(text) => text,
        // The last character is cut off.
        Err(error) if error.error_len().is_none() => {
            std::str::from_utf8(&start[..error.valid_up_to()]).unwrap_or_default()
        }
        Err(_) => return false,
    };
    let is_printable = |character: char| !character.is_control() || matches!(character, '\t' | '\n' | '\r');
    read.is_ok() && !text.is_empty() && !text.starts_with(HEADER) && text.chars().all(is_printable)
}

/// A failed opening.
enum OpenFailure {
    /// The file is damaged; holds the error that SQLite reported.
    Broken(String),
    Access(sqlx::Error),
    Schema(StoreError),
}

impl OpenFailure {
    /// The error of opening the database at the path of `settings`.
    fn into_error(self, Settings { path, .. }: &Settings) -> StoreError {
        match self {
            Self::Broken(damage) => StoreError::Damaged { path: path.clone(), damage },
            Self::Access(error) if is_full(&error) => StoreError::Full,
            Self::Access(source) => StoreError::open(path)(source),
            Self::Schema(error) => error,
        }
    }
}

impl From<sqlx::Error> for OpenFailure {
    fn from(error: sqlx::Error) -> Self {
        if is_corrupt(&error) { Self::Broken(error.to_string()) } else { Self::Access(error) }
    }
}

fn not_migrated(path: &Path, error: MigrateError) -> OpenFailure {
    match error {
        MigrateError::Execute(error) | MigrateError::ExecuteMigration(error, _) => error.into(),
        error @ (MigrateError::VersionMismatch(_) | MigrateError::Dirty(_)) => OpenFailure::Broken(error.to_string()),
        error => {
            OpenFailure::Schema(StoreError::Schema(format!("cannot migrate the schema of {}: {error}", path.display())))
        }
    }
}

/// Opens the database; on a full disk removes the ballast and retries.
async fn prepare(settings: &Settings, disk: &Disk, fresh: bool) -> Result<(SqliteConnection, Report), OpenFailure> {
    match prepare_once(settings, fresh).await {
        Err(OpenFailure::Access(error)) if is_full(&error) => {
            disk.note_failure(true);
            prepare_once(settings, fresh).await
        }
        outcome => outcome,
    }
}

async fn prepare_once(settings: &Settings, fresh: bool) -> Result<(SqliteConnection, Report), OpenFailure> {
    let mut connection = SqliteConnection::connect_with(&write_options(settings, fresh)).await?;
    match bring_up_to_date(&mut connection, &settings.path, fresh).await {
        Ok(report) => Ok((connection, report)),
        Err(failure) => {
            // A dropped connection closes later, perhaps after its file was renamed.
            let _ = connection.close().await;
            Err(failure)
        }
    }
}

async fn bring_up_to_date(connection: &mut SqliteConnection, path: &Path, fresh: bool) -> Result<Report, OpenFailure> {
    refuse_newer(path, needed_schema(&mut *connection).await?).map_err(OpenFailure::Schema)?;
    let before = applied(&mut *connection).await?;
    let found = if fresh || before.is_empty() {
        Found::Fresh
    } else if stopped_cleanly(&mut *connection).await? {
        // The file may have been damaged since the clean stop.
        check(&mut *connection, Some(CHECK_LIMIT)).await?;
        Found::Clean
    } else {
        check(&mut *connection, None).await?;
        Found::Unclean
    };
    migrator().run(&mut *connection).await.map_err(|error| not_migrated(path, error))?;
    sqlx::query(sql::SET_CLEAN).bind(false).execute(&mut *connection).await?;
    // Copies the mark into the database file, so that a later loss of the log shows. While another program reads an old
    // state, the mark may stay in the log.
    if let Err(error) = sqlx::query("PRAGMA wal_checkpoint").execute(&mut *connection).await {
        tracing::debug!(%error, "the mark of the start stays in the log");
    }
    let newer_schema = before.iter().any(|version| !MIGRATIONS.version_exists(*version));
    let upgraded_by = applied(&mut *connection).await?.len() - before.len();
    Ok(Report { found, upgraded_by, newer_schema })
}

/// Newest migration of this program.
pub(crate) fn newest_known() -> i64 {
    MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0)
}

/// The migrator also opens a database of a newer version, so that an upgrade can be rolled back: migrations only add,
/// and older programs ignore additions. A migration N that an older program could damage sets `PRAGMA user_version =
/// N`; then only programs that know migration N open the database.
fn migrator() -> Migrator {
    let mut migrator = Migrator { migrations: MIGRATIONS.migrations.clone(), ..Migrator::DEFAULT };
    migrator.set_ignore_missing(true);
    migrator
}

/// Versions of the applied migrations.
pub(crate) async fn applied(connection: &mut SqliteConnection) -> sqlx::Result<Vec<i64>> {
    if !has_table(connection, "_sqlx_migrations").await? {
        return Ok(Vec::new());
    }
    sqlx::query_scalar("SELECT version FROM _sqlx_migrations WHERE success ORDER BY version")
        .fetch_all(connection)
        .await
}

async fn stopped_cleanly(connection: &mut SqliteConnection) -> sqlx::Result<bool> {
    Ok(has_table(connection, "shutdown").await?
        && sqlx::query_scalar(sql::CLEAN).fetch_optional(connection).await?.unwrap_or(false))
}

async fn has_table(connection: &mut SqliteConnection, name: &str) -> sqlx::Result<bool> {
    sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = ?)")
        .bind(name)
        .fetch_one(connection)
        .await
}

/// Checks all pages for damage, or as many as it can read within `limit`.
async fn check(connection: &mut SqliteConnection, limit: Option<Duration>) -> Result<(), OpenFailure> {
    if let Some(limit) = limit {
        let end = Instant::now() + limit;
        connection.lock_handle().await?.set_progress_handler(CHECK_STEPS, move || Instant::now() < end);
    }
    let damage = damage(&mut *connection).await;
    connection.lock_handle().await?.remove_progress_handler();
    match damage {
        Ok(None) => Ok(()),
        Ok(Some(damage)) => Err(OpenFailure::Broken(damage)),
        Err(error) if is_interrupted(&error) => {
            tracing::info!(?limit, "large database: checked in part, no damage found");
            Ok(())
        }
        Err(error) => Err(error.into()),
    }
}

/// The damage that SQLite finds in the pages of a database; `None` without damage.
pub(crate) async fn damage(connection: &mut SqliteConnection) -> sqlx::Result<Option<String>> {
    let findings: Vec<String> = sqlx::query_scalar("PRAGMA quick_check(5)").fetch_all(connection).await?;
    Ok((findings != ["ok"]).then(|| findings.join("; ")))
}
