//! The commands of `pointsd` and `pointsim`. One file a command; `pointsd.rs` and `pointsim.rs` hold the command lines.

mod backup;
mod database;
mod evaluate;
mod exit;
mod identify;
mod pointsd;
mod pointsim;
mod recording;
mod sql;
mod table1;
mod throw;

pub use exit::{Exit, Failure, Outcome, ResultExt};

/// Runs `pointsd` with the process's arguments and returns its exit code.
#[must_use]
pub fn pointsd() -> std::process::ExitCode {
    exit::finish(pointsd::main())
}

/// Runs `pointsim` with the process's arguments and returns its exit code.
#[must_use]
pub fn pointsim() -> std::process::ExitCode {
    exit::finish(pointsim::main())
}
