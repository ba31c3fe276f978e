//! The reader: short queries on read-only connections.

pub(super) mod export;
pub(super) mod fleet;
pub(super) mod overview;
pub(super) mod read_only;

use std::{future::Future, path::Path, sync::Arc, time::Duration};

use jiff::Timestamp;
use parking_lot::RwLock;
use sqlx::{
    FromRow, Row as _, Sqlite, SqlitePool,
    query::QueryAs,
    sqlite::{SqliteArguments, SqliteConnectOptions, SqlitePoolOptions, SqliteRow},
};
use tokio::time::{Instant, timeout};
use tokio_util::sync::CancellationToken;

use super::{
    error::{StoreError, is_corrupt},
    files::open,
    rows::{Gap, OutboxRow, Selector, StoredMonitor, StoredThrow, ThrowRow, from_json, timestamp},
    statements as sql,
    writer::backlog_page::{self, Cursor},
};
use crate::{
    throw::MachineId,
    wire::{Alarm, Health},
};

/// Connections for the daemon. Reader and writer do not wait for each other.
const CONNECTIONS: u32 = 2;
/// Connections for external queries (zenoh, dashboard); more queries wait.
const EXTERNAL_CONNECTIONS: u32 = 3;
/// Number of samples of each channel after which a batch of pending throws ends: 32 MiB.
const BATCH_SAMPLES: usize = 2 << 20;
/// Instructions of SQLite's virtual machine between two checks of the clock: some milliseconds.
const STEPS: i32 = 100_000;

/// Reads the database. Cheap to clone. Every query has a time limit: while it runs, it keeps an old state of the
/// database in the log.
#[derive(Debug, Clone)]
pub struct Reader {
    /// The connections; replaced when the database moves to another file.
    pools: Arc<RwLock<Pools>>,
    /// Cancelled when a query finds the file broken.
    broken: CancellationToken,
    /// Cancelled when the store closes: external queries end.
    closing: CancellationToken,
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
    async fn rows<Row>(&self, query: QueryAs<'_, Sqlite, Row, SqliteArguments>) -> Result<Vec<Row>, StoreError>
    where
        Row: Send + Unpin + for<'r> FromRow<'r, SqliteRow>,
    {
        self.limited(query.fetch_all(&self.pool())).await
    }

    /// Runs an external query. SQLite itself aborts a slow query, as it would otherwise continue without its caller and
    /// occupy the connection.
    pub(super) async fn external<Row>(
        &self,
        query: QueryAs<'_, Sqlite, Row, SqliteArguments>,
    ) -> Result<Vec<Row>, StoreError>
    where
        Row: Send + Unpin + for<'r> FromRow<'r, SqliteRow>,
    {
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
    pub(super) async fn external_row<Row>(
        &self,
        query: QueryAs<'_, Sqlite, Row, SqliteArguments>,
    ) -> Result<Option<Row>, StoreError>
    where
        Row: Send + Unpin + for<'r> FromRow<'r, SqliteRow>,
    {
        Ok(self.external(query).await?.into_iter().next())
    }

    /// Runs an external query for alarms. Alarms of a newer version that cannot be read are left out.
    pub(super) async fn external_alarms(
        &self,
        query: QueryAs<'_, Sqlite, (String,), SqliteArguments>,
    ) -> Result<Vec<Alarm>, StoreError> {
        let payloads = self.external(query).await?;
        let alarms: Vec<Alarm> = payloads.iter().filter_map(|(payload,)| serde_json::from_str(payload).ok()).collect();
        let unreadable = payloads.len() - alarms.len();
        if unreadable > 0 {
            tracing::warn!(unreadable, "alarms of a newer version left out");
        }
        Ok(alarms)
    }

    /// Up to `limit` pending throws to judge next: the throws of a machine in order, the machines in turn, starting
    /// after the machine `after`. Throws after an awaited gap are left out, for at most `wait` after the backlog of the
    /// machine was opened or last became smaller. Also returns whether the batch is full.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn to_judge(
        &self,
        after: Option<&MachineId>,
        limit: u32,
        now: Timestamp,
        wait: Duration,
    ) -> Result<(Vec<StoredThrow>, bool), StoreError> {
        let (from_us, to_us) = waiting(now, wait);
        let turn = async |after: Option<&MachineId>| {
            let (site, machine) = after.map(|id| (id.site.to_string(), id.machine.to_string())).unzip();
            let query = sqlx::query(sql::TO_JUDGE).bind(site).bind(limit).bind(from_us).bind(to_us).bind(machine);
            let chosen = self.limited(query.fetch_one(&self.pool())).await?;
            chosen.try_get(0).and_then(from_json::<Vec<i64>>).map_err(StoreError::read)
        };
        let mut rows = turn(after).await?;
        if rows.is_empty() && after.is_some() {
            rows = turn(None).await?;
        }
        let mut is_full = rows.len() >= limit as usize;
        let (mut throws, mut samples) = (Vec::with_capacity(rows.len()), 0);
        for row in rows {
            // Retention may have just deleted the throw.
            let Some(stored) = self.rows(sqlx::query_as(sql::STORED_THROW).bind(row)).await?.pop() else { continue };
            let stored: StoredThrow = stored;
            samples += stored.throw.as_ref().map_or(0, |throw| throw.trace.len());
            throws.push(stored);
            if samples >= BATCH_SAMPLES {
                is_full = true;
                break;
            }
        }
        Ok((throws, is_full))
    }

    /// The cursor of a machine.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn cursor(&self, machine: &MachineId) -> Result<Cursor, StoreError> {
        let read = async {
            let mut connection = self.pool().acquire().await?;
            backlog_page::current(&mut connection, machine).await
        };
        self.limited(read).await
    }

