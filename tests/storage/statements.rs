//! Every statement of the store fits the schema.

use pointsd::store::statements;
use sqlx::{Connection, Executor, SqlSafeStr, SqliteConnection};

use crate::given::{judgement, open, spooled};

#[tokio::test]
async fn every_statement_prepares_against_the_migrated_schema() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path()).await.store;
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(store.path());
    let mut connection = SqliteConnection::connect_with(&options).await.unwrap();
    let mut wrong = Vec::new();
    for &(name, sql) in statements::ALL {
        if let Err(error) = connection.prepare(sql.into_sql_str()).await {
            wrong.push(format!("{name}: {error}"));
        }
    }
    assert!(statements::ALL.len() > 40);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// What runs for every throw must not read the whole history.
#[tokio::test]
async fn the_statements_of_every_throw_find_their_rows_by_index() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path()).await.store;
    for throw_no in 1..=50 {
        let row = spooled(&store, "21B", "b1", throw_no).await;
        store.judge(judgement(row, "21B")).await.unwrap();
    }
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(store.path()).read_only(true);
    let mut connection = SqliteConnection::connect_with(&options).await.unwrap();
    // Ordered by row and limited, so that they stop after a few rows; or of a small table.
    let reads_from_the_start = ["THROWS", "NEWEST_HEALTH"];
    for &(name, sql) in statements::ALL {
        let housekeeping = sql.starts_with("SELECT count") || name.contains("OLDEST") || name.contains("SPAN");
        if housekeeping || reads_from_the_start.contains(&name) || name.starts_with("AGED") || name.contains("EMPTY") {
            continue;
        }
        let question = sqlx::AssertSqlSafe(format!("EXPLAIN QUERY PLAN {sql}"));
        let plan: Vec<(i64, i64, i64, String)> = sqlx::query_as(question).fetch_all(&mut connection).await.unwrap();
        for (.., step) in plan {
            let scans =
                step.starts_with("SCAN throw") || step.starts_with("SCAN estimate") || step.starts_with("SCAN trace");
            assert!(!scans || step.contains("throw_waiting"), "{name}: {step}");
        }
    }
}
