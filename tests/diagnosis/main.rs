//! The diagnosis: causes, alarms, restarts, the scored table.

mod alarm;
mod cause;
mod evaluate;
mod fleet;
mod hard;
mod operational;
mod replay;
mod restart;
mod table1_lives;
