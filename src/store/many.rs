//! Statements for many rows. A call of the database thread, and each statement and row of its result, wakes a thread;
//! this cost a fifth of the processor time when each row had its own call.

use sqlx::{AssertSqlSafe, Sqlite, query::Query, sqlite::SqliteArguments};

/// Largest number of rows in a statement: that of a group of writes and of a batch of judgements.
pub(super) const ROWS: usize = 64;

/// A statement with its row of parameters, the first `(?, …)`, repeated for `rows` rows. Their number is rounded up to
/// a power of two, so that few statements are prepared. The parameters of the other rows are NULL: every such statement
/// ignores rows whose first parameter is NULL.
pub(super) fn query<'q>(statement: &str, rows: usize) -> Query<'q, Sqlite, SqliteArguments> {
    let from = statement.find("(?").unwrap_or(0);
    let to = statement[from..].find(')').map_or(statement.len(), |length| from + length + 1);
    let row = &statement[from..to];
    let rows = vec![row; rows.next_power_of_two()].join(",");
    sqlx::query(AssertSqlSafe([&statement[..from], &rows, &statement[to..]].concat()))
}
