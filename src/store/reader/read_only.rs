//! Access from outside the daemon: SQL queries, and backups while it runs.

use std::{
    io,
    path::{Path, PathBuf},
};

use futures_util::TryStreamExt;
use sqlx::{
    AssertSqlSafe, Column, Connection, Either, Executor, Row, SqlSafeStr, SqliteConnection, Statement, TypeInfo,
    ValueRef,
    sqlite::{SqliteConnectOptions, SqliteRow},
};

use crate::store::{
    error::{StoreError, is_full, is_locked, is_no_database},
    files::{DatabaseFiles, open, path::beside},
};

/// A value in the result of a query.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// NULL.
    Null,
    /// A whole number.
    Integer(i64),
    /// A 64-bit float.
    Real(f64),
    /// Text.
    Text(String),
    /// Bytes.
    Blob(Vec<u8>),
}

/// Connects read-only.
pub(super) async fn connect(path: &Path) -> Result<SqliteConnection, StoreError> {
    SqliteConnection::connect_with(&options(path).await?).await.map_err(StoreError::open(path))
}

/// Options of a read-only connection. A closed database in a read-only folder is opened as immutable, as SQLite cannot
/// create its other files there. A file that is no database of pointsd is refused.
pub(crate) async fn options(path: &Path) -> Result<SqliteConnectOptions, StoreError> {
    let file = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let error = StoreError::open(path);
    let options = open::read_options(&file);
    let mut first = SqliteConnection::connect_with(&options).await.map_err(&error)?;
    match sqlx::query_scalar::<_, i64>("SELECT count(*) FROM sqlite_schema").fetch_one(&mut first).await {
        Ok(0) => Err(StoreError::Empty(path.to_owned())),
        Ok(_) if open::foreign_table(&mut first).await.is_ok_and(|table| table.is_some()) => {
            Err(StoreError::foreign(path, "is the database of another program"))
        }
        Ok(_) => Ok(options),
        Err(error) if is_no_database(&error) => Err(StoreError::foreign(path, "is not a database")),
        Err(locked) if is_locked(&locked) => Err(error(locked)),
        Err(_) if std::fs::metadata(beside(&file, "-wal")).map_or(0, |log| log.len()) == 0 => {
            Ok(options.immutable(true))
        }
        Err(source) => Err(error(source)),
    }
}

/// Refuses a database of another version, for commands that only read it: their queries need every migration.
pub(super) async fn refuse_other_version(path: &Path, connection: &mut SqliteConnection) -> Result<(), StoreError> {
    let versions = async { Ok((open::needed_schema(connection).await?, open::applied(connection).await?)) };
    let (needed, applied) = versions.await.map_err(StoreError::read)?;
    open::refuse_newer(path, needed)?;
    if applied.contains(&open::newest_known()) {
        return Ok(());
    }
    Err(StoreError::Schema(format!(
        "the database {} is of an older version of pointsd: make a copy, name it in store.path of a configuration, and \
         start `pointsd run` with it once, which brings it up to date",
        path.display()
    )))
}

/// Writes the result of a query, row by row.
pub(crate) trait ResultWriter {
    /// Writes the column names.
    fn columns(&mut self, names: &[String]) -> io::Result<()>;
    fn row(&mut self, values: Vec<Value>) -> io::Result<()>;
    fn end(&mut self) -> io::Result<()>;
}

/// Runs the statement `query` read-only on the database at `path`. An error of `output` ends the query.
pub(crate) async fn run_query(path: &Path, query: &str, output: &mut dyn ResultWriter) -> Result<(), StoreError> {
    let mut connection = connect(path).await?;
    // VACUUM INTO writes a new file even on a read-only connection, and with `query_only` it still creates the file.
    let parts = || query.split([';', '\n']).flat_map(|part| part.split("*/"));
    if parts().any(|part| after_word(part, "vacuum").is_some()) {
        let problem = "VACUUM writes a file: use pointsd backup for a copy of the database";
        return Err(StoreError::Statement(problem.to_owned()));
    }
    // SQLite reports an I/O error, or that the database is locked.
    if parts().filter_map(|part| after_word(part, "pragma")).any(sets_journal_mode) {
        return Err(StoreError::writes());
    }
    let query = AssertSqlSafe(query.to_owned()).into_sql_str();
    let statement = connection.prepare(query.clone()).await.map_err(StoreError::statement)?;
    let names: Vec<_> = statement.columns().iter().map(|column| column.name().to_owned()).collect();
    let mut results = connection.fetch_many(sqlx::raw_sql(query));
    let mut next = results.try_next().await.map_err(StoreError::statement)?;
    if next.is_none() {
        let problem = "the query is empty: write a statement, or leave it out for a list of the views";
        return Err(StoreError::Statement(problem.to_owned()));
    }
    output.columns(&names).map_err(StoreError::Output)?;
    while let Some(Either::Right(row)) = next {
        let values = (0..row.len()).map(|at| value(&row, at)).collect::<sqlx::Result<_>>();
        output.row(values.map_err(StoreError::read)?).map_err(StoreError::Output)?;
        next = results.try_next().await.map_err(StoreError::statement)?;
    }
    output.end().map_err(StoreError::Output)?;
    // The end of the first statement was read above. Any further result is of a second statement.
    match results.try_next().await.map_err(StoreError::statement)? {
        Some(_) => Err(StoreError::SeveralStatements),
        None => Ok(()),
    }
}

