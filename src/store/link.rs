//! The only writing connection, replaced after every failure, and its write-ahead log, which stays bounded.
//!
//! When a write transaction fails for any reason its connection is closed and another one opened, because SQLite may
//! have rolled back by itself and because a failed commit means "not known", not "not stored". The group is then
//! written once more; every write may be repeated without harm.

use std::{sync::Arc, time::Duration};

use sqlx::{AssertSqlSafe, Connection, SqliteConnection, sqlite::SqliteConnectOptions};
use tokio::time::Instant;

use super::{
    disk::Disk,
    error::{StoreError, is_corrupt, is_full, is_refused},
    pace::seldom,
    place::{Identity, Place},
    reader::Reader,
    statements as sql,
    write::Job,
};

/// Time between two looks at the names of the files. The daemon writes at least every 5 s, so a deleted file is noticed
/// within 6 s.
const LOOK: Duration = Duration::from_secs(1);

/// The part of a transaction that failed.
enum Failed {
    /// Before or after the jobs: none of them is to blame.
    Around(sqlx::Error),
    /// In a job.
    Within(sqlx::Error),
}

impl Failed {
    const fn error(&self) -> &sqlx::Error {
        match self {
            Self::Around(error) | Self::Within(error) => error,
        }
    }
}

/// The writing connection.
pub(super) struct Link {
    pub(super) options: SqliteConnectOptions,
    pub(super) connection: Option<SqliteConnection>,
    pub(super) disk: Arc<Disk>,
    pub(super) place: Place,
    pub(super) reader: Reader,
    /// SQLite found the content of the file broken: only opening it anew can set it aside.
    pub(super) broken: bool,
    /// The files that the connection has open, once it has written; noted again after each move.
    pub(super) identity: Option<Identity>,
    /// When the identity was compared last.
    pub(super) looked: Option<Instant>,
    /// Size of the log from which it is bounded \[bytes\]; raised when that fails.
    pub(super) log_bound: u64,
}

impl Link {
    /// Commits the jobs together and answers each of them.
    pub(super) async fn commit(&mut self, mut jobs: Vec<Box<dyn Job>>) {
        if jobs.is_empty() {
            return;
        }
        let Err(first) = self.transaction(&mut jobs, false).await else {
            answer(jobs, || Ok(()));
            self.notice_replaced_files().await;
            return self.bound_log().await;
        };
        self.recover(first.error()).await;
        match self.transaction(&mut jobs, true).await {
            Ok(()) => answer(jobs, || Ok(())),
            Err(Failed::Within(error)) if is_refused(&error) && jobs.len() > 1 => self.commit_one_by_one(jobs).await,
            Err(failed) => {
                self.recover(failed.error()).await;
                answer(jobs, || Err(store_error(failed.error())));
            }
        }
    }

    /// One of the jobs is refused by the database: it must not take the others with it.
    async fn commit_one_by_one(&mut self, jobs: Vec<Box<dyn Job>>) {
        for job in jobs {
            let mut alone = [job];
            let outcome = self.transaction(&mut alone, true).await;
            if let Err(failed) = &outcome {
                self.recover(failed.error()).await;
            }
            let [job] = alone;
            job.answer(outcome.map_err(|failed| store_error(failed.error())));
        }
    }

    async fn transaction(&mut self, jobs: &mut [Box<dyn Job>], repeated: bool) -> Result<(), Failed> {
        let connection = self.connected().await.map_err(Failed::Around)?;
        sqlx::query("BEGIN IMMEDIATE").execute(&mut *connection).await.map_err(Failed::Around)?;
        for job in jobs {
            job.run(connection, repeated).await.map_err(Failed::Within)?;
        }
        sqlx::query("COMMIT").execute(connection).await.map_err(Failed::Around)?;
        self.disk.note_success();
        Ok(())
    }

    async fn connected(&mut self) -> sqlx::Result<&mut SqliteConnection> {
        let connection = match self.connection.take() {
            Some(connection) => connection,
            None => SqliteConnection::connect_with(&self.options).await?,
        };
        Ok(self.connection.insert(connection))
    }

    /// Closes the connection after an error, and frees the ballast when the disk is full.
    async fn recover(&mut self, error: &sqlx::Error) {
        seldom!(warn, %error, "a write transaction failed; its connection is replaced");
        self.broken |= is_corrupt(error);
        self.disconnect().await;
        self.disk.note_failure(is_full(error));
    }

    async fn disconnect(&mut self) {
        if let Some(connection) = self.connection.take() {
            // Closing may fail for the same reason as the write; the files are closed either way.
            let _ = connection.close().await;
        }
    }

