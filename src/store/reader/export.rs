//! Stored throws with their estimates, page by page, for `pointsd export`.

use std::path::Path;

use jiff::Timestamp;
use sqlx::{Column, Executor, FromRow, Row, SqlSafeStr, SqliteConnection, Statement};

use super::read_only::{self, Value};
use crate::{
    store::{error::StoreError, rows::StoredThrow, statements as sql},
    throw::MachineId,
};

/// Number of throws in a page. A page is a short read, so that a running daemon can truncate its log between two pages.
const PAGE_THROWS: u32 = 500;
/// Number of columns for paging, before the exported columns.
const PAGING_COLUMNS: usize = 2;

/// Reads the throws of one machine or of all machines in a range of time, in the order of their start.
#[derive(Debug)]
pub(crate) struct Export {
    connection: SqliteConnection,
    /// `None` for all machines.
    machine: Option<MachineId>,
    /// Start time \[µs\] and row after which the next page begins.
    after: (i64, i64),
    until_us: i64,
}

/// A throw of a page.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Exported {
    throw_row: i64,
    /// The values of [`Export::columns`].
    pub values: Vec<Value>,
}

impl Export {
    /// Opens the database at `path`, which a daemon may use at the same time, for throws that started from `since` to
    /// before `until`. An unknown machine has no throws.
    pub(crate) async fn open(
        path: &Path,
        machine: Option<MachineId>,
        since: Option<Timestamp>,
        until: Option<Timestamp>,
    ) -> Result<Self, StoreError> {
        let mut connection = read_only::connect(path).await?;
        read_only::refuse_other_version(path, &mut connection).await?;
        let microseconds = |bound: Option<Timestamp>, none| bound.map_or(none, Timestamp::as_microsecond);
        let after = (microseconds(since, i64::MIN), i64::MIN);
        Ok(Self { connection, machine, after, until_us: microseconds(until, i64::MAX) })
    }

    /// The names of the columns.
    pub(crate) async fn columns(&mut self) -> Result<Vec<String>, StoreError> {
        let statement = self.connection.prepare(sql::EXPORT.into_sql_str()).await.map_err(StoreError::read)?;
        Ok(statement.columns().iter().skip(PAGING_COLUMNS).map(|column| column.name().to_owned()).collect())
    }

    /// The next throws; empty at the end.
    pub(crate) async fn page(&mut self) -> Result<Vec<Exported>, StoreError> {
        let (after_us, after_row) = self.after;
        let query = match &self.machine {
            Some(id) => sqlx::query(sql::EXPORT_MACHINE).bind(id.site.as_str()).bind(id.machine.as_str()),
            None => sqlx::query(sql::EXPORT).bind(None::<&str>).bind(None::<&str>),
        };
        let query = query.bind(after_us).bind(after_row).bind(self.until_us).bind(PAGE_THROWS);
        let read = async {
            let rows = query.fetch_all(&mut self.connection).await?;
            if let Some(last) = rows.last() {
                self.after = (last.try_get("started_at_us")?, last.try_get("throw_row")?);
            }
            let exported = |row| {
                let values = (PAGING_COLUMNS..Row::len(row)).map(|at| read_only::value(row, at));
                Ok(Exported { throw_row: row.try_get("throw_row")?, values: values.collect::<sqlx::Result<_>>()? })
            };
            rows.iter().map(exported).collect::<sqlx::Result<_>>()
        };
        read.await.map_err(StoreError::read)
    }

    /// A throw of a page with its trace; `None` if retention has deleted it.
    pub(crate) async fn stored(&mut self, of: &Exported) -> Result<Option<StoredThrow>, StoreError> {
        let row = sqlx::query(sql::STORED_THROW).bind(of.throw_row).fetch_optional(&mut self.connection).await;
        let row = row.map_err(StoreError::read)?;
        row.map(|row| StoredThrow::from_row(&row)).transpose().map_err(StoreError::read)
    }
}
