//! Retention: keeps the database within its bounds, in small transactions, which run between those of received throws.
//!
//! Traces are dropped first, then throws with their estimates, last closed alarms. Each dropped trace or throw is taken
//! from the machine that has the most rows or bytes, so that a flood from one machine removes only its own history. Its
//! judged throws are dropped first, then its oldest pending throws: so each bound holds even if throws arrive faster
//! than they are judged.
//!
//! Age counts only while the clock is trusted: a clock that jumps ten years ahead must not empty the database.

use std::{
    collections::{BTreeMap, BinaryHeap},
    sync::Arc,
};

use jiff::{SignedDuration, Timestamp};
use sqlx::{AssertSqlSafe, SqliteConnection, query::QueryScalar};

use super::{spool::count, write::Write};
use crate::store::{
    database::Store,
    dropped::Dropped,
    error::StoreError,
    files::disk::DiskLevel,
    rate_limit::seldom,
    settings::{MIB, PAGE_BYTES},
    statements as sql,
    statistics::Statistics,
};

/// Largest number of rows dropped in one transaction: some tens of milliseconds of work.
const BATCH: u64 = 1024;
/// Largest number of transactions in one call of [`Store::keep_bounds`]. With it the call ends even if throws arrive
/// faster than rows are dropped.
const ROUNDS: usize = 256;
/// Number of pages returned to the disk in one transaction.
const PAGES: u64 = 512;
/// Largest outbox \[messages\]: ten years of a cabinet's alarms.
const OUTBOX: u64 = 100_000;

/// Statements that drop throws. Each boot keeps the highest dropped number, so that a repeated throw is not stored
/// again.
const DROP_THROWS: &[&str] = &[sql::MARK_PRUNED, sql::DROP_OLD_GAPS, sql::DROP_THROWS, sql::DROP_EMPTY_BOOTS];

/// Rows that can be dropped.
struct DroppableRows {
    what: Dropped,
    /// Selects the machines with the most rows or bytes, which lose rows first; `None` to drop the oldest rows of any
    /// machine.
    machines: Option<&'static str>,
    /// Selects the oldest ?1 rows, of the machine ?2 if there are `machines`.
    oldest: &'static str,
    /// Further parameters of `oldest`.
    arguments: Vec<i64>,
    /// Statements that drop the rows of the JSON list ?1.
    drop: &'static [&'static str],
}

impl DroppableRows {
    fn new(what: Dropped, machines: Option<&'static str>, oldest: &'static str, drop: &'static [&'static str]) -> Self {
        Self { what, machines, oldest, arguments: Vec::new(), drop }
    }

    fn traces(machines: &'static str) -> Self {
        Self::new(Dropped::Traces, Some(machines), sql::OLDEST_TRACES, &[sql::DROP_TRACES, sql::TRACES_FROM])
    }

    /// Traces that were received before a time \[µs\].
    fn aged_traces(before_us: i64, now_us: i64) -> Self {
        /// The start of 2020. Earlier times come from a clock that was not set yet after a loss of power.
        const FIRST_US: i64 = 1_577_836_800_000_000;
        let arguments = vec![before_us, FIRST_US, now_us];
        Self { arguments, ..Self::new(Dropped::Traces, None, sql::AGED_TRACES, &[sql::DROP_TRACES]) }
    }

    fn throws(machines: &'static str) -> Self {
        Self::new(Dropped::Throws, Some(machines), sql::OLDEST_THROWS, DROP_THROWS)
    }

    /// A machine that sends more throws than can be judged loses its oldest pending ones.
    fn pending(machines: &'static str) -> Self {
        Self::new(Dropped::PendingThrows, Some(machines), sql::OLDEST_PENDING, DROP_THROWS)
    }

    fn alarms() -> Self {
        Self::new(Dropped::Alarms, None, sql::OLDEST_ALARMS, &[sql::DROP_ALARMS])
    }

    /// Drops up to `rows` rows; returns the number of dropped rows.
    async fn drop(&self, connection: &mut SqliteConnection, rows: u64) -> sqlx::Result<u64> {
        let chosen = self.choose(connection, rows).await?;
        if chosen.is_empty() {
            return Ok(0);
        }
        let list = serde_json::Value::from(chosen.as_slice()).to_string();
        for statement in self.drop {
            sqlx::query(*statement).bind(&list).execute(&mut *connection).await?;
        }
        let dropped = chosen.len() as u64;
        count(connection, &self.what.counter(), dropped.cast_signed()).await?;
        Ok(dropped)
    }

    /// Up to `rows` row numbers.
    async fn choose(&self, connection: &mut SqliteConnection, rows: u64) -> sqlx::Result<Vec<i64>> {
        let limit = rows.cast_signed();
        let Some(machines) = self.machines else {
            let oldest = sqlx::query_scalar(self.oldest).bind(limit);
            return self.arguments.iter().fold(oldest, QueryScalar::bind).fetch_all(connection).await;
        };
        let machines: Vec<Usage> = sqlx::query_as(machines).bind(limit).fetch_all(&mut *connection).await?;
        let mut chosen = Vec::new();
        for (machine_row, rows) in shares(machines, rows) {
            let oldest = sqlx::query_scalar::<_, i64>(self.oldest).bind(rows.cast_signed()).bind(machine_row);
            chosen.extend(oldest.fetch_all(&mut *connection).await?);
        }
        Ok(chosen)
    }
}

