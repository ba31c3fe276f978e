//! The rows that retention drops, by kind, and their numbers since the start.

use std::collections::BTreeMap;

use parking_lot::Mutex;
use strum::VariantArray as _;

use super::rate_limit::RecentCount;

/// Kind of rows that were dropped to keep the database within its bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, strum::AsRefStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum Dropped {
    /// Traces.
    Traces,
    /// Judged throws with their estimates.
    Throws,
    /// Pending throws, which were never judged.
    PendingThrows,
    /// Closed alarms with their events.
    Alarms,
    /// The oldest messages of the outbox: alarm events that were never published.
    Messages,
    /// Alarm events that the webhook had not accepted. A trigger of the database drops them.
    Notifications,
    /// Unused pages of the file, returned to a disk with little space.
    Pages,
}

impl Dropped {
    /// Name of the counter in the database. A trigger counts `dropped_notifications`.
    pub fn counter(self) -> String {
        format!("dropped_{}", self.as_ref())
    }
}

/// The rows dropped since the start of the daemon.
#[derive(Debug, Default)]
pub(crate) struct DropCounts {
    /// The counters of the database at the last call of `note`.
    counters: Mutex<Option<BTreeMap<String, u64>>>,
    since_start: [RecentCount; Dropped::VARIANTS.len()],
}

impl DropCounts {
    /// Adds the increase of the counters of the database. At the first call there is no increase: those rows were
    /// dropped before this start.
    pub(super) fn note(&self, now: &BTreeMap<String, u64>) {
        let before = self.counters.lock().replace(now.clone()).unwrap_or_else(|| now.clone());
        for (what, count) in Dropped::VARIANTS.iter().zip(&self.since_start) {
            let of = |counters: &BTreeMap<String, u64>| counters.get(&what.counter()).copied().unwrap_or(0);
            if of(now) > of(&before) {
                count.add(of(now) - of(&before));
            }
        }
    }

    /// Number of dropped rows since the start; `None` if it did not grow in the last hour.
    pub(crate) fn recent(&self, what: Dropped) -> Option<u64> {
        self.since_start[what as usize].shown()
    }
}
