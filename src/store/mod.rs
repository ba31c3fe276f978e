//! The SQLite database: raw throws, estimates, baselines, alarms, and the outbox of alarm events to publish.
//!
//! [`Store`] writes through one task with one connection; [`Reader`] has its own connections. When a write returns
//! `Ok`, its data are on the disk and survive a power cut. Every write is idempotent, so a caller may repeat it.

mod batch;
mod codec;
mod cursor;
mod database;
mod disk;
mod error;
mod export;
mod files;
mod fleet;
mod graft;
mod judgement;

mod open;
mod overview;
mod page;
mod path;
mod quarantine;
mod rate_limit;
mod read_only;
mod reader;
mod recent;
mod retention;
mod rows;
mod salvage;
mod settings;
mod spool;
pub mod statements;
mod statistics;
mod trouble;
mod write;
mod writer;
mod writing;

pub use codec::UnreadableTrace;
pub use database::{Opened, Store};
pub use disk::DiskLevel;
pub use error::StoreError;
pub(crate) use export::{Export, Exported};
pub use fleet::Window;
pub(crate) use fleet::{CommandRow, CommonAlarm, Fault, FleetQuery, FleetRow, StateCounts, WORST_FIRST};
pub use judgement::{COMMANDS_KEPT, Judgement, MonitorRecord, Outcome};
pub(crate) use open::refuse_foreign;
pub use open::{Found, Report};
pub(crate) use overview::{AlarmCount, ThrowSelection};
pub use page::{Cursor, PageStored};
pub(crate) use path::{beside, folder_of, unwritable};
pub use quarantine::{QUARANTINED_BYTES, QuarantinedMessage};
pub(crate) use rate_limit::{LogRateLimit, RecentCount, seldom};
pub use read_only::Value;
pub(crate) use read_only::{Backup, ResultWriter, run_query};
pub use reader::Reader;
pub use retention::Dropped;
pub use rows::{Gap, OutboxRow, Selector, StoredMonitor, StoredThrow, ThrowRow};
pub use salvage::Salvaged;
pub use settings::Settings;
pub use spool::Spooled;
pub(crate) use statements::ALL_MACHINES;
pub use statistics::Statistics;
