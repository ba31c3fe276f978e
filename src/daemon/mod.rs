//! The daemon: pipeline, supervision, configuration.
//!
//! ```text
//! zenoh -> receive -> store (committed) -> judge: identify, diagnose, commit -> publish -> zenoh
//!                                            ^ operators' commands, ticks
//! ```
//! Each loop is a task. The queues between the loops are bounded channels, or tables of the database. Every task is
//! needed, so the end of any task ends the daemon.
//!
//! | module | contents |
//! |---|---|
//! | `receive` | receives throws, and fetches missing ones from the backlogs of the loggers |
//! | `judge` | identifies and diagnoses the stored throws in their order; applies commands and ticks |
//! | `supervision` | heartbeats, watchdog, lock, presence of loggers and other daemons, and the status |
//! | `webhook` | sends alarm events to a web address |
//! | `config` | the configuration |
//! | `publish`, `answer` | publish alarms and health, and answer queries |
//! | `shared` | state that the loops share |

mod answer;
pub(crate) mod clock;
pub mod config;
mod error;
mod judge;
mod offline;
mod publish;
mod receive;
mod retention;
mod shared;
mod start;
mod stop;
mod supervision;
mod webhook;

pub use error::{StartError, StopError};
pub use offline::Offline;
pub use start::{DATABASE, Daemon, View};
pub(crate) use supervision::heartbeat::TaskName;
pub use supervision::status::{FleetCounts, StatusReport};
