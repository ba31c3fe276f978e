//! Liveliness of the loggers, for the status and for the monitors, which raise an alarm when a logger disappears.

use std::{collections::HashSet, sync::Arc};

use tokio::sync::watch;
use zenoh::Session;

use crate::{
    bus::{self, BusError, Token},
    daemon::supervision::status::Status,
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
    /// Machines whose loggers disconnected. A logger may connect and disconnect between two ticks of the monitors,
    /// which would otherwise never know that it had a token.
    pub(crate) gone: HashSet<MachineId>,
}

impl Loggers {
    /// Whether the logger of a machine has a token, or had one since the start.
    pub(super) fn had_token(&self, machine: &MachineId) -> bool {
        self.alive.contains(machine) || self.gone.contains(machine)
    }
}

/// Keeps `loggers` up to date with the tokens on `key_expression`, while the session is open.
pub(crate) async fn watch(
    session: &Session,
    key_expression: &str,
    status: Arc<Status>,
    loggers: watch::Sender<Loggers>,
) -> Result<(), BusError> {
    let on_change = move |key: &str, change: Token| {
        let Ok((machine, Kind::Alive)) = wire::parse_key(key) else { return };
        loggers.send_modify(|Loggers { alive, gone }| {
            match change {
                Token::Appeared if alive.len() < MOST && alive.insert(machine.clone()) => {
                    seldom!(info, %machine, "logger connected");
                    gone.remove(&machine);
                }
                Token::Gone if alive.remove(&machine) => {
                    seldom!(warn, %machine, "logger disconnected");
                    if gone.len() < MOST {
                        gone.insert(machine);
                    }
                }
                Token::Appeared | Token::Gone => {}
            }
            status.edit().loggers = alive.len();
        });
    };
    bus::watch_tokens(session, key_expression, on_change).await
}
