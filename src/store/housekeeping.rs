//! Retention: keeps the database within its bounds, in small transactions.
//!
//! Traces are dropped first, then throws with their estimates, last closed alarms. Each row comes from the machine with
//! the most, so that a flood of one machine removes only its own history; of its throws, those that are judged first,
//! then the oldest pending ones. So each bound holds also if throws arrive faster than they are judged.
//! Age counts only while the clock is trusted: a clock that jumps ten years ahead must not empty the database. The
//! small transactions run between those of received throws.

use std::collections::{BTreeMap, BinaryHeap};

use jiff::{SignedDuration, Timestamp};
use sqlx::SqliteConnection;

use super::{
    database::Store, disk::DiskLevel, error::StoreError, settings::MIB, spool::count, statements as sql, write::Write,
};

/// Rows dropped in one transaction: some tens of milliseconds of work.
const BATCH: u64 = 1024;
/// Largest number of transactions in one call, which then ends even if throws arrive faster than rows are dropped.
const ROUNDS: usize = 256;
/// Pages returned to the disk in one transaction.
const PAGES: u64 = 512;
/// Largest outbox \[messages\]: ten years of a cabinet's alarms.
const OUTBOX: u64 = 100_000;

/// Drops throws: boots remember up to which number, so that a repeat is not stored again.
const THROWS: &[&str] = &[sql::MARK_PRUNED, sql::DROP_OLD_GAPS, sql::DROP_THROWS, sql::DROP_EMPTY_BOOTS];

/// Rows dropped by a call of [`Store::run_housekeeping`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Housekeeping {
    /// Dropped traces.
    pub traces: u64,
    /// Dropped throws with their estimates.
    pub throws: u64,
    /// Throws dropped before they were judged.
    pub pending: u64,
    /// Dropped closed alarms with their events.
    pub alarms: u64,
    /// Dropped messages of the outbox, the oldest.
    pub messages: u64,
    /// Pages returned to a disk with little space.
    pub pages: u64,
}

/// The bounded quantity, by which machines are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bound {
    Traces,
    Throws,
    /// Bytes, of machines that have traces.
    TraceBytes,
    /// Bytes, of all machines.
    Bytes,
}

impl Bound {
    /// Selects the machines with the most.
    const fn holdings(self) -> &'static str {
        match self {
            Self::Traces => sql::TRACE_HOLDINGS,
            Self::Throws => sql::THROW_HOLDINGS,
            Self::TraceBytes => sql::TRACE_BYTE_HOLDINGS,
            Self::Bytes => sql::THROW_BYTE_HOLDINGS,
        }
    }
}

/// Rows that can be dropped.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Traces(Bound),
    TracesBefore(i64),
    Throws(Bound),
    /// Pending throws: a machine that sends more throws than can be judged loses its oldest ones.
    Pending(Bound),
    Alarms,
    Messages,
    Pages,
}

impl Kind {
    /// Selects the rows to drop.
    async fn choose(self, connection: &mut SqliteConnection, rows: u64) -> sqlx::Result<Vec<i64>> {
        match self {
            Self::Traces(bound) => oldest_of_largest(connection, bound, sql::OLDEST_TRACES, rows).await,
            Self::Throws(bound) => oldest_of_largest(connection, bound, sql::OLDEST_THROWS, rows).await,
            Self::Pending(bound) => oldest_of_largest(connection, bound, sql::OLDEST_PENDING, rows).await,
            Self::TracesBefore(at_us) => oldest(connection, sql::AGED_TRACES, rows, Some(at_us)).await,
            Self::Alarms => oldest(connection, sql::OLDEST_ALARMS, rows, None).await,
            Self::Messages => oldest(connection, sql::OLDEST_MESSAGES, rows, None).await,
            Self::Pages => Ok(Vec::new()),
        }
    }