/// The text after `word` if a part of a query begins with it. A statement begins at the start, or after a semicolon or a
/// comment.
fn after_word<'a>(part: &'a str, word: &str) -> Option<&'a str> {
    let is_space = |c: char| c.is_whitespace() || c == '\u{feff}';
    let part = part.trim_start_matches(is_space);
    let (first, rest) = part.split_at(part.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(part.len()));
    first.eq_ignore_ascii_case(word).then_some(rest)
}

/// Whether a PRAGMA sets the journal mode of a database, as in `main.journal_mode = DELETE`.
fn sets_journal_mode(pragma: &str) -> bool {
    let Some((name, _)) = pragma.split_once(['=', '(']) else { return false };
    name.trim().rsplit('.').next().is_some_and(|name| name.trim().eq_ignore_ascii_case("journal_mode"))
}

pub(crate) fn value(row: &SqliteRow, at: usize) -> sqlx::Result<Value> {
    let raw = row.try_get_raw(at)?;
    if raw.is_null() {
        return Ok(Value::Null);
    }
    // The type of this value: the column of an expression has no declared type.
    Ok(match raw.type_info().name() {
        "INTEGER" | "BOOLEAN" => Value::Integer(row.try_get_unchecked(at)?),
        "REAL" => Value::Real(row.try_get_unchecked(at)?),
        "TEXT" => Value::Text(row.try_get_unchecked(at)?),
        _ => Value::Blob(row.try_get_unchecked(at)?),
    })
}

/// A backup of a database in use, with its progress.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Backup {
    from: PathBuf,
    to: PathBuf,
    partial: PathBuf,
}

impl Backup {
    /// A backup of the database `from`, which may be in use, to the new file `to`.
    pub(crate) fn new(from: &Path, to: &Path) -> Result<Self, StoreError> {
        if to.exists() {
            let says = "this file exists already, name a new one";
            let source = std::io::Error::new(std::io::ErrorKind::AlreadyExists, says);
            return Err(StoreError::File { action: "create", path: to.to_owned(), source });
        }
        Ok(Self { from: from.to_owned(), to: to.to_owned(), partial: beside(to, ".partial") })
    }

    /// Size of the database \[bytes\]; the copy has about the same size.
    pub(crate) fn total_bytes(&self) -> u64 {
        std::fs::metadata(&self.from).map_or(0, |file| file.len())
    }

    /// Bytes copied so far.
    pub(crate) fn copied_bytes(&self) -> u64 {
        std::fs::metadata(&self.partial).map_or(0, |file| file.len())
    }

    /// Copies one consistent state, checks the copy, and renames it to `to` when it is complete. Returns its size
    /// \[bytes\].
    pub(crate) async fn run(&self) -> Result<u64, StoreError> {
        let file = |action| StoreError::file(action, &self.partial);
        if self.partial.exists() {
            std::fs::remove_file(&self.partial).map_err(file("remove"))?;
        }
        // SQLite would not say which of the two files it cannot open. It accepts an empty file as the copy.
        std::fs::File::create_new(&self.partial).map_err(file("create"))?;
        self.copy().await.inspect_err(|_| {
            // Ignored: the first error is reported.
            let _ = std::fs::remove_file(&self.partial);
        })?;
        let size = self.copied_bytes();
        std::fs::File::open(&self.partial)
            .and_then(|copy| copy.sync_all())
            .and_then(|()| std::fs::rename(&self.partial, &self.to))
            .and_then(|()| DatabaseFiles::new(&self.to).sync_folder())
            .map_err(file("complete"))?;
        Ok(size)
    }

    async fn copy(&self) -> Result<(), StoreError> {
        let mut connection = connect(&self.from).await?;
        let vacuum = sqlx::query("VACUUM INTO ?1").bind(self.partial.to_string_lossy());
        vacuum.execute(&mut connection).await.map_err(|error| {
            // The backup writes only the copy, so it is the disk of the copy that is full.
            let source = std::io::Error::new(std::io::ErrorKind::StorageFull, "no space is left on its disk");
            let full = StoreError::File { action: "write", path: self.partial.clone(), source };
            if is_full(&error) { full } else { StoreError::read(error) }
        })?;
        let mut copy = connect(&self.partial).await?;
        let damage = open::damage(&mut copy).await.map_err(StoreError::read)?;
        copy.close().await.map_err(StoreError::read)?;
        match damage {
            None => Ok(()),
            Some(damage) => Err(StoreError::Damaged { path: self.partial.clone(), damage }),
        }
    }
}
