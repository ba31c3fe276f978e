//! The `[store]` section of the configuration.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::throw::{Range::Within, settings};

/// One mebibyte \[bytes\].
pub(super) const MIB: u64 = 1 << 20;
/// Size of a page of the database \[bytes\]: the default of SQLite.
pub(super) const PAGE_BYTES: usize = 4096;

settings! {
    /// The `[store]` section of the configuration. Sizes are in MiB (1,048,576 bytes).
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Settings {
        /// The database file. Its folder must be writable: SQLite keeps `-wal` and `-shm` files beside it.
        pub path: PathBuf = PathBuf::from("points.db");
        /// Largest size of the data \[MiB\], 16 to 1,048,576. Above it the oldest traces are dropped first, then the
        /// oldest judged throws with their estimates, then the oldest pending throws, last alarms.
        pub max_size_mib: u64 = 4096, Within(16.0, f64::from(1 << 20), "MiB");
        /// Largest number of traces, 100 to 100,000,000.
        pub max_traces: u64 = 200_000, Within(100.0, 1e8, "traces");
        /// Largest number of throws with their estimates, 100 to 1,000,000,000.
        pub max_throws: u64 = 5_000_000, Within(100.0, 1e9, "throws");
        /// Largest number of closed alarms with their events, 100 to 10,000,000.
        pub max_alarms: u64 = 100_000, Within(100.0, 1e7, "alarms");
        /// Age at which a trace is dropped \[days\], 1 to 36,500; applied only while the clock is trusted: no jump for
        /// 24 h, and set by systemd-timesyncd or, at the start, at most 31 days after the newest throw.
        pub trace_days: u32 = 3650, Within(1.0, 36_500.0, "days");
        /// Free space on the disk below which traces are dropped \[MiB\], 0 to 1,048,576.
        pub low_disk_mib: u64 = 128, Within(0.0, f64::from(1 << 20), "MiB");
        /// Size of the ballast file, which is removed when the disk is full to make space for retention \[MiB\], 0 to
        /// 1,024, at most an eighth of the disk; 0 for no ballast.
        pub ballast_mib: u64 = 16, Within(0.0, 1024.0, "MiB");
        /// Largest write-ahead log \[MiB\], 32 to 65,536. A program that keeps reading an old state makes the log grow;
        /// at this size the database moves to a new file, and the reader keeps the old one.
        pub max_wal_mib: u64 = 256, Within(32.0, 65_536.0, "MiB");
        /// Largest number of messages in quarantine, 0 to 100,000.
        pub max_quarantined: u32 = 1000, Within(0.0, 100_000.0, "messages");
    }
}
