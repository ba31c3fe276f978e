//! The daemon: pipeline, supervision, configuration.
//!
//! ```text
//! zenoh -> receive -> store (committed) -> judge: identify, diagnose, commit -> publish -> zenoh
//!                                            ^ operators' commands, ticks
//! ```
//! Each loop is a task. The queues between the loops are bounded channels, or tables of the database. Every task is
//! needed, so the end of any task ends the daemon.

mod answer;
mod backlog;
mod budget;
pub(crate) mod clock;
mod commands;
pub mod config;
mod error;
mod fleet;
mod health;
mod heartbeat;
mod identify;
mod judge;
mod judge_loop;
mod lock;
mod logger_clocks;
mod offline;
mod peers;
mod presence;
mod publish;
mod receive;
mod retention;
mod running;
mod schedule;
mod status;
mod stop;
mod tasks;
mod watchdog;
mod webhook;

pub use error::StartError;
pub(crate) use heartbeat::TaskName;
pub use judge::Judged;
pub use lock::LockError;
pub use offline::Offline;
pub use running::{DATABASE, Daemon, View};
pub use status::{FleetCounts, StatusReport};
