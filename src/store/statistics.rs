//! Figures of the database for status and metrics.

use std::collections::BTreeMap;

use super::{database::Store, disk::DiskLevel, error::StoreError, statements as sql};

/// Figures of the database.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Statistics {
    /// Stored throws.
    pub throws: u64,
    /// Stored throws with a trace.
    pub traces: u64,
    /// Pending throws: stored, not judged yet.
    pub pending: u64,
    /// Messages in the outbox.
    pub outbox: u64,
    /// Alarm events that the webhook has not accepted yet.
    pub notifications: u64,
    /// Open alarms.
    pub open_alarms: u64,
    /// Throw numbers in gaps.
    pub missing_throws: u64,
    /// Messages in quarantine.
    pub quarantined: u64,
    /// Size of the data \[bytes\].
    pub data_bytes: u64,
    /// Free pages in the file \[bytes\].
    pub free_bytes: u64,
    /// Size of the write-ahead log \[bytes\].
    pub wal_bytes: u64,
    /// Free space on the disk \[bytes\]; `None` if unknown.
    pub free_disk_bytes: Option<u64>,
    /// State of the disk below the database.
    pub disk: DiskLevel,
    /// Failed write transactions since the start.
    pub failed_writes: u64,
    /// Counters since the creation of the database, by name.
    pub counters: BTreeMap<String, u64>,
}

impl Store {
    /// Reads the figures, on the connections for external queries. Counts rows, so it is too slow for every second.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn statistics(&self) -> Result<Statistics, StoreError> {
        let reader = &self.reader;
        let counters: Vec<(String, i64)> = reader.asked(sqlx::query_as(sql::COUNTERS)).await?;
        let page_size = reader.asked_figure("PRAGMA page_size").await?;
        let pages = reader.asked_figure("PRAGMA page_count").await?;
        let free_pages = reader.asked_figure("PRAGMA freelist_count").await?;
        Ok(Statistics {
            throws: reader.asked_figure(sql::THROW_COUNT).await?,
            traces: reader.asked_figure(sql::TRACE_COUNT).await?,
            pending: reader.asked_figure(sql::PENDING_COUNT).await?,
            outbox: reader.asked_figure(sql::OUTBOX_COUNT).await?,
            notifications: reader.asked_figure(sql::NOTIFICATION_COUNT).await?,
            open_alarms: reader.asked_figure(sql::OPEN_ALARM_COUNT).await?,
            missing_throws: reader.asked_figure(sql::OPEN_GAP_COUNT).await?,
            quarantined: reader.asked_figure(sql::QUARANTINE_COUNT).await?,
            data_bytes: pages.saturating_sub(free_pages) * page_size,
            free_bytes: free_pages * page_size,
            wal_bytes: self.wal_bytes(),
            free_disk_bytes: self.disk.free_bytes(),
            disk: self.disk.level(),
            failed_writes: self.disk.failures(),
            counters: counters.into_iter().map(|(name, value)| (name, value.cast_unsigned())).collect(),
        })
    }

    /// State of the disk. Fast enough for every second.
    #[must_use]
    pub fn disk_level(&self) -> DiskLevel {
        self.disk.level()
    }

    /// Whether the database is being copied to a new file, with progress in the last 30 s. Writes wait meanwhile.
    #[must_use]
    pub fn is_copying(&self) -> bool {
        self.disk.is_copying()
    }

    /// Size of the write-ahead log \[bytes\].
    #[must_use]
    pub fn wal_bytes(&self) -> u64 {
        self.place.log_bytes()
    }
}
