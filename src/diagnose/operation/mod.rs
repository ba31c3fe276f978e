//! Alarms about the operation, not about a part: incomplete, slow and lost throws, silence, clocks of loggers, two
//! loggers for one machine, thermometers, and the weather of a site.

pub(super) mod alarms;
pub(super) mod boots;
pub(super) mod logger_clock;
pub(super) mod site;
pub(super) mod thermometer;