    /// Drops up to this number of rows; returns how many there were.
    async fn drop(self, connection: &mut SqliteConnection, rows: u64) -> sqlx::Result<u64> {
        let (statements, counter): (&[&'static str], _) = match self {
            Self::Traces(_) => (&[sql::DROP_TRACES, sql::TRACES_FROM], "dropped_traces"),
            Self::TracesBefore(_) => (&[sql::DROP_TRACES], "dropped_traces"),
            Self::Throws(_) => (THROWS, "dropped_throws"),
            Self::Pending(_) => (THROWS, "dropped_pending_throws"),
            Self::Alarms => (&[sql::DROP_ALARMS], "dropped_alarms"),
            Self::Messages => (&[sql::DROP_MESSAGES], "dropped_messages"),
            Self::Pages => {
                sqlx::query("PRAGMA incremental_vacuum(512)").execute(connection).await?;
                return Ok(PAGES);
            }
        };
        let chosen = self.choose(connection, rows).await?;
        if chosen.is_empty() {
            return Ok(0);
        }
        let list = serde_json::Value::from(chosen.as_slice()).to_string();
        for statement in statements {
            sqlx::query(*statement).bind(&list).execute(&mut *connection).await?;
        }
        let dropped = chosen.len() as u64;
        count(connection, counter, dropped.cast_signed()).await?;
        Ok(dropped)
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
    bound: Bound,
    choice: &'static str,
    rows: u64,
) -> sqlx::Result<Vec<i64>> {
    let holdings = sqlx::query_as(bound.holdings());
    let holdings: Vec<Holding> = holdings.bind(rows.cast_signed()).fetch_all(&mut *connection).await?;
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
struct Drop {
    kinds: Vec<Kind>,
    rows: u64,
}

impl Write for Drop {
    type Output = Housekeeping;

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<Housekeeping> {
        let mut done = Housekeeping::default();
        let mut rest = self.rows;
        for kind in &self.kinds {
            let dropped = kind.drop(connection, rest).await?;
            match kind {
                Kind::Traces(_) | Kind::TracesBefore(_) => done.traces += dropped,
                Kind::Throws(_) => done.throws += dropped,
                Kind::Pending(_) => done.pending += dropped,
                Kind::Alarms => done.alarms += dropped,
                Kind::Messages => done.messages += dropped,
                Kind::Pages => done.pages += dropped,
            }
            rest = rest.saturating_sub(dropped);
            if rest == 0 {
                break;
            }
        }
        Ok(done)
    }
}

/// The figures that are compared with the bounds.
#[derive(sqlx::FromRow)]
struct Figures {
    traces: i64,
    throws: i64,
    closed_alarms: i64,
    messages: i64,
    page_size: i64,
    pages: i64,
    free_pages: i64,
}

impl Store {
    /// Brings the database within its bounds and restores the ballast. Called every few seconds; the work of a call is
    /// bounded. `clock_trusted` tells whether `now` is correct.
    ///
    /// # Errors
    /// When the database cannot be read or written.
    pub async fn run_housekeeping(&self, now: Timestamp, clock_trusted: bool) -> Result<Housekeeping, StoreError> {
        let mut done = Housekeeping::default();
        for _ in 0..ROUNDS {
            let mut round = Housekeeping::default();
            // A bound that cannot be met must not keep the others from being met.
            for drop in self.excess(now, clock_trusted).await? {
                round = self.writer.write(drop).await?;
                if round != Housekeeping::default() {
                    break;
                }
            }
            if round == Housekeeping::default() {
                break;
            }
            self.disk.dropped_pending.add(round.pending);
            done.traces += round.traces;
            done.throws += round.throws;
            done.pending += round.pending;
            done.alarms += round.alarms;
            done.messages += round.messages;
            done.pages += round.pages;
        }
        self.disk.restore_ballast()?;
        Ok(done)
    }

    /// What to drop next, the least valuable first; empty within all bounds.
    async fn excess(&self, now: Timestamp, clock_trusted: bool) -> Result<Vec<Drop>, StoreError> {
        let mut due = Vec::new();
        let settings = &self.settings;
        let figures = sqlx::query_as(sql::FIGURES);
        let figures: Figures = self.reader.limited(figures.fetch_one(&self.reader.pool())).await?;
        let free_bytes = figures.free_pages * figures.page_size;
        let data_bytes = (figures.pages * figures.page_size).saturating_sub(free_bytes).cast_unsigned();
        let room_bytes = self.disk.free_bytes().unwrap_or(u64::MAX).saturating_add(free_bytes.cast_unsigned());
        let excess = data_bytes.saturating_sub(settings.max_size_mib * MIB);
        let missing = (settings.low_disk_mib * MIB).saturating_sub(room_bytes);
        if excess > 0 || missing > 0 {
            // The number of rows follows from the mean size of a throw with its trace.
            let each = (data_bytes / figures.traces.max(1).cast_unsigned()).max(1);
            let rows = (excess.max(missing) / each + 1).min(BATCH);
            let mut kinds = vec![Kind::Traces(Bound::TraceBytes)];
            // A disk that others fill costs traces only.
            if excess > 0 {
                kinds.extend([Kind::Throws(Bound::Bytes), Kind::Pending(Bound::Bytes), Kind::Alarms]);
            }
            due.push(Drop { kinds, rows });
        }
        let counts = [
            (figures.traces, settings.max_traces, vec![Kind::Traces(Bound::Traces), Kind::Pending(Bound::Traces)]),
            (figures.throws, settings.max_throws, vec![Kind::Throws(Bound::Throws), Kind::Pending(Bound::Throws)]),
            (figures.closed_alarms, settings.max_alarms, vec![Kind::Alarms]),
            (figures.messages, OUTBOX, vec![Kind::Messages]),
        ];
        for (count, most, kinds) in counts {
            let rows = count.cast_unsigned().saturating_sub(most).min(BATCH);
            if rows > 0 {
                due.push(Drop { kinds, rows });
            }
        }
        let before_us = (now - SignedDuration::from_hours(24 * i64::from(settings.trace_days))).as_microsecond();
        if clock_trusted && self.oldest_trace_us().await?.is_some_and(|oldest| oldest < before_us) {
            due.push(Drop { kinds: vec![Kind::TracesBefore(before_us)], rows: BATCH });
        }
        let disk_low = matches!(self.disk.level(), DiskLevel::Low | DiskLevel::Full);
        if disk_low && figures.free_pages.cast_unsigned() > PAGES {
            due.push(Drop { kinds: vec![Kind::Pages], rows: PAGES });
        }
        Ok(due)
    }

    async fn oldest_trace_us(&self) -> Result<Option<i64>, StoreError> {
        self.reader.limited(sqlx::query_scalar(sql::OLDEST_TRACE_TIME).fetch_optional(&self.reader.pool())).await
    }
}
