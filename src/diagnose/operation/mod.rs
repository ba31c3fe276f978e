//! Alarms about the operation, not about a part: incomplete, slow and lost throws, silence, clocks of loggers, two
//! loggers for one machine, thermometers, and the weather of a site.

mod alarms;
pub(super) mod boots;
mod logger;
mod logger_clock;
mod run_on;
mod sensors;
pub(super) mod site;
mod thermometer;

pub(super) use alarms::{Operation, not_monitored};
pub(super) use boots::Boots;
pub(super) use logger::on_peers;

use self::alarms::{Logger, is_silence, unix_s};
pub(super) use logger_clock::LoggerClock;
pub(crate) use logger_clock::{are_steady, is_possible_date};
pub use site::Common;
pub(super) use site::Trail;
pub(super) use thermometer::{Implausible, Thermometer};
