//! The reading side: short queries on two read-only connections.

use std::{
    future::Future,
    path::Path,
    sync::{Arc, PoisonError, RwLock},
    time::Duration,
};

use jiff::Timestamp;
use sqlx::{
    Sqlite, SqlitePool,
    query::QueryAs,
    sqlite::{SqliteArguments, SqlitePoolOptions, SqliteRow},
};
use tokio::time::{Instant, timeout};
use tokio_util::sync::CancellationToken;

use super::{
    codec::{self, Channel, UnreadableTrace},
    error::{StoreError, is_corrupt},
    open,
    spool::{GapKind, GapRow, ThrowRow},
    statements as sql,
};
use crate::throw::{Direction, MachineId, Name, Throw, ThrowRef, Trace};

/// Connections for the daemon's own reading. They never wait for the writer, nor it for them.
const CONNECTIONS: u32 = 2;
/// Connections for questions from outside, of which no more are answered at once.
const QUESTIONS: u32 = 3;
/// Steps of SQLite's machine between two looks at the clock: some milliseconds.
const STEPS: i32 = 100_000;

/// Which machines a query is about; `None` means all.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Selector {
    /// Only this site.
    pub site: Option<Name>,
    /// Only machines of this name.
    pub machine: Option<Name>,
}

impl Selector {
    fn site(&self) -> Option<&str> {
        self.site.as_ref().map(Name::as_str)
    }

    fn machine(&self) -> Option<&str> {
        self.machine.as_ref().map(Name::as_str)
    }
}

/// A throw as it was spooled.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredThrow {
    /// Its row.
    pub row: ThrowRow,
    /// Who made it.
    pub machine: MachineId,
    /// Its identity within the machine.
    pub id: ThrowRef,
    /// Wall time of its first sample, as the logger said.
    pub started_at: Timestamp,
    /// When it arrived.
    pub received_at: Timestamp,
    /// The throw; or why its trace cannot be read.
    pub throw: Result<Throw, UnreadableTrace>,
}

/// One row of the health history.
#[derive(Debug, Clone, PartialEq)]
pub struct HealthRow {
    /// Which machine.
    pub machine: MachineId,
    /// Which throw.
    pub throw: ThrowRef,
    /// Wall time of its first sample.
    pub started_at: Timestamp,
    /// Its direction, where known.
    pub direction: Option<Direction>,
    /// [`GOOD`](crate::wire::GOOD), or the code of why it was not evaluated.
    pub quality: String,
    /// The same as a sentence.
    pub detail: Option<String>,
    /// b0 \[rad s⁻² A⁻¹\], a1 \[s⁻¹\], a0 \[s⁻²\].
    pub coefficients: Option<[f64; 3]>,
    /// Their standard deviations.
    pub sd: Option<[f64; 3]>,
    /// Their change from the baseline \[%\].
    pub change_pct: Option<[f64; 3]>,
    /// Fit `R²_T` \[%\].
    pub fit_pct: Option<f64>,
    /// Duration \[s\].
    pub duration_s: Option<f64>,
    /// Peak current \[A\].
    pub peak_current_a: Option<f64>,
    /// Mean current \[A\].
    pub mean_current_a: Option<f64>,
    /// Throws in this direction's baseline so far, of how many.
    pub baseline: Option<(u64, u64)>,
    /// Good throws of this direction since its baseline was complete.
    pub throws_since_baseline: u64,
}

/// One alarm event as it was published.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AlarmRow {
    /// Which machine.
    pub machine: MachineId,
    /// The alarm's identity.
    pub alarm_id: String,
    /// The event's number within the alarm.
    pub event_no: u32,
    /// The message, JSON.
    pub payload: String,
}

/// Throws that are missing, from the first to the last number, both included.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Gap {
    /// Its row.
    pub row: GapRow,
    /// Which machine.
    pub machine: MachineId,
    /// Which start of its logger.
    pub boot_id: String,
    /// First missing number.
    pub first_no: u64,
    /// Last missing number.
    pub last_no: u64,
    /// Why.
    pub kind: GapKind,
    /// When it was noticed.
    pub detected_at: Timestamp,
}

