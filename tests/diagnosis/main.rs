//! The diagnosis: causes, alarms, restarts, the scored table.

mod cause;
mod evaluate;
mod fleet;
mod table1_lives;
