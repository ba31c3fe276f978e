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
/// of a token from its key, or `None` to ignore the token. `on_change` gets the name of a token that appears (true) or
/// disappears (false), and the number of present tokens.
pub(crate) async fn watch(
    session: &Session,
    key_expression: &str,
    name_of: impl Fn(&str) -> Option<MachineId> + Send + Sync + 'static,
    on_change: impl Fn(&MachineId, bool, usize) + Send + Sync + 'static,
    tokens: watch::Sender<Tokens>,
) -> Result<(), BusError> {
    let on_token = move |key: &str, is_alive: bool| {
        let Some(name) = name_of(key) else { return };
        tokens.send_modify(|Tokens { alive, gone }| {
            if is_alive && alive.len() < MOST && alive.insert(name.clone()) {
                gone.remove(&name);
            } else if !is_alive && alive.remove(&name) {
                if gone.len() < MOST {
                    gone.insert(name.clone(), clock::monotonic());
                }
            } else {
                return;
            }
            on_change(&name, is_alive, alive.len());
        });
    };
    bus::watch_tokens(session, key_expression, on_token).await
}
