//! Keeping the database within its bounds, a little at a time.
//!
//! Traces go first, then throws with their estimates, closed alarms last; pending throws go only when nothing else is left.
//! The machine that takes the most of the database loses its own history first: one that floods pushes out no other.
//! Age counts only while the clock is known to be right: a clock that jumps ten years ahead must not empty the
//! database. All is done in small transactions between those of the arriving throws.

use jiff::{SignedDuration, Timestamp};
use sqlx::SqliteConnection;

use super::{
    database::Store, disk::DiskLevel, error::StoreError, settings::MIB, spool::count, statements as sql, write::Write,
};

/// Rows that one transaction drops: some milliseconds of work.
const BATCH: u64 = 256;
/// Throws or traces of the largest machine that are dropped before the machines are compared again: in larger steps one of
/// two equal machines loses nearly all of its history.
const FAIR_BATCH: u64 = 16;
/// Transactions of one call, so that it ends while throws arrive faster than rows are dropped.
const ROUNDS: usize = 256;
/// Pages given back to the disk in one transaction.
const PAGES: u64 = 512;
/// Messages that wait for zenoh at most: ten years of a cabinet's alarms.
const OUTBOX: u64 = 100_000;

/// What one call of [`Store::keep_house`] dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Housekeeping {
    /// Traces.
    pub traces: u64,
    /// Throws with their estimates.
    pub throws: u64,
    /// Closed alarms with their events.
    pub alarms: u64,
    /// Messages that zenoh never took, the oldest.
    pub messages: u64,
}

/// One small transaction of clearing up.
#[derive(Debug, Clone, Copy)]
enum Drop {
    Traces(u64),
    TracesBefore(i64),
    Throws(u64),
    /// The size is bounded whatever arrives: a machine that sends more than can be judged loses its oldest throws.
    Pending,
    Alarms(u64),
    Messages,
    Pages,
}

impl Drop {
    /// The total in which it is counted.
    const fn counter(self) -> &'static str {
        match self {
            Self::Traces(_) | Self::TracesBefore(_) => "dropped_traces",
            Self::Throws(_) => "dropped_throws",
            Self::Pending => "dropped_pending_throws",
            Self::Alarms(_) => "dropped_alarms",
            Self::Messages => "dropped_messages",
            Self::Pages => "returned_pages",
        }
    }
}

impl Write for Drop {
    /// Rows that were dropped.
    type Output = u64;

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<u64> {
        let (choice, limit, each): (_, _, &[&'static str]) = match *self {
            Self::Traces(rows) => (sql::OLDEST_TRACES, rows, &[sql::DROP_TRACE, sql::TRACES_FROM]),
            Self::TracesBefore(_) => (sql::AGED_TRACES, BATCH, &[sql::DROP_TRACE]),
            Self::Throws(rows) => (sql::OLDEST_THROWS, rows, &[sql::MARK_PRUNED, sql::DROP_OLD_GAPS, sql::DROP_THROW]),
            Self::Pending => (sql::OLDEST_PENDING, BATCH, &[sql::MARK_PRUNED, sql::DROP_OLD_GAPS, sql::DROP_THROW]),
            Self::Alarms(rows) => (sql::OLDEST_ALARMS, rows, &[sql::DROP_ALARM]),
            Self::Messages => (sql::OLDEST_MESSAGES, BATCH, &[sql::SENT]),
            Self::Pages => {
                sqlx::query("PRAGMA incremental_vacuum(512)").execute(connection).await?;
                return Ok(PAGES);
            }
        };
        let chosen = sqlx::query_scalar(choice).bind(limit.cast_signed());
        let chosen = if let Self::TracesBefore(at_us) = self { chosen.bind(at_us) } else { chosen };
        let rows: Vec<i64> = chosen.fetch_all(&mut *connection).await?;
        for row in &rows {
            for statement in each {
                sqlx::query(*statement).bind(row).execute(&mut *connection).await?;
            }
        }
        let dropped = rows.len() as u64;
        if matches!(self, Self::Throws(_) | Self::Pending) {
            sqlx::query(sql::DROP_EMPTY_BOOTS).execute(&mut *connection).await?;
        }
        if dropped > 0 {
            count(connection, self.counter(), dropped.cast_signed()).await?;
        }
        Ok(dropped)
    }
}

/// What the bounds are compared with.
struct Figures {
    traces: u64,
    throws: u64,
    closed_alarms: u64,
    messages: u64,
    data_bytes: u64,
    free_pages: u64,
    /// Space that the database can still grow into: on the disk, and inside its file.
    room_bytes: u64,
    disk_low: bool,
}

impl Store {
    /// Brings the database back within its bounds and restores the ballast. To be called every few seconds;
    /// one call does a bounded amount of work. `clock_trusted`: `now` is known to be right.
    ///
    /// # Errors
    /// When the database cannot be read or written.
    pub async fn keep_house(&self, now: Timestamp, clock_trusted: bool) -> Result<Housekeeping, StoreError> {
        let mut done = Housekeeping::default();
        for _ in 0..ROUNDS {
            let figures = self.figures().await?;
            let Some(drop) = self.excess(&figures, now, clock_trusted).await? else { break };
            let dropped = self.writer.write(drop).await?;
            match drop {
                Drop::Traces(_) | Drop::TracesBefore(_) => done.traces += dropped,
                Drop::Throws(_) => done.throws += dropped,
                Drop::Pending => {
                    done.throws += dropped;
                    self.disk.note_dropped_pending(dropped);
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

    /// The next thing to drop, if anything is too much.
    async fn excess(&self, figures: &Figures, now: Timestamp, clock_trusted: bool) -> Result<Option<Drop>, StoreError> {
        let settings = &self.settings;
        let excess = figures.data_bytes.saturating_sub(settings.max_size_mib * MIB);
        let missing = (settings.low_disk_mib * MIB).saturating_sub(figures.room_bytes);
        let (too_large, no_room) = (excess > 0, missing > 0);
        if figures.traces > settings.max_traces {
            return Ok(Some(Drop::Traces(FAIR_BATCH.min(figures.traces - settings.max_traces))));
        }
        if (too_large || no_room) && self.any(sql::OLDEST_TRACES).await? {
            // As many as it takes, by their mean size: a few of the largest may be enough.
            let each = (figures.data_bytes / figures.traces.max(1)).max(1);
            return Ok(Some(Drop::Traces((excess.max(missing) / each + 1).min(BATCH))));
        }
        if too_large {
            let judged = self.any(sql::OLDEST_THROWS).await?;
            return Ok(Some(if judged { Drop::Throws(BATCH) } else { Drop::Pending }));
        }
        if figures.throws > settings.max_throws {
            return Ok(Some(Drop::Throws(FAIR_BATCH.min(figures.throws - settings.max_throws))));
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

    async fn any(&self, choice: &'static str) -> Result<bool, StoreError> {
        let rows = sqlx::query_scalar::<_, i64>(choice).bind(1);
        Ok(!self.reader.limited(rows.fetch_all(&self.reader.pool())).await?.is_empty())
    }

    async fn oldest_trace_us(&self) -> Result<Option<i64>, StoreError> {
        self.reader.limited(sqlx::query_scalar(sql::OLDEST_TRACE_TIME).fetch_optional(&self.reader.pool())).await
    }
}
