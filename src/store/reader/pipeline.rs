//! Queries of the daemon's loops: pending throws, backlogs, monitors, and messages to publish.

use std::time::Duration;

use jiff::Timestamp;
use sqlx::Row as _;

use super::Reader;
use crate::{
    store::{
        error::StoreError,
        rows::{Gap, OutboxRow, PendingRow, StoredMonitor, StoredThrow, ThrowRow, from_json, timestamp},
        statements as sql,
        writer::cursor::{self, Cursor},
    },
    throw::MachineId,
};

/// Number of samples of each channel after which a batch of pending throws ends: 32 MiB.
const BATCH_SAMPLES: usize = 2 << 20;

#[expect(clippy::missing_errors_doc, reason = "the documentation of `Reader` says when its methods fail")]
impl Reader {
    /// Up to `limit` pending throws to judge next: the throws of a machine in order, the machines in turn, starting
    /// after the machine `after`. Throws after an awaited gap are left out, for at most `wait` after the backlog of the
    /// machine was opened or last became smaller. Also returns whether the batch is full.
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
            chosen.try_get(0).and_then(from_json::<Vec<PendingRow>>).map_err(StoreError::read)
        };
        let mut rows = turn(after).await?;
        if rows.is_empty() && after.is_some() {
            rows = turn(None).await?;
        }
        let mut is_full = rows.len() >= limit as usize;
        let (mut throws, mut samples) = (Vec::with_capacity(rows.len()), 0);
        for row in rows {
            let stored = match self.recent.take(ThrowRow(row.row)) {
                Some(throw) => StoredThrow::from_memory(row, throw).map_err(StoreError::read)?,
                None => match self.stored(ThrowRow(row.row)).await? {
                    Some(stored) => stored,
                    // Retention has just deleted the throw.
                    None => continue,
                },
            };
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
    pub async fn cursor(&self, machine: &MachineId) -> Result<Cursor, StoreError> {
        let read = async {
            let mut connection = self.pool().acquire().await?;
            cursor::current(&mut connection, machine).await
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
    pub async fn throws(&self, after: ThrowRow, limit: u32) -> Result<Vec<StoredThrow>, StoreError> {
        self.rows(sqlx::query_as(sql::THROWS).bind(after.0).bind(limit)).await
    }

    /// A throw; `None` if retention has deleted it.
    pub(crate) async fn stored(&self, row: ThrowRow) -> Result<Option<StoredThrow>, StoreError> {
        Ok(self.rows(sqlx::query_as(sql::STORED_THROW).bind(row.0)).await?.pop())
    }

    /// All throws in the order in which they were judged, those of a machine in the order of their numbers, and then the
    /// pending ones. Without the time limit: millions of rows are sorted for some seconds, or longer from a slow disk.
    pub(crate) async fn judged_order(&self) -> Result<Vec<ThrowRow>, StoreError> {
        let rows = sqlx::query_scalar(sql::JUDGED_ORDER).fetch_all(&self.pool()).await.map_err(StoreError::read)?;
        Ok(rows.into_iter().map(ThrowRow).collect())
    }

    /// The monitors of the next `limit` machines after `after` (`None` for the first ones), in the order of names.
    pub async fn monitors(&self, after: Option<&MachineId>, limit: u32) -> Result<Vec<StoredMonitor>, StoreError> {
        let (site, machine) = after.map_or(("", ""), |after| (after.site.as_str(), after.machine.as_str()));
        self.rows(sqlx::query_as(sql::MONITORS).bind(site).bind(machine).bind(limit)).await
    }

    /// Time of reception of the newest throw.
    pub(crate) async fn last_received(&self) -> Result<Option<Timestamp>, StoreError> {
        let at_us = self.limited(sqlx::query_scalar(sql::LAST_RECEIVED).fetch_optional(&self.pool())).await?;
        Ok(at_us.map(timestamp))
    }

    /// Up to `limit` messages of the outbox after the row `after` (0 for all), in order.
    pub async fn outbox_pending(&self, after: i64, limit: u32) -> Result<Vec<OutboxRow>, StoreError> {
        self.rows(sqlx::query_as(sql::MESSAGES).bind(after).bind(limit)).await
    }

    /// Up to `limit` notifications for the webhook after the row `after`, with their rows, in order.
    pub(crate) async fn notifications(&self, after: i64, limit: u32) -> Result<Vec<(i64, String)>, StoreError> {
        self.rows(sqlx::query_as(sql::NOTIFICATIONS).bind(after).bind(limit)).await
    }

    /// The keys of the newest messages in quarantine, those with the most messages first, each with reason and time \[µs\]
    /// of its last message. A machine with a throw after this message, or retired after it, is left out.
    pub(crate) async fn last_refused(&self) -> Result<Vec<(String, String, i64)>, StoreError> {
        self.rows(sqlx::query_as(sql::LAST_REFUSED)).await
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

/// The judge waits for a backlog that was opened or last became smaller within this range of times \[µs\]. The upper
/// end is now: a later time was stored before the clock was set back.
fn waiting(now: Timestamp, wait: Duration) -> (i64, i64) {
    let wait_us = i64::try_from(wait.as_micros()).unwrap_or(i64::MAX);
    (now.as_microsecond().saturating_sub(wait_us).saturating_add(1), now.as_microsecond())
}
