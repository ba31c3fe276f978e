//! Identification on a bounded number of blocking threads; the results are in the order of the throws.

use tokio::task;

use crate::{
    estimate::{Identification, Identifier, Settings},
    throw::Throw,
};

/// Largest number of threads if the configuration does not set it.
const MOST_THREADS: usize = 8;

/// The identifiers that no thread uses now, one for each thread. Each keeps its buffers.
pub(crate) struct Pool {
    idle: Vec<Identifier>,
}

impl Pool {
    /// A pool for `threads` threads; 0 means the number of processors, at most [`MOST_THREADS`].
    pub(crate) fn new(threads: usize) -> Self {
        let available = || std::thread::available_parallelism().map_or(1, usize::from).min(MOST_THREADS);
        let threads = if threads == 0 { available() } else { threads };
        Self { idle: (0..threads).map(|_| Identifier::default()).collect() }
    }

    /// Identifies each throw with the settings of its machine. `None` for a throw that makes the estimator panic: such a defect must not block other
    /// throws.
    pub(crate) async fn identify(&mut self, throws: Vec<(Throw, Settings)>) -> Vec<Option<Identification>> {
        let threads = self.idle.len().max(1);
        let share = throws.len().div_ceil(threads).max(1);
        let mut throws = throws.into_iter();
        let mut running = Vec::with_capacity(threads);
        loop {
            let part: Vec<_> = throws.by_ref().take(share).collect();
            if part.is_empty() {
                break;
            }
            let mut identifier = self.idle.pop().unwrap_or_default();
            running.push(task::spawn_blocking(move || {
                let found = part.iter().map(|throw| guarded(&mut identifier, throw)).collect::<Vec<_>>();
                (identifier, found)
            }));
        }
        let mut all = Vec::new();
        for part in running {
            // Fails only when the runtime shuts down: `guarded` catches panics, and nothing else cancels the task.
            let Ok((identifier, found)) = part.await else { return all };
            self.idle.push(identifier);
            all.extend(found);
        }
        self.idle.resize_with(threads, Identifier::default);
        all
    }
}

/// Identifies a throw; `None` after a panic.
fn guarded(identifier: &mut Identifier, (throw, settings): &(Throw, Settings)) -> Option<Identification> {
    let attempt = std::panic::AssertUnwindSafe(|| identifier.identify(throw, settings));
    let found = std::panic::catch_unwind(attempt).ok();
    if found.is_none() {
        // After a panic the buffers may be inconsistent.
        *identifier = Identifier::default();
    }
    found
}
