//! The throws stored last, in memory: the judge loop gets most throws from here, without reading and decompressing
//! their traces.

use std::{collections::BTreeMap, sync::Arc};

use parking_lot::Mutex;

use super::rows::ThrowRow;
use crate::throw::Throw;

/// Largest number of samples, of both channels together: 32 MiB, or 400 throws of 5 s at 1 kHz.
const MAX_SAMPLES: usize = 4 << 20;

/// A throw more than this many rows older than the newest is dropped from memory: if it is still to be judged, it is
/// read from the database.
const STALE: i64 = 10_000;

/// Pending throws up to a total size. Cheap to clone.
#[derive(Debug, Clone, Default)]
pub(super) struct RecentThrows(Arc<Mutex<Kept>>);

#[derive(Debug, Default)]
struct Kept {
    throws: BTreeMap<ThrowRow, Throw>,
    samples: usize,
}

impl RecentThrows {
    /// Adds a stored throw if there is space. If there is none, many throws are pending: the new throw is read from the
    /// database when its turn comes. A throw that retention deletes is never judged, so the oldest throw is dropped at
    /// a distance of [`STALE`] rows.
    pub(super) fn keep(&self, row: ThrowRow, throw: &Throw) {
        let mut kept = self.0.lock();
        if let Some(oldest) = kept.throws.first_entry().filter(|oldest| row.0 - oldest.key().0 > STALE) {
            let stale = oldest.remove();
            kept.samples -= 2 * stale.trace.len();
        }
        let samples = 2 * throw.trace.len();
        if kept.samples + samples <= MAX_SAMPLES && kept.throws.insert(row, throw.clone()).is_none() {
            kept.samples += samples;
        }
    }

    /// Removes and returns a throw.
    pub(super) fn take(&self, row: ThrowRow) -> Option<Throw> {
        let mut kept = self.0.lock();
        let throw = kept.throws.remove(&row)?;
        kept.samples -= 2 * throw.trace.len();
        Some(throw)
    }
}
