//! Liveliness of the loggers, for the status and for the monitors, which raise an alarm without a logger.

use std::{
    collections::HashSet,
    sync::{Arc, atomic::Ordering::Relaxed},
};

use tokio::sync::watch;

use super::status::Status;
use crate::{
    bus::PresenceWatch,
    throw::MachineId,
    wire::{self, Kind},
};

/// Largest number of watched tokens.
const MOST: usize = 100_000;

pub(super) async fn run(mut tokens: PresenceWatch, status: Arc<Status>, alive: watch::Sender<HashSet<MachineId>>) {
    while let Some(change) = tokens.next().await {
        let Ok((machine, Kind::Alive)) = wire::parse_key(&change.key) else { continue };
        alive.send_modify(|alive| {
            if change.alive {
                if alive.len() < MOST && alive.insert(machine.clone()) {
                    tracing::info!(%machine, "logger connected");
                }
            } else if alive.remove(&machine) {
                tracing::warn!(%machine, "logger disconnected");
            }
            status.loggers.store(alive.len(), Relaxed);
        });
    }
}
