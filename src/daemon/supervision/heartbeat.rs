//! Heartbeats of the essential loops: receive, identify, write, publish, and the webhook if there is one.

use std::{
    sync::atomic::{AtomicU64, Ordering::Relaxed},
    time::{Duration, Instant},
};

use strum::VariantArray;

use crate::daemon::clock;

/// Age of the last heartbeat above which a loop counts as hanging. The longest regular waits are 5 s for a stalled link
/// in zenoh, 10 s for a query, and one batch of the judge: 256 throws or 2 million samples.
const FRESH: Duration = Duration::from_secs(30);

/// A loop with a heartbeat.
#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::AsRefStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub(crate) enum TaskName {
    /// Receives and stores messages.
    Receive,
    /// Identifies and diagnoses.
    Identify,
    /// The writer of the database.
    Write,
    /// Publishes the outbox.
    Publish,
    /// Sends alarm events to the webhook. This loop may not exist: it is observed from its first heartbeat.
    Webhook,
}

/// The time of the last beat of each loop.
#[derive(Debug)]
pub(crate) struct Heartbeats {
    start: Instant,
    last_ms: [AtomicU64; TaskName::VARIANTS.len()],
}

/// All loops count as fresh at the start.
impl Default for Heartbeats {
    fn default() -> Self {
        let beats = Self { start: clock::monotonic(), last_ms: Default::default() };
        // A time in the future never becomes too old: without a webhook its loop gives no heartbeat.
        beats.last_ms[TaskName::Webhook as usize].store(u64::MAX, Relaxed);
        beats
    }
}

impl Heartbeats {
    /// Records a heartbeat of a loop.
    pub(crate) fn beat(&self, task: TaskName) {
        self.last_ms[task as usize].store(self.elapsed_ms(), Relaxed);
    }

    /// Loops without a fresh heartbeat. Empty while a copy of the database makes progress: the loops then wait for the
    /// writer.
    pub(crate) fn silent(&self, is_copying: bool) -> Vec<TaskName> {
        let now = self.elapsed_ms();
        let silent = |task: &TaskName| {
            let age = now.saturating_sub(self.last_ms[*task as usize].load(Relaxed));
            Duration::from_millis(age) > FRESH
        };
        TaskName::VARIANTS.iter().copied().filter(|task| !is_copying && silent(task)).collect()
    }

    /// Time since the start.
    pub(super) fn uptime(&self) -> Duration {
        self.start.elapsed()
    }

    fn elapsed_ms(&self) -> u64 {
        u64::try_from(self.uptime().as_millis()).unwrap_or(u64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_hangs_without_beats_and_the_webhook_only_after_its_first() {
        let mut beats = Heartbeats::default();
        beats.start -= 2 * FRESH;
        assert_eq!(beats.silent(false), [TaskName::Receive, TaskName::Identify, TaskName::Write, TaskName::Publish]);
        for task in TaskName::VARIANTS {
            beats.beat(*task);
        }
        assert_eq!(beats.silent(false), []);
        beats.start -= 2 * FRESH;
        assert_eq!(beats.silent(false), TaskName::VARIANTS);
        assert_eq!(beats.silent(true), []);
    }
}
