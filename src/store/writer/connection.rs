//! The writing connection: commits, replacement after a failure, and the limit of the write-ahead log.
//!
//! After any failed transaction the connection is closed and a new one opened: SQLite may have rolled back by itself,
//! and the result of a failed commit is unknown. Then the group of writes runs once more: each stores its rows once, and
//! only the counters of losses may count twice.
//! If SQLite refuses the group again (constraint, type), each write runs alone, so that one refused write costs no other.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use sqlx::{AssertSqlSafe, Connection, SqliteConnection, sqlite::SqliteConnectOptions};
use tokio::time::Instant;

use super::write::Job;
use crate::store::{
    error::{StoreError, is_corrupt, is_full, is_refused},
    files::{
        DatabaseFiles, Identity,
        disk::{Disk, Replaced},
        open::BUSY,
    },
    rate_limit::seldom,
    reader::Reader,
    statements as sql,
};

/// Least time between two checks whether the open files still are at the configured path. The daemon writes at least
/// every 5 s, so a deleted file is noticed within 6 s.
const FILE_CHECK_INTERVAL: Duration = Duration::from_secs(1);
/// Time between two attempts to write a deleted database again: an attempt may copy some GiB before it fails.
const WRITE_AGAIN_INTERVAL: Duration = Duration::from_mins(1);

/// Instructions of SQLite's virtual machine in one step of a copy: some hundred rows.
const COPY_STEPS: i32 = 1_000;
/// Longest wait of a checkpoint for a reader of an old state: every write waits meanwhile.
const CHECKPOINT_WAIT: Duration = Duration::from_secs(1);

pub(crate) struct WritingConnection {
    pub(crate) options: SqliteConnectOptions,
    pub(crate) connection: Option<SqliteConnection>,
    pub(crate) disk: Arc<Disk>,
    pub(crate) files: DatabaseFiles,
    pub(crate) reader: Reader,
    /// Whether SQLite found the file broken; the next start sets it aside.
    pub(crate) broken: bool,
    /// Identity of the open files; `None` before the first write and after a move.
    pub(crate) identity: Option<Identity>,
    /// Time of the next comparison of the open files with those at the configured path; `None` for now.
    pub(crate) next_file_check: Option<Instant>,
    /// New path of the file that was found in place of the database, until the database is written again.
    pub(crate) foreign: Option<PathBuf>,
    /// Size of the log from which on it is truncated, or the database moves \[bytes\].
    pub(crate) max_log_bytes: u64,
    /// Size of the log when both failed last \[bytes\]; 0 after a success.
    pub(crate) failed_log_bytes: u64,
}

impl WritingConnection {
    /// Commits the jobs in one transaction and answers each.
    pub(crate) async fn commit(&mut self, mut jobs: Vec<Box<dyn Job>>) {
        if jobs.is_empty() {
            return;
        }
        if self.transaction(&mut jobs, false).await.is_ok() {
            answer(jobs, || Ok(()));
            self.notice_replaced_files().await;
            return self.limit_log().await;
        }
        match self.transaction(&mut jobs, true).await {
            Ok(()) => answer(jobs, || Ok(())),
            Err(error) if is_refused(&error) && jobs.len() > 1 => self.commit_one_by_one(jobs).await,
            Err(error) => {
                let error = Arc::new(error);
                answer(jobs, || Err(store_error(Arc::clone(&error))));
            }
        }
    }

    /// Commits each job alone, after the database refused one of them.
    async fn commit_one_by_one(&mut self, jobs: Vec<Box<dyn Job>>) {
        for job in jobs {
            let mut alone = [job];
            let outcome = self.transaction(&mut alone, true).await;
            let [job] = alone;
            job.answer(outcome.map_err(store_error));
        }
    }

    /// Runs the jobs in one transaction; closes the connection after an error, as its transaction may still be open.
    async fn transaction(&mut self, jobs: &mut [Box<dyn Job>], repeated: bool) -> sqlx::Result<()> {
        let outcome = self.run(jobs, repeated).await;
        if let Err(error) = &outcome {
            self.recover(error).await;
        }
        outcome
    }

