//! The `[store]` section of the configuration.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::throw::OutOfRange;

/// One mebibyte \[bytes\].
pub(super) const MIB: u64 = 1 << 20;

/// The `[store]` section of the configuration. Sizes are in MiB (1,048,576 bytes).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The database file. Its folder must be writable: SQLite keeps `-wal` and `-shm` files beside it.
    pub path: PathBuf,
    /// Largest size of the data \[MiB\], 16 to 1,048,576. Above it the oldest traces are dropped first, then the oldest
    /// throws with their estimates, last alarms.
    pub max_size_mib: u64,
    /// Largest number of traces, 100 to 100,000,000.
    pub max_traces: u64,
    /// Largest number of throws with their estimates, 100 to 1,000,000,000.
    pub max_throws: u64,
    /// Largest number of closed alarms with their events, 100 to 10,000,000.
    pub max_alarms: u64,
    /// Age at which a trace is dropped \[days\], 1 to 36,500; applied only while the clock is trusted.
    pub trace_days: u32,
    /// Free space on the disk below which traces are dropped \[MiB\], 0 to 1,048,576.
    pub low_disk_mib: u64,
    /// Size of the ballast file, which is removed when the disk is full to make space for retention \[MiB\], 0 to
    /// 1,024, at most an eighth of the disk; 0 for no ballast.
    pub ballast_mib: u64,
    /// Largest write-ahead log \[MiB\], 32 to 65,536. A program that keeps reading an old state makes the log grow; at
    /// this size the database moves to a new file, and the reader keeps the old one.
    pub max_wal_mib: u64,
    /// Largest number of messages in quarantine, 0 to 100,000.
    pub max_quarantined: u32,
    /// Durability of commits. Not a key of the configuration: without `Full` a power cut loses acknowledged rows. It
    /// exists to show that the power-cut test can fail.
    #[serde(skip)]
    pub synchronous: Synchronous,
}

/// SQLite's `synchronous` setting.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Synchronous {
    /// A commit returns when it is on the disk.
    #[default]
    Full,
    /// A commit returns before it is on the disk.
    Normal,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            path: PathBuf::from("points.db"),
            max_size_mib: 4096,
            max_traces: 200_000,
            max_throws: 5_000_000,
            max_alarms: 100_000,
            trace_days: 3650,
            low_disk_mib: 128,
            ballast_mib: 16,
            max_wal_mib: 256,
            max_quarantined: 1000,
            synchronous: Synchronous::Full,
        }
    }
}

impl Settings {
    /// Checks every range.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn validate(&self) -> Result<(), OutOfRange> {
        OutOfRange::check([
            ("max_size_mib", self.max_size_mib as f64, 16.0, f64::from(1 << 20), "MiB"),
            ("max_traces", self.max_traces as f64, 100.0, 1e8, "traces"),
            ("max_throws", self.max_throws as f64, 100.0, 1e9, "throws"),
            ("max_alarms", self.max_alarms as f64, 100.0, 1e7, "alarms"),
            ("trace_days", f64::from(self.trace_days), 1.0, 36_500.0, "days"),
            ("low_disk_mib", self.low_disk_mib as f64, 0.0, f64::from(1 << 20), "MiB"),
            ("ballast_mib", self.ballast_mib as f64, 0.0, 1024.0, "MiB"),
            ("max_wal_mib", self.max_wal_mib as f64, 32.0, 65_536.0, "MiB"),
            ("max_quarantined", f64::from(self.max_quarantined), 0.0, 100_000.0, "messages"),
        ])
    }
}
