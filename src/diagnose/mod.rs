//! The diagnosis: from the estimates of a machine to alarms with one named cause. It has no clock; time is a parameter.
//!
//! A [`MachineMonitor`] takes an [`Observation`] for each throw and returns a [`Verdict`].
//!
//! | module | contents |
//! |---|---|
//! | `monitor` | the monitor of a machine: which rule sees a throw, a command or a tick, and in which order |
//! | `track` | the throws of each direction: the last ones, and the ones from which the baseline is learned |
//! | `baseline` | level, scatter and temperature effect of a healthy machine; trend and rain while the baseline fills |
//! | `drift` | from the last throws to a drift, its cause, its size at this throw, its forecast and its alarms |
//! | `gauges` | further quantities of a throw; they distinguish a faulty sensor or supply from a faulty part |
//! | `operation` | alarms about no part: incomplete, slow and lost throws, silence, clocks, weather of the site |
//! | `alarm` | the life cycle of an alarm, and the commands of operators |
//! | `text` | the sentences that a person reads about an alarm |
//! | `statistics` | statistics of short series |
//! | `observation`, `verdict`, `event`, `settings`, `snapshot` | what a monitor takes, gives and stores |

mod alarm;
mod baseline;
mod drift;
mod event;
mod gauges;
mod monitor;
mod observation;
mod operation;
mod settings;
mod snapshot;
mod statistics;
mod text;
mod track;
mod verdict;

pub use alarm::{Command, CommandError};
pub use baseline::{BaselineRecord, TemperatureSource};
pub use drift::LimitForecast;
pub use event::{AlarmEvent, AlarmState, Away, Cause, RunnerUp, SensorChannel, Severity};
pub use monitor::MachineMonitor;
pub use observation::{Estimated, Irregularity, Missing, Observation, Parameters};
pub use operation::Common;
pub(crate) use operation::{are_steady, is_possible_date};
pub use settings::{LONGEST_SHELVING_DAYS, Settings, TemperatureCoefficients};
pub use statistics::Correlation;
pub(crate) use text::without_operator;
pub use verdict::{Blindness, Drifting, HidingTemperature, MachineState, Present, Verdict};