/// Number of rows or bytes that one machine has in the database.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord, sqlx::FromRow)]
struct Usage {
    /// Rows or bytes, as the statement selects. First, so that the machines are ordered by it.
    size: i64,
    machine_row: i64,
    rows: i64,
}

/// Number of rows that each machine loses. Each row is taken from the machine that has the most at that point, so equal
/// machines lose equally, and a small machine loses nothing.
fn shares(machines: Vec<Usage>, rows: u64) -> BTreeMap<i64, u64> {
    let mut largest_first = BinaryHeap::from(machines);
    let mut shares = BTreeMap::new();
    for _ in 0..rows {
        let Some(Usage { size, machine_row, rows }) = largest_first.pop() else { break };
        *shares.entry(machine_row).or_default() += 1;
        if rows > 1 {
            largest_first.push(Usage { size: size - size / rows, machine_row, rows: rows - 1 });
        }
    }
    shares
}

/// A transaction of retention.
enum Retention {
    /// Drops up to this number of rows. Rows of a later kind are dropped only if the earlier kinds have too few.
    Rows(Vec<DroppableRows>, u64),
    /// Returns up to [`PAGES`] unused pages of the file to the disk.
    Pages,
}

impl Write for Retention {
    type Output = BTreeMap<Dropped, u64>;

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<Self::Output> {
        let mut done = BTreeMap::new();
        let &Self::Rows(ref kinds, mut rest) = self else {
            let unused = || sqlx::query_scalar::<_, i64>("PRAGMA freelist_count");
            let before = unused().fetch_one(&mut *connection).await?;
            let vacuum = AssertSqlSafe(format!("PRAGMA incremental_vacuum({PAGES})"));
            sqlx::query(vacuum).execute(&mut *connection).await?;
            let returned = before - unused().fetch_one(&mut *connection).await?;
            // A database that another program has created or copied may have no auto-vacuum.
            if returned > 0 {
                count(connection, &Dropped::Pages.counter(), returned).await?;
                done.insert(Dropped::Pages, returned.cast_unsigned());
            }
            return Ok(done);
        };
        for kind in kinds {
            let dropped = kind.drop(connection, rest).await?;
            if dropped > 0 {
                *done.entry(kind.what).or_default() += dropped;
            }
            rest = rest.saturating_sub(dropped);
            if rest == 0 {
                break;
            }
        }
        Ok(done)
    }
}

