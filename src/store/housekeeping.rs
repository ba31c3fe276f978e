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

/// A transaction that drops some rows.
#[derive(Debug, Clone, Copy)]
struct Drop {
    kind: Kind,
    /// Largest number of rows.
    rows: u64,
}

impl Drop {
    /// Name of the counter.
    const fn counter(self) -> &'static str {
        match self.kind {
            Kind::Traces(_) | Kind::TracesBefore(_) => "dropped_traces",
            Kind::Throws(_) => "dropped_throws",
            Kind::Pending(_) => "dropped_pending_throws",
            Kind::Alarms => "dropped_alarms",
            Kind::Messages => "dropped_messages",
            Kind::Pages => "returned_pages",
        }
    }

    /// Selects the rows to drop.
    async fn choose(self, connection: &mut SqliteConnection) -> sqlx::Result<Vec<i64>> {
        let rows = self.rows;
        match self.kind {
            Kind::Traces(bound) => oldest_of_largest(connection, bound, sql::OLDEST_TRACES, rows).await,
            Kind::Throws(bound) => oldest_of_largest(connection, bound, sql::OLDEST_THROWS, rows).await,
            Kind::Pending(bound) => oldest_of_largest(connection, bound, sql::OLDEST_PENDING, rows).await,
            Kind::TracesBefore(at_us) => oldest(connection, sql::AGED_TRACES, rows, Some(at_us)).await,
            Kind::Alarms => oldest(connection, sql::OLDEST_ALARMS, rows, None).await,
            Kind::Messages => oldest(connection, sql::OLDEST_MESSAGES, rows, None).await,
            Kind::Pages => Ok(Vec::new()),
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

impl Write for Drop {
    /// Number of dropped rows.
    type Output = u64;

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<u64> {
        let each: &[&'static str] = match self.kind {
            Kind::Traces(_) => &[sql::DROP_TRACE, sql::TRACES_FROM],
            Kind::TracesBefore(_) => &[sql::DROP_TRACE],
            Kind::Throws(_) | Kind::Pending(_) => &[sql::MARK_PRUNED, sql::DROP_OLD_GAPS, sql::DROP_THROW],
            Kind::Alarms => &[sql::DROP_ALARM],
            Kind::Messages => &[sql::SENT],
            Kind::Pages => {
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
        if matches!(self.kind, Kind::Throws(_) | Kind::Pending(_)) {
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
            let Some((rows, kinds)) = self.excess(&figures, now, clock_trusted).await? else { break };
            if self.drop_rows(rows, kinds, &mut done).await? == 0 {
                break;
            }
        }
        self.disk.restore_ballast()?;
        Ok(done)
    }

    /// Drops this number of rows, of a later kind only as far as the earlier ones have too few; returns their number.
    async fn drop_rows(&self, rows: u64, kinds: Vec<Kind>, done: &mut Housekeeping) -> Result<u64, StoreError> {
        let mut total = 0;
        for kind in kinds {
            let dropped = self.writer.write(Drop { kind, rows: rows - total }).await?;
            match kind {
                Kind::Traces(_) | Kind::TracesBefore(_) => done.traces += dropped,
                Kind::Throws(_) => done.throws += dropped,
                Kind::Pending(_) => {
                    done.throws += dropped;
                    self.disk.dropped_pending.add(dropped);
                }
                Kind::Alarms => done.alarms += dropped,
                Kind::Messages => done.messages += dropped,
                Kind::Pages => {}
            }
            total += dropped;
            if total >= rows {
                break;
            }
        }
        Ok(total)
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

    /// The number of rows to drop next, and their kinds, the least valuable first; `None` within all bounds.
    async fn excess(
        &self,
        figures: &Figures,
        now: Timestamp,
        clock_trusted: bool,
    ) -> Result<Option<(u64, Vec<Kind>)>, StoreError> {
        let settings = &self.settings;
        let excess = figures.data_bytes.saturating_sub(settings.max_size_mib * MIB);
        let missing = (settings.low_disk_mib * MIB).saturating_sub(figures.room_bytes);
        if excess > 0 || missing > 0 {
            // The number of rows follows from the mean size of a throw with its trace.
            let each = (figures.data_bytes / figures.traces.max(1)).max(1);
            let mut kinds = vec![Kind::Traces(Bound::TraceBytes)];
            // A disk that others fill costs traces only.
            if excess > 0 {
                kinds.extend([Kind::Throws(Bound::Bytes), Kind::Pending(Bound::Bytes)]);
            }
            return Ok(Some(((excess.max(missing) / each + 1).min(BATCH), kinds)));
        }
        let excess = |count: u64, most: u64| (count > most).then(|| (count - most).min(BATCH));
        if let Some(rows) = excess(figures.traces, settings.max_traces) {
            return Ok(Some((rows, vec![Kind::Traces(Bound::Traces), Kind::Pending(Bound::Traces)])));
        }
        if let Some(rows) = excess(figures.throws, settings.max_throws) {
            return Ok(Some((rows, vec![Kind::Throws(Bound::Throws), Kind::Pending(Bound::Throws)])));
        }
        if let Some(rows) = excess(figures.closed_alarms, settings.max_alarms) {
            return Ok(Some((rows, vec![Kind::Alarms])));
        }
        if let Some(rows) = excess(figures.messages, OUTBOX) {
            return Ok(Some((rows, vec![Kind::Messages])));
        }
        let before_us = (now - SignedDuration::from_hours(24 * i64::from(settings.trace_days))).as_microsecond();
        if clock_trusted && self.oldest_trace_us().await?.is_some_and(|oldest| oldest < before_us) {
            return Ok(Some((BATCH, vec![Kind::TracesBefore(before_us)])));
        }
        Ok((figures.disk_low && figures.free_pages > PAGES).then(|| (PAGES, vec![Kind::Pages])))
    }

    async fn figure(&self, query: &'static str) -> Result<u64, StoreError> {
        let figure: i64 = self.reader.limited(sqlx::query_scalar(query).fetch_one(&self.reader.pool())).await?;
        Ok(figure.cast_unsigned())
    }

    async fn oldest_trace_us(&self) -> Result<Option<i64>, StoreError> {
        self.reader.limited(sqlx::query_scalar(sql::OLDEST_TRACE_TIME).fetch_optional(&self.reader.pool())).await
    }
}
