//! Zenoh sessions, publishers, subscribers and queries.
//!
//! What zenoh calls back does a bounded `try_send` and returns: a callback that waits would stall the whole link.
//! What may block on zenoh runs on a thread of its own: a put waits for the link when the link is slow.

mod cache;
mod follow;
mod inbox;
mod operator;
mod outlet;
mod presence;
mod queries;
mod room;

use zenoh::{Config, Session, key_expr::keyexpr};

pub use inbox::{Inbox, InboxCounters, Limits, Message};
pub use operator::{OperatorError, ask, command, is_watched, monitors};
pub use outlet::{Outlet, OutletCounters, OutletEnd};
pub use presence::{Audience, Presence, PresenceWatch};
pub use queries::{Question, Questions, answer};
pub use zenoh::liveliness::LivelinessToken;

/// What zenoh refused.
#[derive(Debug, thiserror::Error)]
#[error("zenoh: cannot {action}: {source}")]
pub struct BusError {
    action: String,
    source: zenoh::Error,
}

impl BusError {
    fn new(action: impl Into<String>) -> impl FnOnce(zenoh::Error) -> Self {
        let action = action.into();
        move |source| Self { action, source }
    }
}

/// Opens a session.
///
/// # Errors
/// When zenoh cannot listen or connect as configured.
pub async fn open(config: Config) -> Result<Session, BusError> {
    zenoh::open(config).await.map_err(BusError::new("open the session"))
}

/// Declares a liveliness token: it shows others that this program runs, until it is dropped or the link dies.
///
/// # Errors
/// When zenoh refuses the key.
pub async fn declare_alive(session: &Session, key: &str) -> Result<LivelinessToken, BusError> {
    let declared = session.liveliness().declare_token(key.to_owned()).await;
    declared.map_err(BusError::new(format!("declare the liveliness token {key}")))
}

/// Whether two key expressions have a key in common; false when one of them is none.
#[must_use]
pub fn intersect(one: &str, other: &str) -> bool {
    match (keyexpr::new(one), keyexpr::new(other)) {
        (Ok(one), Ok(other)) => one.intersects(other),
        _ => false,
    }
}

/// Whether anybody is at the other end of a link. A client without its router talks into the void.
pub async fn is_connected(session: &Session) -> bool {
    session.info().transports().await.next().is_some()
}
