//! The SQLite database: raw throws, estimates, baselines, alarms, and the outbox of alarm events to publish.
//!
//! [`Store`] writes through one task with one connection; [`Reader`] has its own connections. When a write returns
//! `Ok`, its data are on the disk and survive a power cut. A caller may repeat a write: its rows are stored once, and only
//! the counters of losses may count twice.
//!
//! | module | contents |
//! |---|---|
//! | `files` | the files of a database: opening, check, salvage, free space |
//! | `writer` | the writing task, and each kind of write |
//! | `reader` | the read-only connections, and the queries of the pages and commands |
//! | `rows`, `codec`, `recent` | the stored types, the compression of traces, and the newest throws in memory |
//! | `dropped` | the kinds of rows that retention drops, and their counts |

mod codec;
mod database;
mod dropped;
mod error;
mod files;
mod rate_limit;
mod reader;
mod recent;
mod rows;
mod settings;
pub mod statements;
mod statistics;
mod trouble;
mod writer;

pub use codec::UnreadableTrace;
pub use database::{Opened, Store};
pub use dropped::Dropped;
pub use error::StoreError;
pub use files::disk::DiskLevel;
pub(crate) use files::open::refuse_foreign;
pub use files::open::{Found, Report};
pub(crate) use files::path::{beside, database_path, folder_of, unwritable};
pub use files::salvage::Salvaged;
pub(crate) use rate_limit::{LogRateLimit, RecentCount, seldom};
pub use reader::Reader;
pub(crate) use reader::export::{Export, Exported};
pub use reader::fleet::Window;
pub(crate) use reader::fleet::{
    AlarmCount, CommonAlarm, Fault, Faults, FleetQuery, FleetRow, StateCounts, WORST_FIRST,
};
pub(crate) use reader::machine::{CommandRow, ThrowSelection};
pub use reader::read_only::Value;
pub(crate) use reader::read_only::{Backup, ResultWriter, run_query};
pub use rows::{Gap, OutboxRow, Selector, StoredMonitor, StoredThrow, ThrowRow};
pub use settings::Settings;
pub(crate) use statements::ALL_MACHINES;
pub use statistics::Statistics;
pub use writer::backlog_page::PageStored;
pub use writer::cursor::Cursor;
pub use writer::judgement::{COMMANDS_KEPT, Judgement, MonitorRecord, Outcome};
pub use writer::quarantine::QuarantinedMessage;
pub use writer::spool::{ReceivedThrow, Spooled};
