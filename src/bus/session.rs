//! Opening of a zenoh session, and queries of its state.

use std::{thread, time::Duration};

use tokio::{
    sync::oneshot,
    time::{self, Instant},
};
use zenoh::{Config, Session, Wait as _, key_expr::keyexpr, liveliness::LivelinessToken, pubsub::Publisher};

use super::error::{BusError, OPEN};

/// Time until the first log line about a router that does not answer. A connection takes some milliseconds.
const FIRST_WARNING: Duration = Duration::from_secs(2);
/// Time between two of these log lines.
const WARN_EVERY: Duration = Duration::from_secs(30);

/// Whether a session of this configuration is a client, which reaches other sessions through a router only.
pub(crate) fn is_client(config: &Config) -> bool {
    mode(config) == "client"
}

/// The mode of a session: router, peer or client.
pub(crate) fn mode(config: &Config) -> String {
    config.get_json("mode").unwrap_or_default().trim_matches('"').to_owned()
}

/// Opens a zenoh session. A client waits for its router, and logs that it does; dropping the future ends the wait.
///
/// # Errors
/// When zenoh cannot listen or connect as configured.
pub async fn open(config: Config) -> Result<Session, BusError> {
    let is_client = is_client(&config);
    let routers = config.get_json("connect/endpoints").unwrap_or_default();
    let (done, mut opened) = oneshot::channel();
    // `zenoh::open` blocks, for a client until its router answers. On a thread of its own it delays neither the
    // handling of signals nor the end of the process.
    let open = move || {
        let _ = done.send(zenoh::open(config).wait());
    };
    let failed = |error: zenoh::Error| BusError::new(OPEN)(error);
    thread::Builder::new().name("open zenoh".to_owned()).spawn(open).map_err(|error| failed(error.into()))?;
    let mut warning = time::interval_at(Instant::now() + FIRST_WARNING, WARN_EVERY);
    loop {
        tokio::select! {
            session = &mut opened => return session.map_err(|ended| failed(ended.into()))?.map_err(failed),
            _ = warning.tick() => if is_client {
                tracing::warn!("no router answers at {routers}: waiting for it");
            } else {
                tracing::warn!("opening the zenoh session takes long");
            },
        }
    }
}

/// Declares a liveliness token. Other sessions see it until it is dropped or the link is closed.
pub(crate) async fn declare_alive(session: &Session, key: &str) -> Result<LivelinessToken, BusError> {
    let declared = session.liveliness().declare_token(key.to_owned()).await;
    declared.map_err(BusError::new(format!("declare the liveliness token {key}")))
}

/// Declares a publisher.
pub(crate) async fn declare_publisher(session: &Session, key: String) -> Result<Publisher<'static>, BusError> {
    let declared = session.declare_publisher(key.clone()).await;
    declared.map_err(BusError::new(format!("see the subscribers to {key}")))
}

/// Whether two key expressions have a key in common; false if one of the two is invalid.
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
