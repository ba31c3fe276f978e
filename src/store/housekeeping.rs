//! Retention: keeps the database within its bounds, in small transactions.
//!
//! Traces are dropped first, then throws with their estimates, last closed alarms; pending throws only if nothing else
//! is left. Each row comes from the machine with the most, so that a flood of one machine removes only its own history.
//! Age counts only while the clock is trusted: a clock that jumps ten years ahead must not empty the database. The
//! small transactions run between those of received throws.

use std::collections::{BTreeMap, BinaryHeap};

use jiff::{SignedDuration, Timestamp};
use sqlx::SqliteConnection;

use super::{
    database::Store, disk::DiskLevel, error::StoreError, settings::MIB, spool::count, statements as sql, write::Write,
};

/// Rows dropped in one transaction: some milliseconds of work.
const BATCH: u64 = 256;
/// Largest number of transactions in one call, which then ends even if throws arrive faster than rows are dropped.
const ROUNDS: usize = 256;
/// Pages returned to the disk in one transaction.
const PAGES: u64 = 512;
/// Largest outbox \[messages\]: ten years of a cabinet's alarms.
const OUTBOX: u64 = 100_000;

/// Rows dropped by a call of [`Store::run_housekeeping`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Housekeeping {
    /// Dropped traces.
    pub traces: u64,
    /// Dropped throws with their estimates.
    pub throws: u64,
    /// Dropped closed alarms with their events.
    pub alarms: u64,
    /// Dropped messages of the outbox, the oldest.
    pub messages: u64,
}

/// The bounded quantity, by which machines are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bound {
    Rows,
    Bytes,
}

/// A transaction that drops some rows.
#[derive(Debug, Clone, Copy)]
enum Drop {
    Traces(Bound, u64),
    TracesBefore(i64),
    Throws(Bound, u64),
    /// Pending throws: a machine that sends more throws than can be judged loses its oldest ones.
    Pending,
    Alarms(u64),
    Messages,
    Pages,
}

