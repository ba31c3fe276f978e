//! The database: migrations, views, failures of disk and power.

#![expect(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a failure here fails the test")]

mod commands;
mod files;
mod full_disk;
mod given;
mod judging;
mod keeping;
mod power;
mod salvage;
#[path = "../support/small_disk.rs"]
mod small_disk;

mod spooling;
mod statements;
mod takeover;
