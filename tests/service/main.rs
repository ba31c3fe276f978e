//! The real programs over loopback: daemon, logger, operators, foreign clients.

#![expect(clippy::unwrap_used, clippy::panic, clippy::disallowed_methods, reason = "helpers of tests outside #[test]")]

mod alarms;
mod backlogs;
mod browser;
#[path = "../support/cable.rs"]
mod cable;
mod clients;
mod configuration;
#[path = "../support/faketime.rs"]
mod faketime;
mod files;
mod http;
mod import;
#[path = "../support/json.rs"]
mod json;
mod loggers;
mod operators;
mod pages;
mod prometheus;
mod python;
mod questions;
mod region;
#[path = "../support/rig.rs"]
mod rig;
mod silence;
mod throws;
mod two_loggers;
mod web;
mod webhook;
