//! Identification on a bounded number of blocking threads; the results are in the order of the throws.

use tokio::task;

use crate::{
    estimate::{Identification, Identifier, Settings},
    throw::Throw,
};

/// Largest number of threads if the configuration does not set it.
const MOST_THREADS: usize = 8;

/// The number of threads; `configured` is 0 for the number of processors, at most [`MOST_THREADS`].
pub(crate) fn threads(configured: usize) -> usize {
    match configured {
        0 => std::thread::available_parallelism().map_or(1, usize::from).min(MOST_THREADS),
        _ => configured,
    }
}

/// Identifies each throw with the settings of its machine, on at most `threads` threads. `None` for a throw that makes
/// the estimator panic: such a defect must not block other throws.
pub(crate) async fn identify(threads: usize, throws: Vec<(Throw, Settings)>) -> Vec<Option<Identification>> {
    let share = throws.len().div_ceil(threads).max(1);
    let mut throws = throws.into_iter();
    let mut running = Vec::with_capacity(threads);
    loop {
        let part: Vec<_> = throws.by_ref().take(share).collect();
        if part.is_empty() {
            break;
        }
        running.push(task::spawn_blocking(move || {
            let mut identifier = Identifier::default();
            part.iter().map(|throw| guarded(&mut identifier, throw)).collect::<Vec<_>>()
        }));
    }
    let mut all = Vec::new();
    for part in running {
        // Fails only when the runtime shuts down: `guarded` catches panics, and nothing else cancels the task.
        let Ok(found) = part.await else { return all };
        all.extend(found);
    }
    all
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
