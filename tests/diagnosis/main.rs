//! The diagnosis: causes, alarms, restarts, the scored table.

#![expect(clippy::unwrap_used, reason = "a test may stop on an error, in its helpers too")]

mod alarm;
mod budget;
mod cause;
mod circuit;
mod climate;
mod degenerate;
mod drive;
mod end;
mod evaluate;
mod features;
mod filling;
mod fleet;
mod hard;
mod instruments;
mod intermittent;
mod loaded;
mod logger;
mod maintenance;
mod memory;
mod open;
mod operational;
mod pairs;
mod rails;
mod ramps;
mod recordings;
mod replay;
mod restart;
mod series;
mod sides;
mod site;
mod slow_loggers;
mod snapshot;
mod start;
mod stroke;
mod table1_lives;
mod weather;
