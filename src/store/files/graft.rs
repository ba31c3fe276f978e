//! Replaces a damaged schema table in a copy of the database by the schema table of a new database, whose tables start
//! on the same pages. Without the schema SQLite cannot read any table, even an undamaged one.
//!
//! With auto-vacuum the first page of each table depends only on the order in which the tables were created. There are
//! two layouts: the layout of the migrations, and the layout of a moved or restored database.

use std::{
    fs::{self, OpenOptions},
    io,
    os::unix::fs::FileExt,
    path::Path,
};

use sqlx::{AssertSqlSafe, SqliteConnection};

use crate::store::settings::PAGE_BYTES;

/// Copies the broken file to `copy`, and writes the schema table of the new database or of a moved one into the copy,
/// depending on which makes more tables readable. False if at most half of the tables are readable with either: in a
/// wrong layout a few tables fit by chance. `connection` has the new database open. The file `moved` is the new database
/// with the layout of a moved one, while this runs.
pub(super) async fn graft(
    connection: &mut SqliteConnection,
    broken: &Path,
    copy: &Path,
    moved: &Path,
) -> sqlx::Result<bool> {
    let pages = fs::copy(broken, copy)? / PAGE_BYTES as u64;
    sqlx::query("VACUUM INTO ?1").bind(moved.to_string_lossy()).execute(&mut *connection).await?;
    sqlx::query("ATTACH ?1 AS moved").bind(moved.to_string_lossy()).execute(&mut *connection).await?;
    let tables: Vec<String> = sqlx::query_scalar("SELECT name FROM main.sqlite_schema WHERE type = 'table'")
        .fetch_all(&mut *connection)
        .await?;
    let mut best = (0, "main");
    for layout in ["main", "moved"] {
        let readable = write(connection, layout, copy, pages, &tables).await?;
        if readable > best.0 {
            best = (readable, layout);
        }
    }
    let (readable, layout) = best;
    let is_usable = 2 * readable > tables.len();
    if is_usable {
        write(connection, layout, copy, pages, &tables).await?;
    }
    sqlx::query("DETACH moved").execute(connection).await?;
    fs::remove_file(moved)?;
    Ok(is_usable)
}

/// Writes the layout of an attached database into the copy; returns the number of tables with an undamaged first page.
async fn write(
    connection: &mut SqliteConnection,
    layout: &str,
    copy: &Path,
    pages: u64,
    tables: &[String],
) -> sqlx::Result<usize> {
    begin_anew(copy, pages)?;
    let attach = || sqlx::query("ATTACH ?1 AS copy").bind(copy.to_string_lossy());
    attach().execute(&mut *connection).await?;
    let schema = format!(
        "PRAGMA writable_schema = ON; \
         INSERT INTO copy.sqlite_schema SELECT * FROM {layout}.sqlite_schema WHERE rootpage > 0 ORDER BY rowid; \
         PRAGMA writable_schema = OFF; DETACH copy"
    );
    sqlx::raw_sql(AssertSqlSafe(schema)).execute(&mut *connection).await?;
    // SQLite reads the new schema, and fails if a table would start behind the end of the file.
    if attach().execute(&mut *connection).await.is_err() {
        return Ok(0);
    }
    let mut readable = 0;
    for table in tables {
        let probe = AssertSqlSafe(format!("SELECT EXISTS (SELECT 1 FROM copy.{table:?})"));
        readable += usize::from(sqlx::query(probe).fetch_one(&mut *connection).await.is_ok());
    }
    sqlx::query("DETACH copy").execute(connection).await?;
    Ok(readable)
}

/// Writes a first page with an empty schema (<https://sqlite.org/fileformat2.html>), and truncates the file after its
/// last page.
fn begin_anew(copy: &Path, pages: u64) -> io::Result<()> {
    let mut page = [0; PAGE_BYTES];
    page[..16].copy_from_slice(b"SQLite format 3\0");
    let count = u32::try_from(pages).unwrap_or(u32::MAX).to_be_bytes();
    for (at, bytes) in [
        (16, &[16, 0, 1, 1, 0, 64, 32, 32][..]), // page size, rollback journal, payload fractions
        (24, &[0, 0, 0, 1]),                     // change counter
        (28, &count),                            // number of pages
        (40, &[0, 0, 0, 1, 0, 0, 0, 4]),         // schema cookie and format
        (56, &[0, 0, 0, 1]),                     // UTF-8
        (92, &[0, 0, 0, 1, 0, 46, 80, 0]),       // change counter at the last write, version of SQLite
        (100, &[13, 0, 0, 0, 0, 16, 0, 0]),      // an empty leaf
    ] {
        page[at..at + bytes.len()].copy_from_slice(bytes);
    }
    let file = OpenOptions::new().write(true).open(copy)?;
    file.set_len(pages * PAGE_BYTES as u64)?;
    file.write_all_at(&page, 0)
}
