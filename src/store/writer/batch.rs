//! Statements for many rows at once. Each statement and each row of a result wakes a thread: with one statement for each
//! row, this took a fifth of the processor time.

use sqlx::{AssertSqlSafe, Sqlite, query::Query, sqlite::SqliteArguments};

/// Largest number of rows in a statement. An estimate has 46 parameters, so a statement has at most 2,944; SQLite allows
/// 32,766.
pub(crate) const MAX_ROWS: usize = 64;

/// The statement with its first `(?, …)` repeated for `rows` rows. The number of rows is rounded up to a power of two,
/// so that few different statements are prepared. The parameters of the added rows are NULL; every such statement
/// ignores rows whose first parameter is NULL.
pub(crate) fn query<'q>(statement: &str, rows: usize) -> Query<'q, Sqlite, SqliteArguments> {
    let from = statement.find("(?").unwrap_or(0);
    let to = statement[from..].find(')').map_or(statement.len(), |length| from + length + 1);
    let row = &statement[from..to];
    let rows = vec![row; rows.next_power_of_two()].join(",");
    sqlx::query(AssertSqlSafe([&statement[..from], &rows, &statement[to..]].concat()))
}
