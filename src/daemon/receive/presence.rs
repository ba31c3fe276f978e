//! Liveliness of the loggers and of the watched daemons, for the status and for the monitors, which raise an alarm when
//! one disappears.

use std::{
    collections::{HashMap, HashSet},
    time::Instant,
};

use tokio::sync::watch;
use zenoh::Session;

use crate::{
    bus::{self, BusError},
    daemon::clock,
    store::seldom,
    throw::MachineId,
};

/// Largest number of names in each set of [`Tokens`].
const MOST: usize = 100_000;

/// The names of the loggers, or of the daemons, that have a liveliness token or had one.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tokens {
    pub(crate) alive: HashSet<MachineId>,
    /// Those that lost their token since the start and have none now, with the time of the loss. A logger may connect
    /// and disconnect between two ticks of the monitors, which would otherwise never know that it had a token.
    pub(crate) gone: HashMap<MachineId, Instant>,
}

/// Keeps `tokens` up to date with the tokens on `key_expression`, while the session is open. `name_of` returns the name
/// of a token from its key, or `None` to ignore the token; `what` is the word for the log; `on_count` gets the number of
/// present tokens.
pub(crate) async fn watch(
    session: &Session,
    key_expression: &str,
    what: &'static str,
    name_of: impl Fn(&str) -> Option<MachineId> + Send + Sync + 'static,
    on_count: impl Fn(usize) + Send + Sync + 'static,
    tokens: watch::Sender<Tokens>,
) -> Result<(), BusError> {
    let on_change = move |key: &str, is_alive: bool| {
        let Some(name) = name_of(key) else { return };
        tokens.send_modify(|Tokens { alive, gone }| {
            if is_alive && alive.len() < MOST && alive.insert(name.clone()) {
                seldom!(info, %name, "{what} connected");
                gone.remove(&name);
            } else if !is_alive && alive.remove(&name) {
                seldom!(warn, %name, "{what} disconnected");
                if gone.len() < MOST {
                    gone.insert(name, clock::monotonic());
                }
            }
            on_count(alive.len());
        });
    };
    bus::watch_tokens(session, key_expression, on_change).await
}
