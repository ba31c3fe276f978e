//! Zenoh sessions, publishers, subscribers and queries.
//!
//! A callback of zenoh only does a `try_send` to a bounded queue, or changes a value: waiting would stall the whole link.
//! Puts and replies block on a slow link, so they run on their own threads.

mod backlog;
mod error;
mod fair_queue;
mod inbox;
mod message;
mod operator;
mod outlet;
mod presence;
mod queries;
mod queue_budget;
mod session;

pub use backlog::{Ending, Page, page};
pub use error::BusError;
pub use inbox::{Inbox, InboxCounters};
pub use message::{Limits, Message};
pub use operator::{Answers, OperatorError, ask, command, monitors, require_monitored, require_running};
pub use outlet::{Outlet, OutletCounters, OutletEnd};
pub use presence::{Audience, watch_tokens};
pub use queries::{Question, Questions, answer};
pub use session::{declare_alive, intersect, is_connected, open};
pub use zenoh::liveliness::LivelinessToken;
