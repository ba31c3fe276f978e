//! The SQL statements of the store. A test prepares each of them against the migrated schema. The statements of a
//! recovery are in `files::graft` and `files::salvage`.
//!
//! | module | statements for |
//! |---|---|
//! | `spool` | received throws, their gaps and backlogs, and the quarantine |
//! | `judge` | pending throws, estimates, monitors, alarm events, commands and messages |
//! | `history` | health, alarms and throws of a machine or of some machines, and the export |
//! | `fleet` | the page of the fleet |
//! | `keeping` | start and end of the daemon, retention, statistics |
//! | `parts` | parts that several of them share |

#[macro_use]
mod parts;
mod fleet;
mod history;
mod judge;
mod keeping;
mod spool;

pub(crate) use fleet::ALL_MACHINES;
pub(super) use {fleet::*, history::*, judge::*, keeping::*, parts::is_absent, spool::*};

/// All statements, with their names.
pub fn all() -> impl Iterator<Item = (&'static str, &'static str)> {
    [fleet::ALL, history::ALL, judge::ALL, keeping::ALL, spool::ALL].into_iter().flatten().copied()
}
