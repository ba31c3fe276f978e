//! What an operator can set about the database.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

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

/// A setting out of its range.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key} = {value} is out of range: {low} to {high} {unit}")]
pub struct OutOfRange {
    /// The key in the section.
    pub key: &'static str,
    /// Its value.
    pub value: u64,
    /// Lowest value allowed.
    pub low: u64,
    /// Highest value allowed.
    pub high: u64,
    /// Its unit.
    pub unit: &'static str,
}

impl Settings {
    /// Checks every range.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn validate(&self) -> Result<(), OutOfRange> {
        let ranges: [(&'static str, u64, u64, u64, &'static str); 9] = [
            ("max_size_mib", self.max_size_mib, 16, 1 << 20, "MiB"),
            ("max_traces", self.max_traces, 100, 100_000_000, "traces"),
            ("max_throws", self.max_throws, 100, 1_000_000_000, "throws"),
            ("max_alarms", self.max_alarms, 100, 10_000_000, "alarms"),
            ("trace_days", u64::from(self.trace_days), 1, 36_500, "days"),
            ("low_disk_mib", self.low_disk_mib, 0, 1 << 20, "MiB"),
            ("ballast_mib", self.ballast_mib, 0, 1024, "MiB"),
            ("max_wal_mib", self.max_wal_mib, 32, 65_536, "MiB"),
            ("max_quarantined", u64::from(self.max_quarantined), 0, 100_000, "messages"),
        ];
        for (key, value, low, high, unit) in ranges {
            if !(low..=high).contains(&value) {
                return Err(OutOfRange { key, value, low, high, unit });
            }
        }
        Ok(())
    }
}