    /// Notices that the database file or its log was deleted or replaced. The connection still has the old files open, with
    /// everything that was committed: they are copied to a new file before they vanish.
    async fn notice_replaced_files(&mut self) {
        if self.looked.is_some_and(|looked| looked.elapsed() < LOOK) {
            return;
        }
        self.looked = Some(Instant::now());
        let now = self.place.identity();
        let known = *self.identity.get_or_insert(now);
        if now == known {
            return;
        }
        tracing::error!(?known, ?now, "the database was DELETED OR REPLACED under the daemon: it is written anew");
        let outcome = match self.place.set_strangers_aside() {
            Ok(()) => self.move_database().await,
            Err(error) => Err(error),
        };
        self.disk.note_replaced(outcome.is_ok());
        if let Err(error) = outcome {
            tracing::error!(%error, "the database cannot be written anew; retrying");
        }
    }

    /// Bounds the log, which a reader that holds an old state keeps from being reused.
    async fn bound_log(&mut self) {
        let log = self.place.log_bytes();
        if log < self.log_bound {
            return;
        }
        match self.checkpoint().await {
            Ok(true) => return,
            Ok(false) => {}
            Err(error) => return self.recover(&error).await,
        }
        let (room, needed) = (self.disk.free_bytes().unwrap_or(u64::MAX), self.place.copy_bytes());
        if room < needed {
            tracing::error!(
                log,
                needed,
                room,
                "a program keeps reading an old state of the database, and there is no room to move it: end that program"
            );
            self.log_bound = log + log / 4;
            return;
        }
        if let Err(error) = self.move_database().await {
            tracing::error!(%error, log, "the database could not be moved away from a reader that does not let go");
            self.log_bound = log + log / 4;
            self.reopen_path().await;
        }
    }

    /// After a move that failed half way: writer and readers open the configured path again, and an unfinished copy is removed.
    async fn reopen_path(&mut self) {
        self.disconnect().await;
        if let Err(error) = self.reader.reopen(self.place.path()).await {
            tracing::error!(%error, "the readers keep the file that they have");
        }
        if let Err(error) = self.place.next() {
            tracing::warn!(%error, "an unfinished copy of the database stays behind");
        }
    }

    /// Copies the log into the database and starts it anew, unless a reader needs it for longer than a second.
    async fn checkpoint(&mut self) -> sqlx::Result<bool> {
        let connection = self.connected().await?;
        sqlx::query("PRAGMA busy_timeout = 1000").execute(&mut *connection).await?;
        let (busy, ..): (i64, i64, i64) =
            sqlx::query_as("PRAGMA wal_checkpoint(TRUNCATE)").fetch_one(&mut *connection).await?;
        sqlx::query("PRAGMA busy_timeout = 5000").execute(connection).await?;
        Ok(busy == 0)
    }

    async fn move_database(&mut self) -> Result<(), StoreError> {
        let copy = self.place.next()?;
        let target = copy.to_string_lossy().replace('\'', "''");
        let connection = self.connected().await.map_err(|error| store_error(&error))?;
        let vacuum = AssertSqlSafe(format!("VACUUM INTO '{target}'"));
        sqlx::query(vacuum).execute(connection).await.map_err(|error| store_error(&error))?;
        self.place.switch(&copy)?;
        self.identity = None;
        self.disconnect().await;
        self.connected().await.map_err(|error| store_error(&error))?;
        self.reader.reopen(self.place.path()).await.map_err(|error| store_error(&error))?;
        tracing::warn!(to = %copy.display(), "the database moved to a new file: a program keeps reading an old state of it");
        Ok(())
    }

    /// Marks a clean stop and closes the files. A broken database is not marked: the next start has to check it.
    pub(super) async fn close(&mut self) -> Result<(), StoreError> {
        if self.reader.is_broken() {
            self.disconnect().await;
            return Err(StoreError::Broken);
        }
        let connection = self.connected().await.map_err(|error| store_error(&error))?;
        sqlx::query(sql::SET_CLEAN).bind(true).execute(connection).await.map_err(|error| store_error(&error))?;
        // What a reader keeps from being copied now stays in the log, which is as durable.
        let copied = self.checkpoint().await;
        self.disconnect().await;
        copied.map(drop).map_err(|error| store_error(&error))
    }
}

fn answer(jobs: Vec<Box<dyn Job>>, committed: impl Fn() -> Result<(), StoreError>) {
    for job in jobs {
        job.answer(committed());
    }
}

/// The error for the caller.
fn store_error(error: &sqlx::Error) -> StoreError {
    if is_full(error) { StoreError::Full } else { StoreError::Write(error.to_string()) }
}