/// A message that waits to be published.
#[derive(Debug, Clone, PartialEq, Eq, sqlx::FromRow)]
pub struct OutboxRow {
    /// Its number, in the order of publication.
    #[sqlx(rename = "outbox_row")]
    pub row: i64,
    /// Where it goes.
    pub key: String,
    /// What it says.
    pub payload: Vec<u8>,
}

/// A message that could not be taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Quarantined {
    /// When it arrived.
    pub received_at: Timestamp,
    /// On which key.
    pub key: String,
    /// What is wrong with it.
    pub reason: String,
    /// Its whole length \[bytes\].
    pub payload_bytes: u64,
    /// Its beginning.
    pub payload_start: Vec<u8>,
}

/// Reads the database. Cheap to clone; every query has a time limit, so that none keeps an old state alive.
#[derive(Debug, Clone)]
pub struct Reader {
    /// Replaced when the database moves to another file.
    pools: Arc<RwLock<Pools>>,
    /// Cancelled when a query finds the content of the file broken.
    broken: CancellationToken,
}

/// Questions from outside have connections of their own: whoever asks much must not hold the pipeline up.
#[derive(Debug, Clone)]
struct Pools {
    own: SqlitePool,
    questions: SqlitePool,
}

impl Reader {
    /// Longest time of one query. An old state that is being read cannot be overwritten: the log grows meanwhile.
    pub const TIME_LIMIT: Duration = Duration::from_secs(10);

    /// Reads a database that another process may be writing.
    ///
    /// # Errors
    /// When there is no database, or it cannot be read.
    pub async fn open(path: &Path) -> Result<Self, StoreError> {
        let pools = Pools::connect(path)
            .await
            .map_err(|source| StoreError::Open { path: path.to_owned(), source: Box::new(source) })?;
        Ok(Self { pools: Arc::new(RwLock::new(pools)), broken: CancellationToken::new() })
    }

    pub(super) async fn close(&self) {
        let Pools { own, questions } = self.pools();
        own.close().await;
        questions.close().await;
    }

    /// Reads the file that `path` leads to now. Queries that run keep the old one to their end: it is not closed but
    /// dropped, so that none of them fails.
    pub(super) async fn reopen(&self, path: &Path) -> sqlx::Result<()> {
        let pools = Pools::connect(path).await?;
        *self.pools.write().unwrap_or_else(PoisonError::into_inner) = pools;
        Ok(())
    }

    pub(super) async fn limited<T>(&self, query: impl Future<Output = sqlx::Result<T>>) -> Result<T, StoreError> {
        let answer = timeout(Self::TIME_LIMIT, query).await.map_err(|_| StoreError::ReadTimeout)?;
        if let Err(error) = &answer
            && is_corrupt(error)
            && !self.broken.is_cancelled()
        {
            tracing::error!(%error, "a query found the database broken: the next start sets the file aside");
            self.broken.cancel();
        }
        answer.map_err(StoreError::read)
    }

    /// Whether a query has found the content of the file broken.
    pub(super) fn is_broken(&self) -> bool {
        self.broken.is_cancelled()
    }

    /// Resolves when a query finds the content of the file broken.
    pub(super) async fn breaks(&self) {
        self.broken.cancelled().await;
    }

    pub(super) fn pool(&self) -> SqlitePool {
        self.pools().own
    }

    fn pools(&self) -> Pools {
        self.pools.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    async fn rows<'q, Row, T>(
        &self,
        query: QueryAs<'q, Sqlite, Row, SqliteArguments>,
        read: impl Fn(Row) -> sqlx::Result<T>,
    ) -> Result<Vec<T>, StoreError>
    where
        Row: Send + Unpin + for<'r> sqlx::FromRow<'r, SqliteRow>,
    {
        let rows = self.limited(query.fetch_all(&self.pool())).await?;
        rows.into_iter().map(read).collect::<sqlx::Result<_>>().map_err(StoreError::read)
    }

