//! Power cuts, and disks that fail.
//!
//! A worker process fills a database while a preloaded shim logs every write and sync, or makes some of them fail. The
//! power-cut test reconstructs the disk after a cut at any point of the log, with unsynced data dropped, kept or torn,
//! and opens the database. `POINTSD_CUTS` and `POINTSD_FAULTS` set the number of runs.

mod cuts;
mod faults;
#[path = "../../support/replay.rs"]
mod replay;
#[path = "../../support/shim.rs"]
mod shim;
#[path = "../../support/verdict.rs"]
mod verdict;
mod worker;

use std::path::Path;

use crate::given::throw;
use verdict::Verdict;

/// Compares the database in `folder` with the acknowledgements of the worker.
async fn inspect(folder: &Path, acknowledged: &str, verdict: &mut Verdict) {
    verdict::inspect(folder, acknowledged, |id| throw(&id.boot_id, id.throw_no).trace, verdict).await;
}
