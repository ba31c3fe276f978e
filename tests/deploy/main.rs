//! Tests of the files in `deploy/`: systemd units, documents, and the zenoh configurations with attacks over TLS on
//! loopback.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::disallowed_methods,
    reason = "helpers of tests outside #[test]"
)]

mod access;
#[path = "../support/cable.rs"]
mod cable;
mod central;
mod daemon;
mod documents;
#[path = "../support/rig.rs"]
mod rig;
mod shipped;
mod site;
mod units;
