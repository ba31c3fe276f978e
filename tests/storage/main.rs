//! The database: migrations, views, failures of disk and power.

mod given;
mod judging;
mod keeping;
mod power;
mod spooling;
mod statements;
