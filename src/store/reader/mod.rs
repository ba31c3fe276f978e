//! The reader: short queries on read-only connections.

pub(super) mod export;
pub(super) mod fleet;
pub(super) mod history;
pub(super) mod machine;
pub(super) mod pipeline;
pub(super) mod read_only;

use std::{future::Future, path::Path, sync::Arc, time::Duration};

use parking_lot::RwLock;
use sqlx::{
    FromRow, Sqlite, SqlitePool,
    query::QueryAs,
    sqlite::{SqliteArguments, SqliteConnectOptions, SqlitePoolOptions, SqliteRow},
};
use tokio::time::{Instant, timeout};
use tokio_util::sync::CancellationToken;

use super::{
    error::{StoreError, is_corrupt},
    files::open,
    recent::RecentThrows,
};
use crate::{throw::MachineId, wire::Alarm};

/// Connections for the daemon. Reader and writer do not wait for each other.
const CONNECTIONS: u32 = 2;
/// Connections for external queries (zenoh, dashboard); more queries wait.
const EXTERNAL_CONNECTIONS: u32 = 3;
/// Instructions of SQLite's virtual machine between two checks of the clock: some milliseconds.
const STEPS: i32 = 100_000;

/// Reads the database. Cheap to clone. A query fails when the database cannot be read, and at its time limit: while it
/// runs, it keeps an old state of the database in the log.
#[derive(Debug, Clone)]
pub struct Reader {
    /// The connections; replaced when the database moves to another file.
    pools: Arc<RwLock<Pools>>,
    /// Cancelled when a query finds the file broken.
    broken: CancellationToken,
    /// Cancelled when the store closes: external queries end.
    closing: CancellationToken,
    pub(super) recent: RecentThrows,
}

/// Separate connections, so that many external queries cannot delay the pipeline.
#[derive(Debug, Clone)]
struct Pools {
    internal: SqlitePool,
    external: SqlitePool,
}

impl Reader {
    /// Time limit of a query. The write-ahead log grows while a query reads an old state.
    pub const TIME_LIMIT: Duration = Duration::from_secs(10);

    /// Opens a database that another process may write.
    ///
    /// # Errors
    /// When the database does not exist or cannot be read.
    pub async fn open(path: &Path) -> Result<Self, StoreError> {
        Self::with(path, open::read_options(path)).await
    }

    /// Opens a database for a command that may have no right to write into its folder.
    pub(crate) async fn open_outside(path: &Path) -> Result<Self, StoreError> {
        let reader = Self::with(path, read_only::options(path).await?).await?;
        let mut connection = reader.pools().internal.acquire().await.map_err(StoreError::open(path))?;
        read_only::refuse_other_version(path, &mut connection).await?;
        drop(connection);
        Ok(reader)
    }

    async fn with(path: &Path, options: SqliteConnectOptions) -> Result<Self, StoreError> {
        let pools = Pools::new(&options);
        pools.internal.acquire().await.map_err(StoreError::open(path))?;
        Ok(Self {
            pools: Arc::new(RwLock::new(pools)),
            broken: CancellationToken::new(),
            closing: CancellationToken::new(),
            recent: RecentThrows::default(),
        })
    }

    pub(super) async fn close(&self) {
        self.closing.cancel();
        let Pools { internal, external } = self.pools();
        internal.close().await;
        external.close().await;
    }

    /// Opens the file that is at `path` now. Running queries keep the old file until they end: the old pools are
    /// dropped, not closed, so that these queries do not fail.
    pub(super) fn reopen(&self, path: &Path) {
        *self.pools.write() = Pools::new(&open::read_options(path));
    }

    pub(super) async fn limited<T>(&self, query: impl Future<Output = sqlx::Result<T>>) -> Result<T, StoreError> {
        let answer = timeout(Self::TIME_LIMIT, query).await.map_err(|_| StoreError::ReadTimeout)?;
        if let Err(error) = &answer
            && is_corrupt(error)
            && !self.broken.is_cancelled()
        {
            tracing::error!(%error, "a query found the database broken; the next start sets the file aside");
            self.broken.cancel();
        }
        answer.map_err(StoreError::read)
    }

    /// Whether a query has found the file broken.
    pub(super) fn is_broken(&self) -> bool {
        self.broken.is_cancelled()
    }

    /// Resolves when a query finds the file broken.
    pub(super) async fn breaks(&self) {
        self.broken.cancelled().await;
    }

    pub(super) fn pool(&self) -> SqlitePool {
        self.pools().internal
    }

    fn pools(&self) -> Pools {
        self.pools.read().clone()
    }

    /// Runs a query of the daemon.
    async fn rows<Row: FromSql>(&self, query: Select<'_, Row>) -> Result<Vec<Row>, StoreError> {
        self.limited(query.fetch_all(&self.pool())).await
    }

    /// Runs an external query. SQLite itself aborts a slow query, as it would otherwise continue without its caller and
    /// occupy the connection.
    pub(super) async fn external<Row: FromSql>(&self, query: Select<'_, Row>) -> Result<Vec<Row>, StoreError> {
        let answer = async {
            let mut connection = self.pools().external.acquire().await?;
            let end = Instant::now() + Self::TIME_LIMIT;
            let closing = self.closing.clone();
            let continues = move || Instant::now() < end && !closing.is_cancelled();
            connection.lock_handle().await?.set_progress_handler(STEPS, continues);
            query.fetch_all(&mut *connection).await
        };
        self.limited(answer).await
    }

    /// Runs an external query, and returns its first row; `None` if it has no row.
    pub(super) async fn external_row<Row: FromSql>(&self, query: Select<'_, Row>) -> Result<Option<Row>, StoreError> {
        Ok(self.external(query).await?.into_iter().next())
    }