    /// The rows of a question from outside. SQLite itself ends a query that takes too long: one that nobody waits for any
    /// more would go on and keep its connection.
    pub(super) async fn asked<'q, Row, T>(
        &self,
        query: QueryAs<'q, Sqlite, Row, SqliteArguments>,
        read: impl Fn(Row) -> sqlx::Result<T>,
    ) -> Result<Vec<T>, StoreError>
    where
        Row: Send + Unpin + for<'r> sqlx::FromRow<'r, SqliteRow>,
    {
        let answer = async {
            let mut connection = self.pools().questions.acquire().await?;
            let end = Instant::now() + Self::TIME_LIMIT;
            connection.lock_handle().await?.set_progress_handler(STEPS, move || Instant::now() < end);
            query.fetch_all(&mut *connection).await
        };
        let rows = self.limited(answer).await?;
        rows.into_iter().map(read).collect::<sqlx::Result<_>>().map_err(StoreError::read)
    }

    /// The number that a question from outside is answered with.
    pub(super) async fn asked_figure(&self, query: &'static str) -> Result<u64, StoreError> {
        let figures = self.asked(sqlx::query_as(query), |(figure,): (i64,)| Ok(figure.cast_unsigned())).await?;
        figures.into_iter().next().ok_or_else(|| StoreError::read(sqlx::Error::RowNotFound))
    }

    /// Up to `limit` throws after `after` that wait to be judged, in the order of arrival.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn pending(&self, after: ThrowRow, limit: u32) -> Result<Vec<StoredThrow>, StoreError> {
        self.rows(sqlx::query_as(sql::WAITING).bind(after.0).bind(limit), ThrowColumns::read).await
    }

    /// Up to `limit` throws after `after`, judged or not, in the order of arrival.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn throws(&self, after: ThrowRow, limit: u32) -> Result<Vec<StoredThrow>, StoreError> {
        self.rows(sqlx::query_as(sql::THROWS).bind(after.0).bind(limit), ThrowColumns::read).await
    }

    /// The monitor of every machine that has one, as JSON.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn monitors(&self) -> Result<Vec<(MachineId, String)>, StoreError> {
        let read = |(site, machine, json): (String, String, String)| Ok((machine_id(&site, &machine)?, json));
        self.rows(sqlx::query_as(sql::MONITORS), read).await
    }

    /// Every machine that was ever heard.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn machines(&self) -> Result<Vec<MachineId>, StoreError> {
        let read = |(site, machine): (String, String)| machine_id(&site, &machine);
        self.rows(sqlx::query_as(sql::MACHINES), read).await
    }

    /// When the newest throw arrived.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn last_heard(&self) -> Result<Option<Timestamp>, StoreError> {
        let at_us = self.limited(sqlx::query_scalar(sql::LAST_HEARD).fetch_optional(&self.pool())).await?;
        Ok(at_us.map(timestamp))
    }

    /// The latest health of each selected machine and direction.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn latest_health(&self, which: &Selector) -> Result<Vec<HealthRow>, StoreError> {
        let query = sqlx::query_as(sql::LATEST_HEALTH).bind(which.site()).bind(which.machine());
        self.asked(query, HealthColumns::read).await
    }

    /// The newest `limit` rows of the health history that started at `since` or later, oldest first. 1970 and before
    /// mean: whenever.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn health_history(
        &self,
        which: &Selector,
        since: Timestamp,
        limit: u32,
    ) -> Result<Vec<HealthRow>, StoreError> {
        let since_us = if since <= Timestamp::UNIX_EPOCH { i64::MIN } else { since.as_microsecond() };
        let query = if since_us == i64::MIN && *which == Selector::default() {
            sqlx::query_as(sql::NEWEST_HEALTH).bind(limit)
        } else {
            sqlx::query_as(sql::HEALTH_SINCE).bind(limit).bind(which.site()).bind(which.machine()).bind(since_us)
        };
        let mut rows = self.asked(query, HealthColumns::read).await?;
        rows.reverse();
        Ok(rows)
    }

    /// The last event of every open alarm of the selected machines, oldest alarm first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn open_alarms(&self, which: &Selector) -> Result<Vec<AlarmRow>, StoreError> {
        let query = sqlx::query_as(sql::OPEN_ALARMS).bind(which.site()).bind(which.machine());
        self.asked(query, AlarmColumns::read).await
    }

    /// The newest `limit` alarm events at `since` or later, oldest first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn alarm_history(
        &self,
        which: &Selector,
        since: Timestamp,
        limit: u32,
    ) -> Result<Vec<AlarmRow>, StoreError> {
        let query = sqlx::query_as(sql::ALARM_HISTORY).bind(which.site()).bind(which.machine());
        let mut rows = self.asked(query.bind(since.as_microsecond()).bind(limit), AlarmColumns::read).await?;
        rows.reverse();
        Ok(rows)
    }

    /// Up to `limit` messages to publish after the message `after` (0: from the first), in order.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn outbox_pending(&self, after: i64, limit: u32) -> Result<Vec<OutboxRow>, StoreError> {
        self.rows(sqlx::query_as(sql::MESSAGES).bind(after).bind(limit), Ok).await
    }

    /// Up to `limit` open gaps, oldest first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn open_gaps(&self, limit: u32) -> Result<Vec<Gap>, StoreError> {
        self.rows(sqlx::query_as(sql::GAPS).bind(limit), GapColumns::read).await
    }

    /// Up to `limit` open gaps that the monitors do not know of, oldest first; without those from before the first
    /// contact, which nobody missed.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn untold_gaps(&self, limit: u32) -> Result<Vec<Gap>, StoreError> {
        self.rows(sqlx::query_as(sql::UNTOLD_GAPS).bind(limit), GapColumns::read).await
    }

    /// The newest `limit` messages in quarantine, newest first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn quarantined(&self, limit: u32) -> Result<Vec<Quarantined>, StoreError> {
        let read = |(at_us, key, reason, bytes, payload_start): (i64, String, String, i64, Vec<u8>)| {
            let payload_bytes = bytes.cast_unsigned();
            Ok(Quarantined { received_at: timestamp(at_us), key, reason, payload_bytes, payload_start })
        };
        self.rows(sqlx::query_as(sql::QUARANTINE).bind(limit), read).await
    }
}

