//! Endurance of the running daemon: power cuts, kills, failing and full disks, clock jumps. Short by default; the
//! README has the variables for long runs.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::disallowed_methods,
    reason = "helpers of tests outside #[test]"
)]

mod cable;
mod database;
mod gauge;
mod logger;
#[path = "../disk/replay.rs"]
mod replay;
#[path = "../service/rig.rs"]
mod rig;
#[path = "../disk/shim.rs"]
mod shim;
#[path = "../disk/small_disk.rs"]
mod small_disk;
#[path = "../disk/verdict.rs"]
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
