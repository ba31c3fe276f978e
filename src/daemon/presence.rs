//! Liveliness of the loggers, for the status and for the monitors, which raise an alarm without a logger.

use std::{collections::HashSet, sync::Arc};

use tokio::sync::watch;
use zenoh::Session;

use super::status::Status;
use crate::{
    bus::{self, BusError},
    store::seldom,
    throw::MachineId,
    wire::{self, Kind},
};

/// Largest number of watched tokens.
const MOST: usize = 100_000;

/// Keeps `alive` the machines whose loggers have a liveliness token in `key_expression`, while the session is open.
pub(super) async fn watch(
    session: &Session,
    key_expression: &str,
    status: Arc<Status>,
    alive: watch::Sender<HashSet<MachineId>>,
) -> Result<(), BusError> {
    let on_change = move |key: &str, is_alive: bool| {
        let Ok((machine, Kind::Alive)) = wire::parse_key(key) else { return };
        alive.send_modify(|alive| {
            if !is_alive {
                if alive.remove(&machine) {
                    seldom!(warn, %machine, "logger disconnected");
                }
            } else if alive.len() < MOST && alive.insert(machine.clone()) {
                seldom!(info, %machine, "logger connected");
            }
            status.edit().loggers = alive.len();
        });
    };
    bus::watch_tokens(session, key_expression, on_change).await
}