impl Drop {
    /// Name of the counter.
    const fn counter(self) -> &'static str {
        match self {
            Self::Traces(..) | Self::TracesBefore(_) => "dropped_traces",
            Self::Throws(..) => "dropped_throws",
            Self::Pending => "dropped_pending_throws",
            Self::Alarms(_) => "dropped_alarms",
            Self::Messages => "dropped_messages",
            Self::Pages => "returned_pages",
        }
    }

    /// Selects the rows to drop.
    async fn choose(self, connection: &mut SqliteConnection) -> sqlx::Result<Vec<i64>> {
        match self {
            Self::Traces(bound, rows) => {
                let holdings = match bound {
                    Bound::Rows => sql::TRACE_HOLDINGS,
                    Bound::Bytes => sql::TRACE_BYTE_HOLDINGS,
                };
                oldest_of_largest(connection, holdings, sql::OLDEST_TRACES, rows).await
            }
            Self::Throws(bound, rows) => {
                let holdings = match bound {
                    Bound::Rows => sql::THROW_HOLDINGS,
                    Bound::Bytes => sql::THROW_BYTE_HOLDINGS,
                };
                oldest_of_largest(connection, holdings, sql::OLDEST_THROWS, rows).await
            }
            Self::TracesBefore(at_us) => oldest(connection, sql::AGED_TRACES, BATCH, Some(at_us)).await,
            Self::Pending => oldest(connection, sql::OLDEST_PENDING, BATCH, None).await,
            Self::Alarms(rows) => oldest(connection, sql::OLDEST_ALARMS, rows, None).await,
            Self::Messages => oldest(connection, sql::OLDEST_MESSAGES, BATCH, None).await,
            Self::Pages => Ok(Vec::new()),
        }
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
    holdings: &'static str,
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

impl Write for Drop {
    /// Number of dropped rows.
    type Output = u64;

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<u64> {
        let each: &[&'static str] = match self {
            Self::Traces(..) => &[sql::DROP_TRACE, sql::TRACES_FROM],
            Self::TracesBefore(_) => &[sql::DROP_TRACE],
            Self::Throws(..) | Self::Pending => &[sql::MARK_PRUNED, sql::DROP_OLD_GAPS, sql::DROP_THROW],
            Self::Alarms(_) => &[sql::DROP_ALARM],
            Self::Messages => &[sql::SENT],
            Self::Pages => {
                sqlx::query("PRAGMA incremental_vacuum(512)").execute(connection).await?;
                return Ok(PAGES);
            }
        };
        let rows = self.choose(connection).await?;
        for row in &rows {
            for statement in each {
                sqlx::query(*statement).bind(row).execute(&mut *connection).await?;
            }
        }
        let dropped = rows.len() as u64;
        if matches!(self, Self::Throws(..) | Self::Pending) {
            sqlx::query(sql::DROP_EMPTY_BOOTS).execute(&mut *connection).await?;
        }
        if dropped > 0 {
            count(connection, self.counter(), dropped.cast_signed()).await?;
        }
        Ok(dropped)
    }
}

/// The figures that are compared with the bounds.
struct Figures {
    traces: u64,
    throws: u64,
    closed_alarms: u64,
    messages: u64,
    data_bytes: u64,
    free_pages: u64,
    /// Space for growth: free on the disk, and free pages in the file.
    room_bytes: u64,
    disk_low: bool,
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
            let figures = self.figures().await?;
            let Some(drop) = self.excess(&figures, now, clock_trusted).await? else { break };
            let dropped = self.writer.write(drop).await?;
            match drop {
                Drop::Traces(..) | Drop::TracesBefore(_) => done.traces += dropped,
                Drop::Throws(..) => done.throws += dropped,
                Drop::Pending => {
                    done.throws += dropped;
                    self.disk.dropped_pending.add(dropped);
                }
                Drop::Alarms(_) => done.alarms += dropped,
                Drop::Messages => done.messages += dropped,
                Drop::Pages => {}
            }
            if dropped == 0 {
                break;
            }
        }
        self.disk.restore_ballast()?;
        Ok(done)
    }

    async fn figures(&self) -> Result<Figures, StoreError> {
        let page_size = self.figure("PRAGMA page_size").await?;
        let free_pages = self.figure("PRAGMA freelist_count").await?;
        let pages = self.figure("PRAGMA page_count").await?;
        Ok(Figures {
            traces: self.figure(sql::TRACE_COUNT).await?,
            throws: self.figure(sql::THROW_COUNT).await?,
            closed_alarms: self.figure(sql::CLOSED_ALARMS).await?,
            messages: self.figure(sql::OUTBOX_COUNT).await?,
            data_bytes: pages.saturating_sub(free_pages) * page_size,
            free_pages,
            room_bytes: self.disk.free_bytes().unwrap_or(u64::MAX).saturating_add(free_pages * page_size),
            disk_low: matches!(self.disk.level(), DiskLevel::Low | DiskLevel::Full),
        })
    }

    /// The next rows to drop; `None` within all bounds.
    async fn excess(&self, figures: &Figures, now: Timestamp, clock_trusted: bool) -> Result<Option<Drop>, StoreError> {
        let settings = &self.settings;
        let excess = figures.data_bytes.saturating_sub(settings.max_size_mib * MIB);
        let missing = (settings.low_disk_mib * MIB).saturating_sub(figures.room_bytes);
        let (too_large, no_room) = (excess > 0, missing > 0);
        if figures.traces > settings.max_traces {
            return Ok(Some(Drop::Traces(Bound::Rows, BATCH.min(figures.traces - settings.max_traces))));
        }
        if (too_large || no_room) && self.largest_has(sql::OLDEST_TRACES).await? {
            // The number of traces follows from their mean size.
            let each = (figures.data_bytes / figures.traces.max(1)).max(1);
            return Ok(Some(Drop::Traces(Bound::Bytes, (excess.max(missing) / each + 1).min(BATCH))));
        }
        if too_large {
            let judged = self.largest_has(sql::OLDEST_THROWS).await?;
            return Ok(Some(if judged { Drop::Throws(Bound::Bytes, BATCH) } else { Drop::Pending }));
        }
        if figures.throws > settings.max_throws {
            return Ok(Some(Drop::Throws(Bound::Rows, BATCH.min(figures.throws - settings.max_throws))));
        }
        if figures.closed_alarms > settings.max_alarms {
            return Ok(Some(Drop::Alarms(BATCH.min(figures.closed_alarms - settings.max_alarms))));
        }
        if figures.messages > OUTBOX {
            return Ok(Some(Drop::Messages));
        }
        let before_us = (now - SignedDuration::from_hours(24 * i64::from(settings.trace_days))).as_microsecond();
        if clock_trusted && self.oldest_trace_us().await?.is_some_and(|oldest| oldest < before_us) {
            return Ok(Some(Drop::TracesBefore(before_us)));
        }
        Ok((figures.disk_low && figures.free_pages > PAGES).then_some(Drop::Pages))
    }

    async fn figure(&self, query: &'static str) -> Result<u64, StoreError> {
        let figure: i64 = self.reader.limited(sqlx::query_scalar(query).fetch_one(&self.reader.pool())).await?;
        Ok(figure.cast_unsigned())
    }

    /// Whether the machine with the most bytes has rows of this selection.
    async fn largest_has(&self, choice: &'static str) -> Result<bool, StoreError> {
        let pool = self.reader.pool();
        let largest = sqlx::query_scalar::<_, i64>(sql::LARGEST_MACHINE);
        let Some(machine_row) = self.reader.limited(largest.fetch_optional(&pool)).await? else { return Ok(false) };
        let row = sqlx::query_scalar::<_, i64>(choice).bind(1).bind(machine_row);
        Ok(self.reader.limited(row.fetch_optional(&pool)).await?.is_some())
    }

    async fn oldest_trace_us(&self) -> Result<Option<i64>, StoreError> {
        self.reader.limited(sqlx::query_scalar(sql::OLDEST_TRACE_TIME).fetch_optional(&self.reader.pool())).await
    }
}
