//! Every statement of the store fits the schema.

use pointsd::store::statements;
use sqlx::{Connection, Executor, SqlSafeStr, SqliteConnection};

use crate::given::open;

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
