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
    /// Largest size of the data \[MiB\], 16 to 1,048,576. Above it the oldest traces go first, then the oldest throws
    /// with their estimates; alarms go last.
    pub max_size_mib: u64,
    /// Most throws whose traces are kept, 100 to 100,000,000.
    pub max_traces: u64,
    /// Most throws that are kept with their estimates, 100 to 1,000,000,000.
    pub max_throws: u64,
    /// Most alarms that are kept with their events, open ones not counted, 100 to 10,000,000.
    pub max_alarms: u64,
    /// Age at which a trace is dropped \[days\], 1 to 36,500; applied only while the clock is known to be right.
    pub trace_days: u32,
    /// Below this free space on the disk, traces are dropped \[MiB\], 0 to 1,048,576.
    pub low_disk_mib: u64,
    /// A file of this size beside the database is given up when the disk is full, so that there is room to clear up
    /// \[MiB\], 0 to 1,024, at most an eighth of the disk; 0 keeps none.
    pub ballast_mib: u64,
    /// Largest write-ahead log \[MiB\], 32 to 65,536. A program that keeps reading one old state of the database stops
    /// the log from being reused; at this size the database moves to a new file and leaves the reader the old one.
    pub max_wal_mib: u64,
    /// Most messages that are kept in quarantine, 0 to 100,000.
    pub max_quarantined: u32,
    /// How hard commits are pushed to the disk. Not for a configuration: everything but `Full` loses what it
    /// acknowledged when the power goes. It exists to prove that the power-cut test can fail.
    #[serde(skip)]
    pub synchronous: Synchronous,
}

/// SQLite's `synchronous` setting.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Synchronous {
    /// A commit is on the disk when it returns.
    #[default]
    Full,
    /// A commit is on the disk some time later.
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
    /// The first setting that is out of range.
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
