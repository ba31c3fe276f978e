//! Retention: keeps the database within its bounds, in small transactions.
//!
//! Traces are dropped first, then throws with their estimates, last closed alarms. Each row comes from the machine with
//! the most, so that a flood of one machine removes only its own history; of its throws, those that are judged first,
//! then the oldest pending ones. So each bound holds also if throws arrive faster than they are judged.
//! Age counts only while the clock is trusted: a clock that jumps ten years ahead must not empty the database. The
//! small transactions run between those of received throws.

use std::{
    collections::{BTreeMap, BinaryHeap},
    sync::Arc,
};

use jiff::{SignedDuration, Timestamp};
use sqlx::{Sqlite, SqliteConnection, query::QueryScalar, sqlite::SqliteArguments};

use super::{
    database::Store, disk::DiskLevel, error::StoreError, pace::seldom, settings::MIB, spool::count, statements as sql,
    statistics::Statistics, write::Write,
};

/// Rows dropped in one transaction: some tens of milliseconds of work.
const BATCH: u64 = 1024;
/// Largest number of transactions in one call, which then ends even if throws arrive faster than rows are dropped.
const ROUNDS: usize = 256;
/// Pages returned to the disk in one transaction.
const PAGES: u64 = 512;
/// Size of a page \[bytes\].
const PAGE: u64 = 4096;
/// Largest outbox \[messages\]: ten years of a cabinet's alarms.
const OUTBOX: u64 = 100_000;

/// Drops throws: boots remember up to which number, so that a repeat is not stored again.
const THROWS: &[&str] = &[sql::MARK_PRUNED, sql::DROP_OLD_GAPS, sql::DROP_THROWS, sql::DROP_EMPTY_BOOTS];

/// Rows that are dropped to keep the database within its bounds. The word, after `dropped_`, names a counter in the
/// database.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, strum::AsRefStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum Dropped {
    /// Traces.
    Traces,
    /// Judged throws with their estimates.
    Throws,
    /// Throws that were not judged yet.
    PendingThrows,
    /// Closed alarms with their events.
    Alarms,
    /// Messages of the outbox, the oldest: alarm events that were never published.
    Messages,
    /// Alarm events that the webhook had not accepted, by a trigger.
    Notifications,
    /// Free pages of the file, returned to a disk with little space.
    Pages,
}

/// The statement that selects the machines with the most rows or bytes, which lose rows first.
type Holdings = &'static str;

/// Limits of the time of reception, for the age of traces \[µs\].
#[derive(Debug, Clone, Copy)]
struct Ages {
    before_us: i64,
    now_us: i64,
}

impl Ages {
    /// Earlier times are those of a clock that was not set yet, after a loss of power: 2020.
    const FIRST_US: i64 = 1_577_836_800_000_000;

    /// Selects the aged traces.
    fn query<'q>(self, rows: u64) -> QueryScalar<'q, Sqlite, i64, SqliteArguments> {
        let query = sqlx::query_scalar(sql::AGED_TRACES).bind(rows.cast_signed());
        query.bind(self.before_us).bind(Self::FIRST_US).bind(self.now_us)
    }
}

/// Rows that can be dropped.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Traces(Holdings),
    AgedTraces(Ages),
    Throws(Holdings),
    /// Pending throws: a machine that sends more throws than can be judged loses its oldest ones.
    Pending(Holdings),
    Alarms,
    Messages,
    Pages,
}

