//! What a running daemon takes and does, as the system and the daemon itself say.

use std::{fs, path::Path, time::Duration};

use pointsd::{bus, daemon::StatusReport};
use zenoh::Session;

/// What a process takes of the computer.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Usage {
    /// Memory in use \[MiB\]: its own, and the parts of its files that it has looked at.
    pub(crate) rss_mib: f64,
    /// Of this, what it has allocated \[MiB\].
    pub(crate) own_mib: f64,
    /// Open files and sockets.
    pub(crate) files: usize,
    /// Threads.
    pub(crate) threads: u32,
}

impl Usage {
    /// Of a process that runs.
    pub(crate) fn of(process: u32) -> Self {
        Self {
            rss_mib: f64::from(figure(process, "VmRSS:")) / 1024.0,
            own_mib: f64::from(figure(process, "RssAnon:")) / 1024.0,
            files: fs::read_dir(format!("/proc/{process}/fd")).unwrap().count(),
            threads: figure(process, "Threads:"),
        }
    }
}

/// The most memory that a process has had in use \[MiB\].
pub(crate) fn peak_mib(process: u32) -> f64 {
    f64::from(figure(process, "VmHWM:")) / 1024.0
}

fn figure(process: u32, key: &str) -> u32 {
    let status = fs::read_to_string(format!("/proc/{process}/status")).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix(key)).expect(key);
    line.split_whitespace().next().unwrap().parse().unwrap()
}

/// What the allocator of a process holds, as `heap.c` tells.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Heap {
    /// Handed out and not given back \[MiB\]: this is what a leak makes grow.
    pub(crate) live_mib: f64,
    /// Given back, and kept by the allocator for the next request \[MiB\].
    pub(crate) free_mib: f64,
}

impl Heap {
    /// Of a process that tells it to this file; `None` while there is no such file.
    pub(crate) fn told_to(file: &Path) -> Option<Self> {
        let text = fs::read_to_string(file).ok()?;
        let mut mib = text.split_whitespace().map_while(|bytes| Some(bytes.parse::<f64>().ok()? / f64::from(1 << 20)));
        Some(Self { live_mib: mib.next()?, free_mib: mib.next()? })
    }
}

/// Size of a file \[MiB\]; 0 where there is none.
pub(crate) fn mib(file: &Path) -> f64 {
    fs::metadata(file).map_or(0.0, |file| file.len() as f64 / f64::from(1 << 20))
}

/// What the daemon says of itself; `None` when it does not answer in time.
pub(crate) async fn status(session: &Session) -> Option<StatusReport> {
    let replies = bus::ask(session, "points/v1/*/monitor/*/status", None, Duration::from_secs(5)).await.ok()?;
    serde_json::from_slice(&replies.first()?.1).ok()
}
