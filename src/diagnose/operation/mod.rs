//! Alarms about the operation, not about a part: incomplete, slow and lost throws, silence, clocks of loggers, two
//! loggers for one machine, thermometers, and the weather of a site.

pub(super) mod alarms;
pub(super) mod boots;
mod logger_clock;
pub(super) mod site;
mod thermometer;

pub(super) use alarms::Operation;
pub(super) use boots::Boots;
pub(super) use logger_clock::LoggerClock;
pub(super) use thermometer::{Implausible, Thermometer};