impl Kind {
    /// Drops up to this number of rows; returns how many there were.
    async fn drop(self, connection: &mut SqliteConnection, rows: u64) -> sqlx::Result<(Dropped, u64)> {
        let (what, chosen, statements): (_, _, &[&'static str]) = match self {
            Self::Traces(holdings) => {
                let chosen = oldest_of_largest(connection, holdings, sql::OLDEST_TRACES, rows).await?;
                (Dropped::Traces, chosen, &[sql::DROP_TRACES, sql::TRACES_FROM])
            }
            Self::AgedTraces(ages) => {
                (Dropped::Traces, ages.query(rows).fetch_all(&mut *connection).await?, &[sql::DROP_TRACES])
            }
            Self::Throws(holdings) => {
                (Dropped::Throws, oldest_of_largest(connection, holdings, sql::OLDEST_THROWS, rows).await?, THROWS)
            }
            Self::Pending(holdings) => {
                let chosen = oldest_of_largest(connection, holdings, sql::OLDEST_PENDING, rows).await?;
                (Dropped::PendingThrows, chosen, THROWS)
            }
            Self::Alarms => {
                (Dropped::Alarms, oldest(connection, sql::OLDEST_ALARMS, rows, None).await?, &[sql::DROP_ALARMS])
            }
            Self::Messages => {
                (Dropped::Messages, oldest(connection, sql::OLDEST_MESSAGES, rows, None).await?, &[sql::DROP_MESSAGES])
            }
            Self::Pages => {
                sqlx::query("PRAGMA incremental_vacuum(512)").execute(&mut *connection).await?;
                count(connection, "dropped_pages", PAGES.cast_signed()).await?;
                return Ok((Dropped::Pages, PAGES));
            }
        };
        let dropped = chosen.len() as u64;
        if dropped > 0 {
            let list = serde_json::Value::from(chosen.as_slice()).to_string();
            for statement in statements {
                sqlx::query(*statement).bind(&list).execute(&mut *connection).await?;
            }
            count(connection, &format!("dropped_{}", what.as_ref()), dropped.cast_signed()).await?;
        }
        Ok((what, dropped))
    }
}

async fn oldest(
    connection: &mut SqliteConnection,
    choice: &'static str,
    rows: u64,
    argument: Option<i64>,
) -> sqlx::Result<Vec<i64>> {
    let chosen = sqlx::query_scalar(choice).bind(rows.cast_signed());
    let chosen = if let Some(argument) = argument { chosen.bind(argument) } else { chosen };
    chosen.fetch_all(connection).await
}

/// The oldest rows of the machines with the most.
async fn oldest_of_largest(
    connection: &mut SqliteConnection,
    holdings: Holdings,
    choice: &'static str,
    rows: u64,
) -> sqlx::Result<Vec<i64>> {
    let holdings: Vec<Holding> = sqlx::query_as(holdings).bind(rows.cast_signed()).fetch_all(&mut *connection).await?;
    let mut chosen = Vec::new();
    for (machine_row, rows) in shares(holdings, rows) {
        chosen.extend(oldest(connection, choice, rows, Some(machine_row)).await?);
    }
    Ok(chosen)
}

/// Rows or bytes of one machine.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord, sqlx::FromRow)]
struct Holding {
    /// Rows or bytes.
    size: i64,
    machine_row: i64,
    rows: i64,
}

/// Number of rows that each machine loses: each row comes from the machine with the most at that point, so equal
/// machines lose equally, and a small one loses nothing.
fn shares(holdings: Vec<Holding>, rows: u64) -> BTreeMap<i64, u64> {
    let mut largest_first = BinaryHeap::from(holdings);
    let mut shares = BTreeMap::new();
    for _ in 0..rows {
        let Some(Holding { size, machine_row, rows }) = largest_first.pop() else { break };
        *shares.entry(machine_row).or_default() += 1;
        if rows > 1 {
            largest_first.push(Holding { size: size - size / rows, machine_row, rows: rows - 1 });
        }
    }
    shares
}

/// A transaction that drops up to `rows` rows, of a later kind only as far as the earlier ones have too few.
struct DropRows {
    kinds: Vec<Kind>,
    rows: u64,
}

impl Write for DropRows {
    type Output = BTreeMap<Dropped, u64>;

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<Self::Output> {
        let mut done = BTreeMap::new();
        let mut rest = self.rows;
        for kind in &self.kinds {
            let (what, dropped) = kind.drop(connection, rest).await?;
            if dropped > 0 {
                *done.entry(what).or_default() += dropped;
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
    /// Brings the database within its bounds and restores the ballast; returns the number of dropped rows. Called every
    /// second; the work of a call is bounded. `clock_trusted`: whether `now` is correct.
    ///
    /// # Errors
    /// When the database cannot be read or written.
    pub async fn keep_bounds(&self, now: Timestamp, clock_trusted: bool) -> Result<BTreeMap<Dropped, u64>, StoreError> {
        let mut done = BTreeMap::new();
        for _ in 0..ROUNDS {
            let mut round = BTreeMap::new();
            // A bound that cannot be met must not keep the others from being met.
            for drop in self.excess(now, clock_trusted).await? {
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
        // A missing ballast must not hide what was dropped.
        if let Ok(Err(error)) = tokio::task::spawn_blocking(move || disk.restore_ballast()).await {
            seldom!(warn, %error, "no ballast file: recovery from a full disk will be harder");
        }
        Ok(done)
    }

    /// The next rows to drop, the least valuable first; empty within all bounds.
    async fn excess(&self, now: Timestamp, clock_trusted: bool) -> Result<Vec<DropRows>, StoreError> {
        let mut due = Vec::new();
        let settings = &self.settings;
        let figures = sqlx::query_as(sql::FIGURES);
        let figures: Statistics = self.reader.limited(figures.fetch_one(&self.reader.pool())).await?;
        self.disk.note_dropped(&figures.counters());
        let available_bytes = self.disk.free_bytes().unwrap_or(u64::MAX).saturating_add(figures.free_bytes);
        let excess = figures.data_bytes.saturating_sub(settings.max_size_mib * MIB);
        let missing = (settings.low_disk_mib * MIB).saturating_sub(available_bytes);
        if excess > 0 || missing > 0 {
            // The number of rows follows from the mean size of a throw with its trace.
            let each = (figures.data_bytes / figures.traces.max(1)).max(1);
            let rows = (excess.max(missing) / each + 1).min(BATCH);
            let mut kinds = vec![Kind::Traces(sql::MOST_TRACE_BYTES)];
            // A disk that others fill costs traces only.
            if excess > 0 {
                kinds.extend([Kind::Throws(sql::MOST_THROW_BYTES), Kind::Pending(sql::MOST_THROW_BYTES), Kind::Alarms]);
            }
            due.push(DropRows { kinds, rows });
        }
        let counts = [
            (
                figures.traces,
                settings.max_traces,
                vec![Kind::Traces(sql::MOST_TRACES), Kind::Pending(sql::MOST_TRACES)],
            ),
            (
                figures.throws,
                settings.max_throws,
                vec![Kind::Throws(sql::MOST_THROWS), Kind::Pending(sql::MOST_THROWS)],
            ),
            (figures.closed_alarms, settings.max_alarms, vec![Kind::Alarms]),
            (figures.outbox, OUTBOX, vec![Kind::Messages]),
        ];
        for (count, most, kinds) in counts {
            let rows = count.saturating_sub(most).min(BATCH);
            if rows > 0 {
                due.push(DropRows { kinds, rows });
            }
        }
        if clock_trusted {
            let before = now - SignedDuration::from_hours(24 * i64::from(settings.trace_days));
            let ages = Ages { before_us: before.as_microsecond(), now_us: now.as_microsecond() };
            if self.reader.limited(ages.query(1).fetch_optional(&self.reader.pool())).await?.is_some() {
                due.push(DropRows { kinds: vec![Kind::AgedTraces(ages)], rows: BATCH });
            }
        }
        let disk_low = matches!(self.disk.level(), DiskLevel::Low | DiskLevel::Full);
        if disk_low && figures.free_bytes > PAGES * PAGE {
            due.push(DropRows { kinds: vec![Kind::Pages], rows: PAGES });
        }
        Ok(due)
    }
}