    /// Runs an external query for alarms. Alarms of a newer version that cannot be read are left out.
    pub(super) async fn external_alarms(&self, query: Select<'_, (String,)>) -> Result<Vec<Alarm>, StoreError> {
        let payloads = self.external(query).await?;
        let alarms: Vec<Alarm> = payloads.iter().filter_map(|(payload,)| serde_json::from_str(payload).ok()).collect();
        let unreadable = payloads.len() - alarms.len();
        if unreadable > 0 {
            tracing::warn!(unreadable, "alarms of a newer version left out");
        }
        Ok(alarms)
    }
}

/// A query of rows.
pub(super) type Select<'q, Row> = QueryAs<'q, Sqlite, Row, SqliteArguments>;

/// A row that a query can return.
pub(super) trait FromSql: Send + Unpin + for<'r> FromRow<'r, SqliteRow> {}

impl<Row: Send + Unpin + for<'r> FromRow<'r, SqliteRow>> FromSql for Row {}

/// A query about one machine, whose site and name are the first two parameters.
pub(super) fn machine_query<'q, Row: FromSql>(statement: &'static str, machine: &'q MachineId) -> Select<'q, Row> {
    sqlx::query_as(statement).bind(machine.site.as_str()).bind(machine.machine.as_str())
}

impl Pools {
    /// Pools that connect when they are used.
    fn new(database: &SqliteConnectOptions) -> Self {
        let pool = |connections| {
            let options = SqlitePoolOptions::new().max_lifetime(None).idle_timeout(None).max_connections(connections);
            options.connect_lazy_with(database.clone())
        };
        Self { internal: pool(CONNECTIONS), external: pool(EXTERNAL_CONNECTIONS) }
    }
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;
    use sqlx::Connection as _;

    use super::*;
    use crate::store::{FleetQuery, Settings, Store};

    async fn fresh() -> (tempfile::TempDir, Store) {
        let folder = tempfile::tempdir().unwrap();
        let settings = Settings { path: folder.path().join("points.db"), ballast_mib: 0, ..Settings::default() };
        let store = Store::open(&settings, Timestamp::UNIX_EPOCH).await.unwrap().store;
        (folder, store)
    }

    #[tokio::test]
    async fn the_fleet_page_does_not_use_the_connections_of_the_daemon() {
        let (_folder, store) = fresh().await;
        let (reader, query) = (store.reader(), FleetQuery::default());
        let itself = MachineId::new("fleet", "pointsd").unwrap();
        reader.pools().internal.close().await;
        reader.machines().await.unwrap();
        reader.windows(None).await.unwrap();
        reader.tally(&query, &itself).await.unwrap();
        reader.fleet(&query, &itself).await.unwrap();
    }

    /// The small chart of a machine that throws in one direction only, and the page of a machine without a judged throw.
    #[tokio::test]
    async fn a_machine_is_known_by_any_throw_and_has_a_small_chart_of_any_direction() {
        let (_folder, store) = fresh().await;
        let mut writer =
            sqlx::SqliteConnection::connect_with(&SqliteConnectOptions::new().filename(store.path())).await.unwrap();
        for change in [
            "INSERT INTO machine (machine_row, site, machine) VALUES (1, 'north', '21B'), (2, 'north', '22')",
            "INSERT INTO boot (boot_row, machine_row, boot_id, first_seen_us, highest_no) VALUES (1, 1, 'b', 0, 2), (2, 2, 'b', 0, 1)",
            "INSERT INTO throw (throw_row, machine_row, boot_row, throw_no, started_at_us, received_at_us, sample_rate_hz, samples, \
             content_crc32, judged_at_us) VALUES (1, 1, 1, 1, 0, 0, 100.0, 9, 0, 0), (2, 1, 1, 2, 0, 0, 100.0, 9, 0, 0), \
             (3, 2, 2, 1, 0, 0, 100.0, 9, 0, NULL)",
            "INSERT INTO estimate (throw_row, machine_row, direction, direction_contradicted, quality, b0_pct, a1_pct, a0_pct, \
             throws_since_baseline) VALUES (1, 1, 'reverse_to_normal', 0, 'good', 1.0, 2.0, 3.0, 0), \
             (2, 1, 'reverse_to_normal', 0, 'good', 4.0, 5.0, 6.0, 0)",
        ] {
            sqlx::query(change).execute(&mut writer).await.unwrap();
        }
        let (reader, query) = (store.reader(), FleetQuery { limit: 9, spark: 9, ..FleetQuery::default() });
        let rows = reader.fleet(&query, &MachineId::new("fleet", "pointsd").unwrap()).await.unwrap();
        let sparks: Vec<_> = rows.iter().map(|row| &row.spark[..]).collect();
        assert_eq!(sparks, [&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]][..], &[]]);
        for (name, is_known) in [("21B", true), ("22", true), ("23", false)] {
            assert_eq!(reader.is_known(&MachineId::new("north", name).unwrap()).await.unwrap(), is_known, "{name}");
        }
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_store_that_closes_ends_a_slow_external_query() {
        let (_folder, store) = fresh().await;
        let reader = store.reader().clone();
        let endless = "WITH RECURSIVE c (x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT max(x) FROM c";
        let external = reader.pools().external;
        let query = tokio::spawn(async move { reader.external::<(i64,)>(sqlx::query_as(endless)).await });
        while external.size() == 0 {
            tokio::task::yield_now().await;
        }
        let start = Instant::now();
        store.close().await.unwrap();
        assert!(start.elapsed() < Reader::TIME_LIMIT / 4, "{:?}", start.elapsed());
        assert!(query.await.unwrap().is_err());
    }
}
