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

use sqlx::{
    AssertSqlSafe, Connection, FromRow, SqliteConnection,
    sqlite::{SqliteConnectOptions, SqliteJournalMode},
};

use crate::store::{settings::PAGE_BYTES, statements as sql};

/// Adds a row to the schema; needs `PRAGMA writable_schema`.
const ADD: &str = "INSERT INTO sqlite_schema (type, name, tbl_name, rootpage, sql) VALUES (?1, ?2, ?3, ?4, ?5)";

/// A row of the schema.
#[derive(FromRow)]
struct Entry {
    r#type: String,
    name: String,
    tbl_name: String,
    rootpage: i64,
    sql: Option<String>,
}

/// Copies the broken file to `copy`, and writes the schema table of a new or of a moved database into the copy,
/// depending on which makes more tables readable. False if at most half of the tables are readable with either: in a
/// wrong layout a few tables fit by chance. Writes the empty database with the layout of a moved one to `layout`.
pub(super) async fn graft(
    fresh: &mut SqliteConnection,
    broken: &Path,
    copy: &Path,
    layout: &Path,
) -> sqlx::Result<bool> {
    let pages = fs::copy(broken, copy)? / PAGE_BYTES as u64;
    let mut best = (0, None);
    for layout in [entries(fresh).await?, moved(fresh, layout).await?] {
        let sound = apply(copy, pages, &layout).await?;
        if sound > best.0 {
            best = (sound, Some(layout));
        }
    }
    match best {
        (sound, Some(layout)) if 2 * sound > layout.iter().filter(|entry| entry.is_table()).count() => {
            apply(copy, pages, &layout).await.map(|_| true)
        }
        _ => Ok(false),
    }
}

impl Entry {
    fn is_table(&self) -> bool {
        self.r#type == "table"
    }
}

async fn entries(connection: &mut SqliteConnection) -> sqlx::Result<Vec<Entry>> {
    sqlx::query_as(sql::SCHEMA).fetch_all(connection).await
}

/// The layout of a moved or restored database.
async fn moved(fresh: &mut SqliteConnection, to: &Path) -> sqlx::Result<Vec<Entry>> {
    sqlx::query("VACUUM INTO ?1").bind(to.to_string_lossy()).execute(fresh).await?;
    let mut connection = SqliteConnection::connect_with(&SqliteConnectOptions::new().filename(to)).await?;
    let entries = entries(&mut connection).await;
    connection.close().await?;
    fs::remove_file(to)?;
    entries
}

/// Writes a layout into the copy; returns the number of tables with an undamaged first page.
async fn apply(copy: &Path, pages: u64, layout: &[Entry]) -> sqlx::Result<usize> {
    begin_anew(copy, pages)?;
    // After an interruption the copy is made again, so it needs no journal.
    let options = SqliteConnectOptions::new().filename(copy).journal_mode(SqliteJournalMode::Memory);
    let mut connection = SqliteConnection::connect_with(&options).await?;
    sqlx::query("PRAGMA writable_schema = ON").execute(&mut connection).await?;
    sqlx::query("BEGIN").execute(&mut connection).await?;
    for Entry { r#type, name, tbl_name, rootpage, sql } in layout {
        let add = sqlx::query(ADD).bind(r#type).bind(name).bind(tbl_name).bind(rootpage).bind(sql);
        add.execute(&mut connection).await?;
    }
    sqlx::query("COMMIT").execute(&mut connection).await?;
    connection.close().await?;
    let mut connection = SqliteConnection::connect_with(&options).await?;
    let mut sound = 0;
    for table in layout.iter().filter(|entry| entry.is_table()) {
        let probe = AssertSqlSafe(format!("SELECT EXISTS (SELECT 1 FROM {:?})", table.name));
        sound += usize::from(sqlx::query(probe).fetch_one(&mut connection).await.is_ok());
    }
    connection.close().await?;
    Ok(sound)
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