    async fn run(&mut self, jobs: &mut [Box<dyn Job>], repeated: bool) -> sqlx::Result<()> {
        let connection = self.connected().await?;
        sqlx::query("BEGIN IMMEDIATE").execute(&mut *connection).await?;
        for job in jobs {
            job.run(connection, repeated).await?;
        }
        sqlx::query("COMMIT").execute(connection).await?;
        self.disk.note_success();
        Ok(())
    }

    async fn connected(&mut self) -> sqlx::Result<&mut SqliteConnection> {
        let connection = match self.connection.take() {
            Some(connection) => connection,
            None if self.has_lost_its_file() => {
                self.broken = true;
                tracing::error!("the database was DELETED OR REPLACED while a write failed: its rows are LOST");
                return Err(std::io::Error::from(std::io::ErrorKind::NotFound).into());
            }
            None => SqliteConnection::connect_with(&self.options).await?,
        };
        Ok(self.connection.insert(connection))
    }

    /// Whether the file of the closed connection is no longer at the configured path: then it is deleted. A new
    /// connection would write into another file, which does not match the monitors in memory.
    fn has_lost_its_file(&self) -> bool {
        let database = self.files.identity().database;
        self.files.is_fresh() || self.identity.is_some_and(|known| known.database != database)
    }

    /// Closes the connection after an error, and removes the ballast if the disk is full. A refused write is no failure
    /// of the disk: a logger can cause one.
    async fn recover(&mut self, error: &sqlx::Error) {
        seldom!(warn, %error, "write transaction failed: connection replaced");
        self.broken |= is_corrupt(error);
        self.disconnect().await;
        if !is_refused(error) {
            self.disk.note_failure(is_full(error));
        }
    }

    async fn disconnect(&mut self) {
        if let Some(connection) = self.connection.take() {
            // Closing may fail like the write; the files are closed in any case.
            let _ = connection.close().await;
        }
    }

    /// Detects a deleted or replaced database file or log. The connection still has the old files open, with all
    /// committed rows, and copies the rows to a new file.
    async fn notice_replaced_files(&mut self) {
        if self.next_file_check.is_some_and(|next| Instant::now() < next) {
            return;
        }
        self.next_file_check = Some(Instant::now() + FILE_CHECK_INTERVAL);
        let now = self.files.identity();
        let known = *self.identity.get_or_insert(now);
        if now == known {
            return;
        }
        tracing::error!(?known, ?now, "the database was DELETED OR REPLACED: writing it again");
        let outcome = match self.write_again(now.database != known.database).await {
            Ok(()) => Replaced::WrittenAgain(self.foreign.take()),
            Err(error) => {
                tracing::error!(%error, "writing the database again failed; retrying");
                self.next_file_check = Some(Instant::now() + WRITE_AGAIN_INTERVAL);
                Replaced::Failed
            }
        };
        self.disk.note_replaced(outcome);
    }

    /// Writes the rows of the deleted database to a new file. The open connection has their only copy, and is closed when
    /// a write fails: so a copy without enough space is not begun, and the rest of a failed copy is removed. If only the
    /// log was deleted, no file is foreign: the new file replaces the old database.
    async fn write_again(&mut self, has_foreign_files: bool) -> Result<(), StoreError> {
        if has_foreign_files {
            let found = self.files.rename_foreign_files()?;
            self.foreign = self.foreign.take().or(found);
        }
        let connection = self.connected().await.map_err(store_error)?;
        let needed: i64 = sqlx::query_scalar(sql::FILE_BYTES).fetch_one(connection).await.map_err(store_error)?;
        if self.disk.free_bytes().is_some_and(|free| free < needed.cast_unsigned()) {
            return Err(StoreError::Full);
        }
        let moved = self.move_database("its files were deleted or replaced").await;
        if moved.is_err() {
            self.files.remove_unfinished()?;
        }
        moved
    }

    /// Limits the log, which grows while a reader keeps an old state open: truncates the log, or moves the database to
    /// a new file. After a failure both are tried again when the log has grown by a quarter.
    async fn limit_log(&mut self) {
        let log = self.files.log_bytes();
        if log < self.max_log_bytes {
            self.failed_log_bytes = 0;
            return;
        }
        if log < self.failed_log_bytes + self.failed_log_bytes / 4 {
            return;
        }
        match self.checkpoint().await {
            Ok(true) => return,
            Ok(false) => {}
            Err(error) => return self.recover(&error).await,
        }
        let (free, needed) = (self.disk.free_bytes().unwrap_or(u64::MAX), self.files.copy_bytes());
        if free < needed {
            tracing::error!(
                log,
                needed,
                free,
                "a program keeps reading an old state of the database, and there is no space to move the database: end that program"
            );
            self.failed_log_bytes = log;
            return;
        }
        if let Err(error) = self.move_database("a program keeps reading an old state of it").await {
            tracing::error!(%error, log, "moving the database away from a slow reader failed");
            self.failed_log_bytes = log;
            self.reopen_path().await;
        }
    }

