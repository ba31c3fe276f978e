//! Errors of the database.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use super::files::path::unwritable;

/// An error of the database. `Display` is a sentence for people.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The database cannot be opened or created.
    #[error("cannot open the database {}: {source}; {}", path.display(), advice(source, unwritable.as_deref()))]
    Open {
        /// The database file.
        path: PathBuf,
        /// A file of the database that this user may not write.
        unwritable: Option<PathBuf>,
        /// Error of SQLite.
        source: Box<sqlx::Error>,
    },
    /// The file has no tables: pointsd has not used it yet.
    #[error("no database at {}: the file has no tables yet", .0.display())]
    Empty(PathBuf),
    /// The file is the database of another program, or text, and so not a damaged database.
    #[error("{0}: name another file")]
    Foreign(String),
    /// The schema belongs to another version that this one could damage or cannot read, or the migration failed.
    #[error("{0}")]
    Schema(String),
    /// The disk is full. Nothing was stored; repeat the call when there is space.
    #[error("the disk of the database is full: free some space; nothing else is needed")]
    Full,
    /// A write failed, also on a new connection. It may be stored or not. Repeat the call: every write is idempotent.
    #[error("writing to the database failed: {0}")]
    Write(#[source] Arc<sqlx::Error>),
    /// SQLite refused the statement (constraint, type). Nothing was stored, and a repetition fails too.
    #[error("the database rejects the write: {0}")]
    Refused(String),
    /// An operator's SQL statement is wrong, or would write.
    #[error("the SQL statement is wrong: {0}")]
    Statement(String),
    /// An operator's SQL has more than one statement.
    #[error("only the first statement was answered: write one statement at a time")]
    SeveralStatements,
    /// A query failed.
    #[error("reading the database failed: {0}")]
    Read(#[source] Box<sqlx::Error>),
    /// A query took longer than [`Reader::TIME_LIMIT`](super::Reader::TIME_LIMIT).
    #[error("reading the database took too long and was aborted")]
    ReadTimeout,
    /// The files could not be closed in time.
    #[error(
        "closing the database takes too long: does its disk hang? Nothing acknowledged is lost; the next start checks it"
    )]
    CloseTimeout,
    /// A copy of the database, or the file that replaces a broken database, has damage.
    #[error("{} is damaged: {damage}; check its disk", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The damage that SQLite reported.
        damage: String,
    },
    /// The content of the file is broken.
    #[error("the database is broken; the next start sets it aside and creates a new one")]
    Broken,
    /// The result of a query cannot be written.
    #[error("cannot write the result: {0}")]
    Output(#[source] std::io::Error),
    /// The store was closed, or its writer ended.
    #[error("the store is closed")]
    Closed,
    /// A file of the database cannot be read, written or renamed.
    #[error("cannot {action} {}: {source}", path.display())]
    File {
        /// The action, as a verb.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// Error of the system.
        source: std::io::Error,
    },
}

impl StoreError {
    /// Turns an error of SQLite into a failure to open the database at `path`.
    pub(super) fn open(path: &Path) -> impl Fn(sqlx::Error) -> Self {
        |source| Self::Open { path: path.to_owned(), unwritable: unwritable(path), source: Box::new(source) }
    }

    /// Turns an error of the operating system into a failed `action` (a verb) on a file of the database.
    pub(super) fn file(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        move |source| Self::File { action, path: path.to_owned(), source }
    }

    /// The refusal of a file that is no database of pointsd; `what` is the predicate of the sentence.
    pub(super) fn foreign(path: &Path, what: &str) -> Self {
        Self::Foreign(format!("{} {what}", path.display()))
    }

    pub(super) fn read(source: sqlx::Error) -> Self {
        Self::Read(Box::new(source))
    }

    /// Turns an error of SQLite into that of an operator's statement.
    pub(super) fn statement(source: sqlx::Error) -> Self {
        match (primary_code(&source), source.as_database_error().map(sqlx::error::DatabaseError::message)) {
            (Some(code), Some(message)) if REFUSALS.contains(&code) => Self::Statement(message.to_owned()),
            // `SQLITE_READONLY`.
            (Some(8), Some(_)) => Self::writes(),
            // `SQLITE_CANTOPEN`, with this message of the statement ATTACH.
            (Some(14), Some(message)) if message.starts_with("unable to open database: ") => {
                Self::Statement(format!("{message}; this command only reads, and creates no file"))
            }
            _ => Self::read(source),
        }
    }

    /// An operator's statement that writes.
    pub(super) fn writes() -> Self {
        Self::Statement("it writes to the database, which only the daemon may do".to_owned())
    }
}

/// The remedy for a database that cannot be opened.
fn advice(source: &sqlx::Error, unwritable: Option<&Path>) -> String {
    if is_locked(source) {
        return "another program holds its lock: end that program, or its transaction".to_owned();
    }
    let file = unwritable.map_or_else(String::new, |file| format!(" (it may not write to {})", file.display()));
    format!(
        "check that its folder exists, and that the user of pointsd owns the folder, the file, its -wal and its -shm, and \
         may write to them{file}"
    )
}

/// `SQLITE_ERROR`, `TOOBIG`, `CONSTRAINT`, `MISMATCH` and `RANGE`: the statement is refused, independent of the disk.
const REFUSALS: [i32; 5] = [1, 18, 19, 20, 25];

/// The primary result code of an SQLite error.
fn primary_code(error: &sqlx::Error) -> Option<i32> {
    let code: i32 = error.as_database_error()?.code()?.parse().ok()?;
    Some(code & 0xff)
}

/// `SQLITE_FULL`, or an I/O error because no space is left.
pub(super) fn is_full(error: &sqlx::Error) -> bool {
    primary_code(error) == Some(13)
        || matches!(error, sqlx::Error::Io(io) if io.kind() == std::io::ErrorKind::StorageFull)
}

/// `SQLITE_CORRUPT` or `SQLITE_NOTADB`: the content of the file is broken.
pub(super) fn is_corrupt(error: &sqlx::Error) -> bool {
    matches!(primary_code(error), Some(11 | 26))
}

/// `SQLITE_NOTADB`: the file does not have the format of SQLite.
pub(super) fn is_no_database(error: &sqlx::Error) -> bool {
    primary_code(error) == Some(26)
}

/// `SQLITE_BUSY`: another program holds the lock of the file.
pub(super) fn is_locked(error: &sqlx::Error) -> bool {
    primary_code(error) == Some(5)
}

/// `SQLITE_INTERRUPT`: a progress handler ended the statement.
pub(super) fn is_interrupted(error: &sqlx::Error) -> bool {
    primary_code(error) == Some(9)
}

/// Whether the statement was refused, independent of the disk.
pub(super) fn is_refused(error: &sqlx::Error) -> bool {
    match primary_code(error) {
        Some(code) => REFUSALS.contains(&code),
        None => !matches!(error, sqlx::Error::Io(_) | sqlx::Error::WorkerCrashed),
    }
}
