//! Heartbeats of the essential loops: receive, identify, write, publish, and the webhook if there is one.

use std::time::{Duration, Instant};

use parking_lot::Mutex;
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
    /// `None` for a loop that is not observed yet.
    last: Mutex<[Option<Instant>; TaskName::VARIANTS.len()]>,
}

/// All loops count as fresh at the start.
impl Default for Heartbeats {
    fn default() -> Self {
        let start = clock::monotonic();
        let mut last = [Some(start); TaskName::VARIANTS.len()];
        last[TaskName::Webhook as usize] = None;
        Self { start, last: Mutex::new(last) }
    }
}

impl Heartbeats {
    /// Records a heartbeat of a loop.
    pub(crate) fn beat(&self, task: TaskName) {
        self.last.lock()[task as usize] = Some(clock::monotonic());
    }

    /// Loops without a fresh heartbeat. Empty while a copy of the database makes progress: the loops then wait for the
    /// writer.
    pub(crate) fn silent(&self, is_copying: bool) -> Vec<TaskName> {
        let last = *self.last.lock();
        let is_silent = |task: &TaskName| last[*task as usize].is_some_and(|last| last.elapsed() > FRESH);
        TaskName::VARIANTS.iter().copied().filter(|task| !is_copying && is_silent(task)).collect()
    }

    /// Time since the start.
    pub(crate) fn uptime(&self) -> Duration {
        self.start.elapsed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_hangs_without_beats_and_the_webhook_only_after_its_first() {
        let beats = Heartbeats::default();
        let wait = || beats.last.lock().iter_mut().flatten().for_each(|last| *last -= 2 * FRESH);
        wait();
        assert_eq!(beats.silent(false), [TaskName::Receive, TaskName::Identify, TaskName::Write, TaskName::Publish]);
        for task in TaskName::VARIANTS {
            beats.beat(*task);
        }
        assert_eq!(beats.silent(false), []);
        wait();
        assert_eq!(beats.silent(false), TaskName::VARIANTS);
        assert_eq!(beats.silent(true), []);
    }
}