    /// After a failed move: opens the configured path again for writer and readers, and removes the unfinished copy.
    async fn reopen_path(&mut self) {
        self.disconnect().await;
        self.reader.reopen(self.files.path());
        if let Err(error) = self.files.remove_unfinished() {
            tracing::warn!(%error, "removing an unfinished copy of the database failed");
        }
    }

    /// Copies the log into the database and truncates it; false if a reader needs the log for longer than
    /// [`CHECKPOINT_WAIT`].
    async fn checkpoint(&mut self) -> sqlx::Result<bool> {
        let connection = self.connected().await?;
        set_busy_timeout(connection, CHECKPOINT_WAIT).await?;
        let (busy, ..): (i64, i64, i64) =
            sqlx::query_as("PRAGMA wal_checkpoint(TRUNCATE)").fetch_one(&mut *connection).await?;
        set_busy_timeout(connection, BUSY).await?;
        Ok(busy == 0)
    }

    async fn move_database(&mut self, why: &str) -> Result<(), StoreError> {
        self.files.remove_unfinished()?;
        let copy = self.files.copy_path();
        tracing::warn!(why, "copying the database to a new file: writes wait");
        self.copy_to(&copy).await.map_err(store_error)?;
        let to = self.files.switch(&copy)?;
        self.identity = None;
        self.disconnect().await;
        self.connected().await.map_err(store_error)?;
        self.reader.reopen(self.files.path());
        tracing::warn!(to = %to.display(), why, "the database moved to a new file");
        Ok(())
    }

    /// Copies the database into a new file. This takes minutes for some GiB on flash, so each step is recorded: the
    /// watchdog must not stop a copy that makes progress.
    async fn copy_to(&mut self, copy: &Path) -> sqlx::Result<()> {
        let disk = Arc::clone(&self.disk);
        let note_step = move || {
            disk.note_copying();
            true
        };
        let connection = self.connected().await?;
        connection.lock_handle().await?.set_progress_handler(COPY_STEPS, note_step);
        let vacuum = sqlx::query("VACUUM INTO ?1").bind(copy.to_string_lossy());
        let copied = vacuum.execute(&mut *connection).await;
        connection.lock_handle().await?.remove_progress_handler();
        self.disk.end_copying();
        copied.map(drop)
    }

    /// Marks a clean stop and closes the files. A broken database is not marked, so that the next start checks it.
    pub(crate) async fn close(&mut self) -> Result<(), StoreError> {
        if self.broken || self.reader.is_broken() {
            self.disconnect().await;
            return Err(StoreError::Broken);
        }
        let connection = self.connected().await.map_err(store_error)?;
        sqlx::query(sql::SET_CLEAN).bind(true).execute(connection).await.map_err(store_error)?;
        // Pages that cannot be copied because of a reader stay in the log, which is as durable.
        let copied = self.checkpoint().await;
        self.disconnect().await;
        copied.map(drop).map_err(store_error)
    }
}

/// Sets the longest wait for a lock that another program holds.
async fn set_busy_timeout(connection: &mut SqliteConnection, wait: Duration) -> sqlx::Result<()> {
    let set = AssertSqlSafe(format!("PRAGMA busy_timeout = {}", wait.as_millis()));
    sqlx::query(set).execute(connection).await.map(drop)
}

/// Answers the jobs of a transaction.
fn answer(jobs: Vec<Box<dyn Job>>, committed: impl Fn() -> Result<(), StoreError>) {
    for job in jobs {
        job.answer(committed());
    }
}

/// Converts an error for the caller.
fn store_error(error: impl Into<Arc<sqlx::Error>>) -> StoreError {
    let error = error.into();
    if is_full(&error) {
        StoreError::Full
    } else if is_refused(&error) {
        StoreError::Refused(error.to_string())
    } else {
        StoreError::Write(error)
    }
}
