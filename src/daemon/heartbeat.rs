//! Heartbeats of the four essential loops: receive, identify, write, publish.

use std::{
    sync::atomic::{AtomicU64, Ordering::Relaxed},
    time::{Duration, Instant},
};

use strum::VariantArray;

use super::clock;

/// Age of a heartbeat from which a loop hangs. The longest waits are 5 s for a stalled link in zenoh, 10 s for a query,
/// and the identification of 16 of the longest traces.
const FRESH: Duration = Duration::from_secs(30);

/// A loop with a heartbeat.
#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::AsRefStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum TaskName {
    /// Receives and stores messages.
    Receive,
    /// Identifies and diagnoses.
    Identify,
    /// The writer of the database.
    Write,
    /// Publishes the outbox.
    Publish,
}

/// The time of the last beat of each loop.
#[derive(Debug)]
pub struct Heartbeats {
    start: Instant,
    last_ms: [AtomicU64; TaskName::VARIANTS.len()],
}

impl Heartbeats {
    /// Heartbeats of all loops, fresh now.
    #[must_use]
    pub fn new() -> Self {
        Self { start: clock::monotonic(), last_ms: [const { AtomicU64::new(0) }; TaskName::VARIANTS.len()] }
    }

    /// Records a heartbeat.
    pub fn beat(&self, task: TaskName) {
        self.last_ms[task as usize].store(self.elapsed_ms(), Relaxed);
    }

    /// Loops without a fresh heartbeat.
    #[must_use]
    pub fn silent(&self) -> Vec<TaskName> {
        let now = self.elapsed_ms();
        let silent = |task: &TaskName| {
            let age = now.saturating_sub(self.last_ms[*task as usize].load(Relaxed));
            Duration::from_millis(age) > FRESH
        };
        TaskName::VARIANTS.iter().copied().filter(silent).collect()
    }

    fn elapsed_ms(&self) -> u64 {
        u64::try_from(clock::monotonic().duration_since(self.start).as_millis()).unwrap_or(u64::MAX)
    }
}

impl Default for Heartbeats {
    fn default() -> Self {
        Self::new()
    }
}