impl Pools {
    async fn connect(path: &Path) -> sqlx::Result<Self> {
        let options = SqlitePoolOptions::new().max_lifetime(None).idle_timeout(None);
        let questions = options.clone().max_connections(QUESTIONS).connect_lazy_with(open::reading(path));
        let own = options.max_connections(CONNECTIONS).connect_with(open::reading(path)).await?;
        Ok(Self { own, questions })
    }
}

fn decode_error(error: impl std::error::Error + Send + Sync + 'static) -> sqlx::Error {
    sqlx::Error::Decode(Box::new(error))
}

fn machine_id(site: &str, machine: &str) -> sqlx::Result<MachineId> {
    MachineId::new(site, machine).map_err(decode_error)
}

/// The nearest time that there is: one odd row must not hide all others.
fn timestamp(at_us: i64) -> Timestamp {
    let nearest = if at_us < 0 { Timestamp::MIN } else { Timestamp::MAX };
    Timestamp::from_microsecond(at_us).unwrap_or(nearest)
}

fn three(values: [Option<f64>; 3]) -> Option<[f64; 3]> {
    let [first, second, third] = values;
    Some([first?, second?, third?])
}

#[derive(sqlx::FromRow)]
pub(super) struct ThrowColumns {
    throw_row: i64,
    site: String,
    machine: String,
    boot_id: String,
    throw_no: i64,
    started_at_us: i64,
    received_at_us: i64,
    direction: Option<String>,
    sample_rate_hz: f64,
    samples: i64,
    temperature_c: Option<f64>,
    supply_v: Option<f64>,
    anti_alias_hz: Option<f64>,
    current_codec: Option<String>,
    current_data: Option<Vec<u8>>,
    position_codec: Option<String>,
    position_data: Option<Vec<u8>>,
    crc32: Option<u32>,
}

impl ThrowColumns {
    fn trace(&mut self) -> Result<Trace, UnreadableTrace> {
        let channel = |codec: &mut Option<String>, data: &mut Option<Vec<u8>>| {
            Some(Channel { codec: codec.take()?, data: data.take()? })
        };
        let current = channel(&mut self.current_codec, &mut self.current_data).ok_or(UnreadableTrace::Dropped)?;
        let position = channel(&mut self.position_codec, &mut self.position_data).ok_or(UnreadableTrace::Dropped)?;
        let samples = usize::try_from(self.samples).map_err(|error| UnreadableTrace::Damaged(error.to_string()))?;
        codec::trace(self.sample_rate_hz, samples, &current, &position, self.crc32.unwrap_or_default())
    }

