//! Condition monitoring of railway point machines: identifies the physical parameters of every throw, and names the
//! part that wears.
//!
//! The crate has a pure core and a thin shell. The core is functions of values, without runtime, network, database,
//! clock or random source. The shell does the I/O and calls the core.
//!
//! | module | contents | may use |
//! |---|---|---|
//! | [`throw`] | one movement of the points and its recorded trace | |
//! | [`estimate`] | SRIV: from a trace to b0, a1, a0 with their covariance | `throw` |
//! | [`diagnose`] | from the history of estimates to one named cause | `estimate`, `throw` |
//! | [`simulate`] | the simulated point machine and fleets of them | `throw` |
//! | [`evaluate`] | scores the diagnosis on simulated fleets | all of the core |
//! | [`report`] | pictures as SVG | |
//! | [`wire`] | keys and payloads on zenoh | the core |
//! | [`store`] | the SQLite database | core, `wire` |
//! | [`bus`] | zenoh sessions, publishers, subscribers, queries | core, `wire` |
//! | [`logger`] | the device at the machine that publishes its throws, with simulated machines behind it | core, `wire`, `bus`, the daemon's clock |
//! | [`daemon`] | the running monitor: pipeline, supervision, configuration | everything above |
//! | [`web`] | the dashboard with its commands, and the metrics | core, `store`, `daemon` |
//! | [`cli`] | the commands of `pointsd` and `pointsim` | everything above |

#![warn(
    clippy::print_stderr,
    clippy::print_stdout,
    reason = "they panic when the stream cannot be written: use cli::output and cli::terminal"
)]

pub mod bus;
pub mod cli;
pub mod daemon;
pub mod diagnose;
pub mod estimate;
pub mod evaluate;
pub mod logger;
pub mod report;
pub mod simulate;
pub mod store;
pub mod throw;
pub mod web;
pub mod wire;
