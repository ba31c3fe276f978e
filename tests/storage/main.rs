//! The database: migrations, views, failures of disk and power.

mod commands;
mod full_disk;
mod given;
mod judging;
mod keeping;
mod power;
mod spooling;
mod statements;
