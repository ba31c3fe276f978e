//! The commands of `pointsd` and `pointsim`. Each command has a file or a folder; `pointsd.rs` and `pointsim.rs` have
//! the command lines.

mod alarms;
mod argument;
mod backup;
mod check;
mod commands;
mod completions;
mod database;
mod demo;
mod evaluate;
mod exit;
mod export;
mod identify;
mod import;
mod limits;
mod load;
mod man;
mod operator;
mod output;
mod pointsd;
mod pointsim;
mod recording;
mod replay;
mod report;
mod run;
mod runtime;
mod simulate_run;
mod sql;
mod status;
mod table1;
mod terminal;
mod throw;

use exit::{COMMON_CODES, Exit, Failure, Outcome, ResultExt};

/// Runs `pointsd` with the arguments of the process and returns the exit code.
pub fn pointsd() -> std::process::ExitCode {
    exit::finish(exit::parse().map_or_else(Ok, pointsd::main))
}

/// Runs `pointsim` with the arguments of the process and returns the exit code.
pub fn pointsim() -> std::process::ExitCode {
    exit::finish(exit::parse().map_or_else(Ok, pointsim::main))
}
