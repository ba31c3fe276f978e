//! Heartbeats of the four loops that must live: receive, identify, write, publish.

use std::{
    sync::atomic::{AtomicU64, Ordering::Relaxed},
    time::{Duration, Instant},
};

use super::clock;

/// A loop whose last beat is older than this hangs. The longest thing that any of them waits for is a link that zenoh
/// gives up after 5 s, a query of 10 s, or the identification of 16 of the longest traces.
const FRESH: Duration = Duration::from_secs(30);

/// What must beat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Organ {
    /// Takes messages in and hands them to the database.
    Receive,
    /// Identifies and diagnoses.
    Identify,
    /// The database's writer answers.
    Write,
    /// Publishes.
    Publish,
}

impl Organ {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Receive, Self::Identify, Self::Write, Self::Publish];

    /// Its name, for people.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Receive => "receive",
            Self::Identify => "identify",
            Self::Write => "write",
            Self::Publish => "publish",
        }
    }
}

/// The last beat of each.
#[derive(Debug)]
pub struct Heartbeats {
    start: Instant,
    last_ms: [AtomicU64; Organ::ALL.len()],
}

impl Heartbeats {
    /// All beat now.
    #[must_use]
    pub fn new() -> Self {
        Self { start: clock::monotonic(), last_ms: [const { AtomicU64::new(0) }; Organ::ALL.len()] }
    }

    /// It lives.
    pub fn beat(&self, organ: Organ) {
        self.last_ms[organ as usize].store(self.elapsed_ms(), Relaxed);
    }

    /// Those that have not beaten for too long.
    #[must_use]
    pub fn silent(&self) -> Vec<Organ> {
        let now = self.elapsed_ms();
        let silent = |organ: &Organ| {
            let age = now.saturating_sub(self.last_ms[*organ as usize].load(Relaxed));
            Duration::from_millis(age) > FRESH
        };
        Organ::ALL.into_iter().filter(silent).collect()
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
