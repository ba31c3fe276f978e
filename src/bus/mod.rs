//! Zenoh sessions, publishers, subscribers and queries.
//!
//! A callback of zenoh must not wait, as this would stall the whole link: it only does a `try_send` to a bounded queue,
//! changes a value, or starts work on another thread. Puts and replies block on a slow link, so they run on threads of
//! their own.

mod backlog;
mod error;
mod fair_queue;
mod inbox;
mod message;
mod operator;
mod outlet;
mod presence;
mod queries;
mod session;

pub(crate) use backlog::{has_queryable, page};
pub use error::BusError;
pub(crate) use inbox::{Inbox, InboxCounters};
pub(crate) use message::Message;
pub(crate) use operator::{ANSWER_TIMEOUT, command, monitors, require_monitored, require_running, targets};
pub use operator::{Answers, OperatorError, ask};
pub(crate) use outlet::{Outlet, OutletCounters};
pub(crate) use presence::watch_tokens;
pub use queries::QueryQueue;
pub use session::open;
pub(crate) use session::{declare_alive, declare_publisher, intersect, is_client, is_connected, mode};

/// The configuration of a session of a test that finds nobody and listens nowhere.
#[cfg(test)]
pub(crate) fn config_without_links() -> zenoh::Config {
    let mut config = zenoh::Config::default();
    for (key, value) in [("scouting/multicast/enabled", "false"), ("listen/endpoints", "[]")] {
        config.insert_json5(key, value).unwrap();
    }
    config
}