    pub(super) fn read(mut self) -> sqlx::Result<StoredThrow> {
        let machine = machine_id(&self.site, &self.machine)?;
        let started_at = timestamp(self.started_at_us);
        let received_at = timestamp(self.received_at_us);
        let id = ThrowRef { boot_id: std::mem::take(&mut self.boot_id), throw_no: self.throw_no.cast_unsigned() };
        let throw = self.trace().map(|trace| Throw {
            id: id.clone(),
            started_at,
            direction: self.direction.as_deref().and_then(Direction::from_word),
            trace,
            temperature_c: self.temperature_c,
            supply_v: self.supply_v,
            anti_alias_hz: self.anti_alias_hz,
        });
        Ok(StoredThrow { row: ThrowRow(self.throw_row), machine, id, started_at, received_at, throw })
    }
}

#[derive(sqlx::FromRow)]
pub(super) struct HealthColumns {
    site: String,
    machine: String,
    boot_id: String,
    throw_no: i64,
    started_at_us: i64,
    direction: Option<String>,
    quality: String,
    detail: Option<String>,
    b0: Option<f64>,
    a1: Option<f64>,
    a0: Option<f64>,
    b0_sd: Option<f64>,
    a1_sd: Option<f64>,
    a0_sd: Option<f64>,
    b0_pct: Option<f64>,
    a1_pct: Option<f64>,
    a0_pct: Option<f64>,
    fit_pct: Option<f64>,
    duration_s: Option<f64>,
    peak_current_a: Option<f64>,
    mean_current_a: Option<f64>,
    baseline_throws: Option<i64>,
    baseline_needed: Option<i64>,
    throws_since_baseline: i64,
}

impl HealthColumns {
    pub(super) fn read(self) -> sqlx::Result<HealthRow> {
        let baseline = self.baseline_throws.zip(self.baseline_needed);
        Ok(HealthRow {
            machine: machine_id(&self.site, &self.machine)?,
            throw: ThrowRef { boot_id: self.boot_id, throw_no: self.throw_no.cast_unsigned() },
            started_at: timestamp(self.started_at_us),
            direction: self.direction.as_deref().and_then(Direction::from_word),
            quality: self.quality,
            detail: self.detail,
            coefficients: three([self.b0, self.a1, self.a0]),
            sd: three([self.b0_sd, self.a1_sd, self.a0_sd]),
            change_pct: three([self.b0_pct, self.a1_pct, self.a0_pct]),
            fit_pct: self.fit_pct,
            duration_s: self.duration_s,
            peak_current_a: self.peak_current_a,
            mean_current_a: self.mean_current_a,
            baseline: baseline.map(|(so_far, needed)| (so_far.cast_unsigned(), needed.cast_unsigned())),
            throws_since_baseline: self.throws_since_baseline.cast_unsigned(),
        })
    }
}

#[derive(sqlx::FromRow)]
pub(super) struct AlarmColumns {
    site: String,
    machine: String,
    alarm_id: String,
    event_no: u32,
    payload: String,
}

impl AlarmColumns {
    pub(super) fn read(self) -> sqlx::Result<AlarmRow> {
        let machine = machine_id(&self.site, &self.machine)?;
        Ok(AlarmRow { machine, alarm_id: self.alarm_id, event_no: self.event_no, payload: self.payload })
    }
}

#[derive(sqlx::FromRow)]
struct GapColumns {
    gap_row: i64,
    site: String,
    machine: String,
    boot_id: String,
    first_no: i64,
    last_no: i64,
    kind: String,
    detected_at_us: i64,
}

impl GapColumns {
    fn read(self) -> sqlx::Result<Gap> {
        Ok(Gap {
            row: GapRow(self.gap_row),
            machine: machine_id(&self.site, &self.machine)?,
            boot_id: self.boot_id,
            first_no: self.first_no.cast_unsigned(),
            last_no: self.last_no.cast_unsigned(),
            kind: GapKind::ALL.into_iter().find(|kind| kind.as_str() == self.kind).unwrap_or(GapKind::Missed),
            detected_at: timestamp(self.detected_at_us),
        })
    }
}
