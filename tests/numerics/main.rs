//! The estimator and the simulated machine against known answers.

#![expect(clippy::unwrap_used, reason = "a test may stop on an error, in its helpers too")]

mod allocations;
mod beam;
mod clutch;
mod commands;
mod covariance;
mod current_only;
mod damaged;
mod emps;
mod features;
mod fleet;
mod identify;
mod identify_cli;
#[path = "../support/json.rs"]
mod json;
mod limits;
mod machine;
mod mains;
mod mutated;
mod refined;
mod rest;
mod rough;
mod sriv;
mod strange;
mod table1;
mod two_masses;