impl Store {
    /// Brings the database within its bounds and restores the ballast; returns the numbers of dropped rows. Called
    /// every second; the number of rows dropped by a call is limited. `trusted_now` is `None` while the clock may be
    /// wrong: then no row is too old.
    ///
    /// # Errors
    /// When the database cannot be read or written.
    pub async fn keep_bounds(&self, trusted_now: Option<Timestamp>) -> Result<BTreeMap<Dropped, u64>, StoreError> {
        let mut done = BTreeMap::new();
        for _ in 0..ROUNDS {
            let mut round = BTreeMap::new();
            // If a bound cannot be met, the next one is tried.
            for drop in self.excess(trusted_now).await? {
                round = self.writer.write(drop).await?;
                if !round.is_empty() {
                    break;
                }
            }
            if round.is_empty() {
                break;
            }
            for (what, rows) in round {
                *done.entry(what).or_default() += rows;
            }
        }
        let disk = Arc::clone(&self.disk);
        // An error is only logged: the caller still needs the numbers of dropped rows.
        if let Ok(Err(error)) = tokio::task::spawn_blocking(move || disk.restore_ballast()).await {
            seldom!(warn, %error, "no ballast file: recovery from a full disk will be harder");
        }
        Ok(done)
    }

    /// The next rows to drop, the least valuable first; empty if the database is within all bounds.
    async fn excess(&self, trusted_now: Option<Timestamp>) -> Result<Vec<Retention>, StoreError> {
        let mut due = Vec::new();
        let settings = &self.settings;
        let figures = sqlx::query_as(sql::FIGURES);
        let figures: Statistics = self.reader.limited(figures.fetch_one(&self.reader.pool())).await?;
        self.drop_counts.note(&figures.counters());
        let available_bytes = self.disk.free_bytes().unwrap_or(u64::MAX).saturating_add(figures.free_bytes);
        let excess = figures.data_bytes.saturating_sub(settings.max_size_mib * MIB);
        let missing = (settings.low_disk_mib * MIB).saturating_sub(available_bytes);
        if excess > 0 || missing > 0 {
            // The number of rows is estimated from the mean size of a throw with its trace, or without one if none is left.
            let rows = if figures.traces > 0 { figures.traces } else { figures.throws };
            let each = (figures.data_bytes / rows.max(1)).max(1);
            let rows = (excess.max(missing) / each + 1).min(BATCH);
            let mut kinds = vec![DroppableRows::traces(sql::MOST_TRACE_BYTES)];
            // If other programs fill the disk, only traces are dropped.
            if excess > 0 {
                kinds.extend([
                    DroppableRows::throws(sql::MOST_THROW_BYTES),
                    DroppableRows::pending(sql::MOST_THROW_BYTES),
                    DroppableRows::alarms(),
                ]);
            }
            due.push(Retention::Rows(kinds, rows));
        }
        let messages = DroppableRows::new(Dropped::Messages, None, sql::OLDEST_MESSAGES, &[sql::DROP_MESSAGES]);
        let counts = [
            (
                figures.traces,
                settings.max_traces,
                vec![DroppableRows::traces(sql::MOST_TRACES), DroppableRows::pending(sql::MOST_TRACES)],
            ),
            (
                figures.throws,
                settings.max_throws,
                vec![DroppableRows::throws(sql::MOST_THROWS), DroppableRows::pending(sql::MOST_THROWS)],
            ),
            (figures.closed_alarms, settings.max_alarms, vec![DroppableRows::alarms()]),
            (figures.outbox, OUTBOX, vec![messages]),
        ];
        for (count, most, kinds) in counts {
            let rows = count.saturating_sub(most).min(BATCH);
            if rows > 0 {
                due.push(Retention::Rows(kinds, rows));
            }
        }
        if let Some(now) = trusted_now {
            let before = now - SignedDuration::from_hours(24 * i64::from(settings.trace_days));
            let kinds = vec![DroppableRows::aged_traces(before.as_microsecond(), now.as_microsecond())];
            due.push(Retention::Rows(kinds, BATCH));
        }
        let disk_low = matches!(self.disk.level(), DiskLevel::Low | DiskLevel::Full);
        if disk_low && figures.free_bytes > PAGES * PAGE_BYTES as u64 {
            due.push(Retention::Pages);
        }
        Ok(due)
    }
}
