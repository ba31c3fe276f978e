//! Failures of the database, in words for people.

use std::path::PathBuf;

/// A failure of the database.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The database cannot be opened or created.
    #[error("cannot open the database {}: {source}; check that its folder exists and can be written to", path.display())]
    Open {
        /// The database file.
        path: PathBuf,
        /// Why.
        source: Box<sqlx::Error>,
    },
    /// The file belongs to another program.
    #[error("{} is the database of another program (it has the table {table}): name another file in store.path", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// One of its tables.
        table: String,
    },
    /// The schema cannot be brought up to date.
    #[error("cannot bring the schema of {} up to date: {source}", path.display())]
    Migrate {
        /// The database file.
        path: PathBuf,
        /// Why.
        source: Box<sqlx::migrate::MigrateError>,
    },
    /// The disk is full. Nothing was stored; the same call succeeds once there is space.
    #[error("the disk of the database is full: free some space; nothing else is needed")]
    Full,
    /// A write failed, and so did its repetition on a new connection. Whether it is stored is not known: repeat it,
    /// every write may be repeated.
    #[error("writing to the database failed: {0}")]
    Write(String),
    /// A query failed.
    #[error("reading the database failed: {0}")]
    Read(#[source] Box<sqlx::Error>),
    /// A query took longer than [`Reader::TIME_LIMIT`](super::Reader::TIME_LIMIT).
    #[error("reading the database took too long and was given up")]
    ReadTimeout,
    /// The files could not be closed in time.
    #[error(
        "the database takes too long to close: does its disk hang? Nothing acknowledged is lost; the next start checks it"
    )]
    CloseTimeout,
    /// The content of the file is broken.
    #[error("the database is broken; the next start sets it aside and begins a fresh one")]
    Broken,
    /// A newer version of the program has changed the database so that this one would do harm.
    #[error(
        "the database {} was changed by a newer version of pointsd (schema {needed}) in a way that this one (schema {known}) \
         does not understand: install that version again, or put the backup from before the upgrade in its place",
        path.display()
    )]
    TooNew {
        /// The database file.
        path: PathBuf,
        /// The oldest schema whose programs may use it.
        needed: i64,
        /// The newest schema that this program knows.
        known: i64,
    },
    /// The store was closed, or its writer died.
    #[error("the store is closed")]
    Closed,
    /// The number of a throw does not fit a 64-bit signed integer.
    #[error("throw_no {0} is too large: at most 9223372036854775807")]
    ThrowNumber(u64),
    /// A file beside the database cannot be handled.
    #[error("cannot {action} {}: {source}", path.display())]
    File {
        /// What was tried, as a verb.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

impl StoreError {
    pub(super) fn read(source: sqlx::Error) -> Self {
        Self::Read(Box::new(source))
    }
}

/// The primary result code of SQLite in an error, if it is one of SQLite's.
fn primary_code(error: &sqlx::Error) -> Option<i32> {
    let code: i32 = error.as_database_error()?.code()?.parse().ok()?;
    Some(code & 0xff)
}

/// `SQLITE_FULL`, or an I/O error for want of space.
pub(super) fn is_full(error: &sqlx::Error) -> bool {
    primary_code(error) == Some(13)
        || matches!(error, sqlx::Error::Io(io) if io.kind() == std::io::ErrorKind::StorageFull)
}

/// `SQLITE_CORRUPT` or `SQLITE_NOTADB`: the file's content is broken, not the access to it.
pub(super) fn is_corrupt(error: &sqlx::Error) -> bool {
    matches!(primary_code(error), Some(11 | 26))
}

/// `SQLITE_INTERRUPT`: a progress handler ended the statement.
pub(super) fn is_interrupted(error: &sqlx::Error) -> bool {
    primary_code(error) == Some(9)
}

/// The statement itself was refused (constraint, mismatch, range), whatever the state of the disk.
pub(super) fn is_refused(error: &sqlx::Error) -> bool {
    match primary_code(error) {
        Some(code) => matches!(code, 1 | 18 | 19 | 20 | 25),
        None => !matches!(error, sqlx::Error::Io(_) | sqlx::Error::WorkerCrashed),
    }
}
