//! The SQLite database: raw throws, estimates, alarms, the outbox.
//!
//! [`Store`] writes through one task with one connection; [`Reader`] has its own connections. After `Ok` a write is on
//! the disk and survives a power cut. Every write is idempotent.

mod codec;
mod cursor;
mod database;
mod disk;
mod error;
mod export;
mod fleet;
mod graft;
mod housekeeping;
mod judgement;
mod link;
mod many;
mod open;
mod outside;
mod overview;
mod pace;
mod page;
mod place;
mod quarantine;
mod reader;
mod recent;
mod rows;
mod salvage;
mod settings;
mod spool;
pub mod statements;
mod statistics;
mod trouble;
mod write;
mod writer;

pub use codec::UnreadableTrace;
pub use database::{Opened, Store};
pub use disk::DiskLevel;
pub(crate) use disk::beside;
pub use error::StoreError;
pub use export::{Export, Exported};
pub use fleet::Window;
pub(crate) use fleet::{
    ALL_MACHINES, CommandRow, CommonAlarm, Fault, FleetQuery, FleetRow, Present, Tally, WORST_FIRST,
};
pub use housekeeping::Dropped;
pub use judgement::{COMMANDS_KEPT, Judgement, MonitorRecord, Outcome};
pub use open::{Found, Report, refuse_foreign};
pub use outside::{Backup, Value, ask};
pub(crate) use pace::{Recent, Seldom, seldom};
pub use page::{Cursor, PageStored};
pub use quarantine::{QUARANTINED_BYTES, Refused};
pub use reader::Reader;
pub use rows::{Gap, GapRow, OutboxRow, Selector, StoredMonitor, StoredThrow, ThrowRow};
pub use salvage::Salvaged;
pub use settings::{Settings, Synchronous};
pub use spool::Spooled;
pub use statistics::Statistics;
