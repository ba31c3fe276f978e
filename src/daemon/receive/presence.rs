//! Liveliness of the loggers, for the status and for the monitors, which raise an alarm when a logger disappears.

use std::{
    collections::{HashMap, HashSet},
    sync::Arc,
    time::Instant,
};

use tokio::sync::watch;
use zenoh::Session;

use crate::{
    bus::{self, BusError},
    daemon::{clock, supervision::status::Status},
    store::seldom,
    throw::MachineId,
    wire::{self, Kind},
};

/// Largest number of machines in each set of [`Loggers`].
const MOST: usize = 100_000;

/// The machines whose loggers have a liveliness token, or had one.
#[derive(Debug, Clone, Default)]
pub(crate) struct Loggers {
    pub(crate) alive: HashSet<MachineId>,
    /// Machines whose loggers lost their token since the start and have none now, with the time of the loss. A logger
    /// may connect and disconnect between two ticks of the monitors, which would otherwise never know that it had a
    /// token.
    pub(crate) gone: HashMap<MachineId, Instant>,
}

/// Keeps `loggers` up to date with the tokens on `key_expression`, while the session is open.
pub(crate) async fn watch(
    session: &Session,
    key_expression: &str,
    status: Arc<Status>,
    loggers: watch::Sender<Loggers>,
) -> Result<(), BusError> {
    let on_change = move |key: &str, is_alive: bool| {
        let Ok((machine, Kind::Alive)) = wire::parse_key(key) else { return };
        loggers.send_modify(|Loggers { alive, gone }| {
            if is_alive && alive.len() < MOST && alive.insert(machine.clone()) {
                seldom!(info, %machine, "logger connected");
                gone.remove(&machine);
            } else if !is_alive && alive.remove(&machine) {
                seldom!(warn, %machine, "logger disconnected");
                if gone.len() < MOST {
                    gone.insert(machine, clock::monotonic());
                }
            }
            status.edit().loggers = alive.len();
        });
    };
    bus::watch_tokens(session, key_expression, on_change).await
}
