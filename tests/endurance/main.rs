//! Endurance of the running daemon: power cuts, kills, failing and full disks, clock jumps. Short by default; the
//! README has the variables for long runs.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::disallowed_methods,
    reason = "helpers of tests outside #[test]"
)]

#[path = "../support/cable.rs"]
mod cable;
mod database;
mod gauge;
#[path = "../support/json.rs"]
mod json;
mod logger;
#[path = "../support/replay.rs"]
mod replay;
#[path = "../support/rig.rs"]
mod rig;
#[path = "../support/shim.rs"]
mod shim;
#[path = "../support/small_disk.rs"]
mod small_disk;
#[path = "../support/verdict.rs"]
mod verdict;
mod witness;

mod backlogs;
mod clock;
mod cuts;
mod faults;
mod flood;
mod full_disk;
mod kills;
mod links;
mod poison;
mod retention;
mod slow;
mod soak;
