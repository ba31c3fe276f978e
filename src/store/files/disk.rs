//! The disk of the database: free space, and the ballast file, which is removed when the disk is full.

use std::{
    fs::File,
    io::{self, Read as _},
    path::{Path, PathBuf},
    time::Duration,
};

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use tokio::time::Instant;

use super::path::{beside, folder_of};
use crate::store::{error::StoreError, rate_limit::SHOWN, settings::MIB};

/// A copy of the database hangs if it makes no step for this time, which is also the longest time of a loop without a
/// heartbeat. A step is some hundred rows, which take at most some seconds to read from flash.
const COPY_HANGS: Duration = Duration::from_secs(30);
/// Time after a copy in which the loops that waited for it show a heartbeat again.
const AFTER_COPY: Duration = Duration::from_secs(5);

/// State of the disk of the database. The status shows it as `ok`, `low`, `full` or `failing`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, strum::AsRefStr, strum::VariantArray)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum DiskLevel {
    /// Enough space.
    #[default]
    #[serde(rename = "ok")]
    #[strum(serialize = "ok")]
    Ample,
    /// Less free space than `low_disk_mib` of the settings: the oldest traces are dropped.
    Low,
    /// The last write found the disk full, and removed the ballast. The next write may fail.
    Full,
    /// The last write failed for another reason.
    Failing,
}

/// Outcome after the database file was found deleted or replaced during operation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Replaced {
    /// The database was written again. Has the new path of the file that was found in its place; `None` if the database
    /// or its log was deleted.
    WrittenAgain(Option<PathBuf>),
    /// The database could not be written again.
    Failed,
}

/// Measures the free space and owns the ballast file.
#[derive(Debug, Default)]
pub(crate) struct Disk {
    database: PathBuf,
    ballast: PathBuf,
    ballast_bytes: u64,
    low_bytes: u64,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// [`DiskLevel::Full`] or [`DiskLevel::Failing`] if the last write failed.
    last_write: Option<DiskLevel>,
    /// Whether the disk was full since the last call of `worst_level`.
    was_full: bool,
    failures: u64,
    /// The last outcome, with its time.
    replaced: Option<(Replaced, Instant)>,
    /// Until this time a copy of the database counts as running: the writer stores nothing else. `None` without a copy.
    copies_until: Option<Instant>,
}

impl Disk {
    pub(crate) fn new(database: &Path, ballast_mib: u64, low_disk_mib: u64) -> Self {
        Self {
            database: database.to_owned(),
            ballast: beside(database, "-ballast"),
            ballast_bytes: ballast_mib * MIB,
            low_bytes: low_disk_mib * MIB,
            ..Self::default()
        }
    }

    /// Free space for an unprivileged process, and size of the disk \[bytes\]; `None` if unknown.
    fn space(&self) -> Option<(u64, u64)> {
        let space = rustix::fs::statvfs(folder_of(&self.database)).ok()?;
        let bytes = |blocks: u64| blocks.saturating_mul(space.f_frsize);
        Some((bytes(space.f_bavail), bytes(space.f_blocks)))
    }

    /// Free space for an unprivileged process \[bytes\]; `None` if unknown.
    pub(crate) fn free_bytes(&self) -> Option<u64> {
        self.space().map(|(free, _)| free)
    }

    pub(crate) fn note_success(&self) {
        self.state.lock().last_write = None;
    }

    /// Records a failed write; removes the ballast if the disk was full.
    pub(crate) fn note_failure(&self, full: bool) {
        let mut state = self.state.lock();
        state.failures += 1;
        state.was_full |= full;
        state.last_write = Some(if full { DiskLevel::Full } else { DiskLevel::Failing });
        drop(state);
        if full {
            self.release_ballast();
        }
    }

    /// Records that the database file was deleted or replaced.
    pub(crate) fn note_replaced(&self, outcome: Replaced) {
        self.state.lock().replaced = Some((outcome, Instant::now()));
    }

    /// The outcome after the database file was deleted or replaced; after a success only for an hour.
    pub(crate) fn replaced(&self) -> Option<Replaced> {
        let (outcome, at) = self.state.lock().replaced.clone()?;
        (outcome == Replaced::Failed || at.elapsed() < SHOWN).then_some(outcome)
    }

    /// Records a step of a copy of the database.
    pub(crate) fn note_copying(&self) {
        self.state.lock().copies_until = Some(Instant::now() + COPY_HANGS);
    }

    /// Records the end of a copy of the database. It counts as running until the loops that waited for it work again.
    pub(crate) fn end_copying(&self) {
        self.state.lock().copies_until = Some(Instant::now() + AFTER_COPY);
    }

    /// Whether a copy of the database made progress in the last 30 s, or ended in the last 5 s.
    pub(crate) fn is_copying(&self) -> bool {
        self.state.lock().copies_until.is_some_and(|until| Instant::now() < until)
    }

    /// Failed write transactions since the start.
    pub(crate) fn failures(&self) -> u64 {
        self.state.lock().failures
    }

    pub(crate) fn level(&self) -> DiskLevel {
        let last_write = self.state.lock().last_write;
        let is_low = || self.free_bytes().is_some_and(|free| free < self.low_bytes);
        last_write.unwrap_or_else(|| if is_low() { DiskLevel::Low } else { DiskLevel::Ample })
    }

    /// The level, or [`DiskLevel::Full`] if the disk was full since the last call. A write that finds the disk full
    /// removes the ballast and then succeeds, so [`Self::level`] alone would never show a full disk.
    pub(crate) fn worst_level(&self) -> DiskLevel {
        if std::mem::take(&mut self.state.lock().was_full) { DiskLevel::Full } else { self.level() }
    }

    fn release_ballast(&self) {
        match std::fs::remove_file(&self.ballast) {
            Ok(()) => tracing::error!(ballast = %self.ballast.display(), "the disk is full: ballast removed"),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => tracing::error!(%error, ballast = %self.ballast.display(), "removing the ballast failed"),
        }
    }

    /// Creates the ballast if there is enough space. Removes that of an earlier start if the ballast is switched off.
    pub(crate) fn restore_ballast(&self) -> Result<(), StoreError> {
        if self.ballast_bytes == 0 {
            return super::remove_one(&self.ballast);
        }
        let Some((free, whole)) = self.space() else { return Ok(()) };
        // A small disk gets a small ballast: without any ballast the alarm about the full disk could not be committed.
        let bytes = self.ballast_bytes.min(whole / 8);
        let exists = std::fs::metadata(&self.ballast).is_ok_and(|file| file.len() == bytes);
        if bytes == 0 || exists || free <= self.low_bytes.min(whole / 4) + 2 * bytes {
            return Ok(());
        }
        self.allocate(bytes).map_err(StoreError::file("preallocate", &self.ballast))
    }

    fn allocate(&self, bytes: u64) -> io::Result<()> {
        let file = File::create(&self.ballast)?;
        let allocated = match rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, bytes) {
            // Some file systems cannot preallocate.
            Err(rustix::io::Errno::OPNOTSUPP) => io::copy(&mut io::repeat(0).take(bytes), &mut &file).map(drop),
            allocated => allocated.map_err(io::Error::from),
        };
        allocated.and_then(|()| file.sync_all()).inspect_err(|_| {
            // A second error is ignored. The unfinished file is removed, so that the next call tries again.
            let _ = std::fs::remove_file(&self.ballast);
        })
    }
}
