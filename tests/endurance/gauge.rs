//! Memory, files, threads and status of a running daemon.

use std::{fs, path::Path, time::Duration};

use pointsd::{bus, daemon::StatusReport};
use zenoh::Session;

use crate::rig::status_of;

/// Resources of a process.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Usage {
    /// Resident memory \[MiB\]: allocated memory and cached parts of its files.
    pub(crate) rss_mib: f64,
    /// Allocated part of the resident memory \[MiB\].
    pub(crate) own_mib: f64,
    /// Open files and sockets.
    pub(crate) files: usize,
    pub(crate) threads: u32,
}

impl Usage {
    /// The resources of a running process.
    pub(crate) fn of(process: u32) -> Self {
        Self {
            rss_mib: f64::from(figure(process, "VmRSS")) / 1024.0,
            own_mib: f64::from(figure(process, "RssAnon")) / 1024.0,
            files: fs::read_dir(format!("/proc/{process}/fd")).unwrap().count(),
            threads: figure(process, "Threads"),
        }
    }
}

/// Peak resident memory of a process \[MiB\].
pub(crate) fn peak_mib(process: u32) -> f64 {
    f64::from(figure(process, "VmHWM")) / 1024.0
}

fn figure(process: u32, key: &str) -> u32 {
    status_of(process, key).parse().unwrap()
}

/// Memory of the allocator of a process, reported by `heap.c`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Heap {
    /// Allocated and not freed \[MiB\]; a leak increases it.
    pub(crate) live_mib: f64,
    /// Freed, and kept by the allocator for later requests \[MiB\].
    pub(crate) free_mib: f64,
}

impl Heap {
    /// Reads the report of a process; `None` before the file exists.
    pub(crate) fn read(file: &Path) -> Option<Self> {
        let text = fs::read_to_string(file).ok()?;
        let mut mib = text.split_whitespace().map_while(|bytes| Some(bytes.parse::<f64>().ok()? / f64::from(1 << 20)));
        Some(Self { live_mib: mib.next()?, free_mib: mib.next()? })
    }
}

/// Size of the file whose name is that of the database and a suffix \[MiB\]; 0 if it does not exist. The database may
/// be a symbolic link.
pub(crate) fn file_mib(database: &Path, suffix: &str) -> f64 {
    let mut file = fs::canonicalize(database).unwrap().into_os_string();
    file.push(suffix);
    fs::metadata(file).map_or(0.0, |file| file.len() as f64 / f64::from(1 << 20))
}

/// Status of the daemon; `None` if it does not reply in time.
pub(crate) async fn status(session: &Session) -> Option<StatusReport> {
    let replies = bus::ask(session, "points/v1/*/monitor/*/status", None, Duration::from_secs(5)).await.ok()?;
    serde_json::from_slice(&replies.messages.first()?.1).ok()
}