    /// Up to `limit` machines with missing throws that their backlog may have, the longest waiting first.
    pub(crate) async fn backlogs(&self, limit: u32) -> Result<Vec<MachineId>, StoreError> {
        self.rows(sqlx::query_as(sql::BACKLOGS).bind(limit)).await
    }

    /// Number of missing throws that a backlog may have.
    pub(crate) async fn awaited(&self) -> Result<u64, StoreError> {
        let count: i64 = self.limited(sqlx::query_scalar(sql::AWAITED_COUNT).fetch_one(&self.pool())).await?;
        Ok(count.cast_unsigned())
    }

    /// Up to `limit` throws after `after`, judged or pending, in the order of arrival.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn throws(&self, after: ThrowRow, limit: u32) -> Result<Vec<StoredThrow>, StoreError> {
        self.rows(sqlx::query_as(sql::THROWS).bind(after.0).bind(limit)).await
    }

    /// The monitors of the next `limit` machines after `after` (`None` for the first ones), in the order of names.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn monitors(&self, after: Option<&MachineId>, limit: u32) -> Result<Vec<StoredMonitor>, StoreError> {
        let (site, machine) = after.map_or(("", ""), |after| (after.site.as_str(), after.machine.as_str()));
        self.rows(sqlx::query_as(sql::MONITORS).bind(site).bind(machine).bind(limit)).await
    }

    pub(crate) async fn machines(&self) -> Result<Vec<MachineId>, StoreError> {
        self.rows(sqlx::query_as(sql::MACHINES)).await
    }

    /// Time of reception of the newest throw.
    pub(crate) async fn last_received(&self) -> Result<Option<Timestamp>, StoreError> {
        let at_us = self.limited(sqlx::query_scalar(sql::LAST_RECEIVED).fetch_optional(&self.pool())).await?;
        Ok(at_us.map(timestamp))
    }

    /// The latest health of each selected machine and direction, with the state of the machine now, and changes from
    /// its present baseline.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn latest_health(&self, which: &Selector) -> Result<Vec<Health>, StoreError> {
        let query = sqlx::query_as(sql::LATEST_HEALTH).bind(&which.site).bind(&which.machine);
        let mut rows: Vec<Health> = self.external(query).await?;
        for health in &mut rows {
            health.change_pct = health.present_change_pct();
        }
        Ok(rows)
    }

    /// The newest `limit` rows of the health history since `since`, oldest first. A time up to 1970 means no bound.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn health_history(
        &self,
        which: &Selector,
        since: Timestamp,
        limit: u32,
    ) -> Result<Vec<Health>, StoreError> {
        let since_us = if since <= Timestamp::UNIX_EPOCH { i64::MIN } else { since.as_microsecond() };
        let query = if since_us == i64::MIN && *which == Selector::default() {
            sqlx::query_as(sql::NEWEST_HEALTH).bind(limit)
        } else {
            sqlx::query_as(sql::HEALTH_SINCE).bind(limit).bind(&which.site).bind(&which.machine).bind(since_us)
        };
        let mut rows = self.external(query).await?;
        rows.reverse();
        Ok(rows)
    }

    /// The last event of every open alarm of the selected machines, oldest alarm first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn open_alarms(&self, which: &Selector) -> Result<Vec<Alarm>, StoreError> {
        let query = sqlx::query_as(sql::OPEN_ALARMS).bind(&which.site).bind(&which.machine);
        self.external_alarms(query).await
    }

    /// The newest `limit` alarm events since `since`, oldest first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn alarm_history(
        &self,
        which: &Selector,
        since: Timestamp,
        limit: u32,
    ) -> Result<Vec<Alarm>, StoreError> {
        let of_machine = !which.machine.contains('*');
        let statement = if of_machine { sql::ALARM_HISTORY_OF_MACHINE } else { sql::ALARM_HISTORY };
        let query = sqlx::query_as(statement).bind(&which.site).bind(&which.machine);
        let mut alarms = self.external_alarms(query.bind(since.as_microsecond()).bind(limit)).await?;
        alarms.reverse();
        Ok(alarms)
    }

    /// Up to `limit` messages of the outbox after the row `after` (0 for all), in order.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn outbox_pending(&self, after: i64, limit: u32) -> Result<Vec<OutboxRow>, StoreError> {
        self.rows(sqlx::query_as(sql::MESSAGES).bind(after).bind(limit)).await
    }

    /// Up to `limit` notifications for the webhook with their rows, in order.
    pub(crate) async fn notifications(&self, limit: u32) -> Result<Vec<(i64, String)>, StoreError> {
        self.rows(sqlx::query_as(sql::NOTIFICATIONS).bind(limit)).await
    }

    /// Up to `limit` gaps that are not reported to the monitors yet, oldest first: gaps that are written off, and gaps
    /// of machines for whose backlog the judge does not wait any longer (see [`Self::to_judge`]). Gaps from before the
    /// first contact are left out.
    pub(crate) async fn unreported_gaps(
        &self,
        limit: u32,
        now: Timestamp,
        wait: Duration,
    ) -> Result<Vec<Gap>, StoreError> {
        let (from_us, to_us) = waiting(now, wait);
        self.rows(sqlx::query_as(sql::UNREPORTED_GAPS).bind(limit).bind(from_us).bind(to_us)).await
    }
}

/// A query about one machine, whose site and name are the first two parameters.
pub(super) fn machine_query<'q, Row>(
    statement: &'static str,
    machine: &'q MachineId,
) -> QueryAs<'q, Sqlite, Row, SqliteArguments>
where
    Row: for<'r> FromRow<'r, SqliteRow>,
{
    sqlx::query_as(statement).bind(machine.site.as_str()).bind(machine.machine.as_str())
}

/// The judge waits for a backlog that was opened or last became smaller within this range of times \[µs\]. The upper
/// end is now: a later time was stored before the clock was set back.
fn waiting(now: Timestamp, wait: Duration) -> (i64, i64) {
    let wait_us = i64::try_from(wait.as_micros()).unwrap_or(i64::MAX);
    (now.as_microsecond().saturating_sub(wait_us).saturating_add(1), now.as_microsecond())
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
    use super::*;
    use crate::store::{Settings, Store};

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_store_that_closes_ends_a_slow_external_query() {
        let folder = tempfile::tempdir().unwrap();
        let settings = Settings { path: folder.path().join("points.db"), ballast_mib: 0, ..Settings::default() };
        let store = Store::open(&settings, Timestamp::UNIX_EPOCH).await.unwrap().store;
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
