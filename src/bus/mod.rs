//! Zenoh sessions, publishers, subscribers and queries.
//!
//! A callback of zenoh does a bounded `try_send` and returns: a callback that waits would stall the whole link.
//! Calls that may block inside zenoh run on threads of their own: a put waits for a slow link.

mod backlog;
mod error;
mod inbox;
mod message;
mod operator;
mod outlet;
mod presence;
mod queries;
mod room;
mod session;

pub use backlog::{Ending, Page, page};
pub use error::BusError;
pub use inbox::{Inbox, InboxCounters};
pub use message::{Limits, Message};
pub use operator::{OperatorError, ask, command, is_running, is_watched, monitors};
pub use outlet::{Outlet, OutletCounters, OutletEnd};
pub use presence::{Audience, Presence, PresenceWatch};
pub use queries::{Question, Questions, answer};
pub use session::{declare_alive, intersect, is_connected, open};
pub use zenoh::liveliness::LivelinessToken;
