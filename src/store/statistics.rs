//! Figures of the database for status and metrics.

use std::collections::BTreeMap;

use super::{database::Store, error::StoreError, files::disk::DiskLevel, statements as sql};

/// Figures of the database. Retention reads every second only those of `FIGURES`, which are fast to read.
#[derive(Debug, Clone, PartialEq, Eq, Default, sqlx::FromRow)]
#[sqlx(default)]
pub struct Statistics {
    /// Stored throws.
    pub throws: u64,
    /// Stored throws with a trace.
    pub traces: u64,
    /// Closed alarms.
    pub closed_alarms: u64,
    /// Messages in the outbox.
    pub outbox: u64,
    /// Size of the data \[bytes\].
    pub data_bytes: u64,
    /// Size of the unused pages in the file \[bytes\].
    pub free_bytes: u64,
    /// [`Self::counters`] as a JSON object.
    counters: String,
    /// Pending throws: stored, not judged yet.
    pub pending: u64,
    /// Alarm events that the webhook has not accepted yet.
    pub notifications: u64,
    /// Number of missing throws as in the view `data_gaps`: without throws that a backlog may still have, and without
    /// throws from before the first contact.
    pub missing_throws: u64,
    /// Messages in quarantine.
    pub quarantined: u64,
    /// Size of the write-ahead log \[bytes\].
    pub wal_bytes: u64,
    /// Free space on the disk \[bytes\]; `None` if unknown.
    pub free_disk_bytes: Option<u64>,
    /// Failed write transactions since the start.
    pub failed_writes: u64,
}

impl Statistics {
    /// Counters since the creation of the database, by name.
    pub fn counters(&self) -> BTreeMap<String, u64> {
        serde_json::from_str(&self.counters).unwrap_or_default()
    }
}

impl Store {
    /// Reads all figures, on the connections for external queries. It counts rows: too slow for every second.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn statistics(&self) -> Result<Statistics, StoreError> {
        let read: Option<Statistics> = self.reader.external_row(sqlx::query_as(sql::STATISTICS)).await?;
        Ok(Statistics {
            wal_bytes: self.wal_bytes(),
            free_disk_bytes: self.disk.free_bytes(),
            failed_writes: self.disk.failures(),
            ..read.unwrap_or_default()
        })
    }

    /// State of the disk. Fast enough for every second.
    pub fn disk_level(&self) -> DiskLevel {
        self.disk.level()
    }

    /// Whether the database is being copied to a new file and the copy made progress in the last 30 s, or such a copy
    /// ended in the last 5 s. Writes wait during the copy.
    pub fn is_copying(&self) -> bool {
        self.disk.is_copying()
    }

    /// Size of the write-ahead log \[bytes\].
    pub fn wal_bytes(&self) -> u64 {
        self.files.log_bytes()
    }
}
