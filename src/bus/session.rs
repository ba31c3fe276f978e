//! Functions of a zenoh session.

use zenoh::{Config, Session, key_expr::keyexpr, liveliness::LivelinessToken};

use super::error::BusError;

/// Opens a zenoh session.
///
/// # Errors
/// When zenoh cannot listen or connect as configured.
pub async fn open(config: Config) -> Result<Session, BusError> {
    zenoh::open(config).await.map_err(BusError::new("open the session"))
}

/// Declares a liveliness token. Others see it until it is dropped or the link is closed.
pub(crate) async fn declare_alive(session: &Session, key: &str) -> Result<LivelinessToken, BusError> {
    let declared = session.liveliness().declare_token(key.to_owned()).await;
    declared.map_err(BusError::new(format!("declare the liveliness token {key}")))
}

/// Whether two key expressions have a key in common; false if one of them is invalid.
pub(crate) fn intersect(one: &str, other: &str) -> bool {
    match (keyexpr::new(one), keyexpr::new(other)) {
        (Ok(one), Ok(other)) => one.intersects(other),
        _ => false,
    }
}

/// Whether the session has a link to another session. A client without its router has none.
pub(crate) async fn is_connected(session: &Session) -> bool {
    session.info().transports().await.next().is_some()
}
