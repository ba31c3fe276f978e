//! The diagnosis: causes, alarms, restarts, the scored table.

#![expect(clippy::unwrap_used, reason = "a test may stop on an error, in its helpers too")]

mod alarm;
mod cause;
mod evaluate;
mod filling;
mod fleet;
mod hard;
mod operational;
mod replay;
mod restart;
mod table1_lives;
