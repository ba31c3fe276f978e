//! Liveliness of the loggers, for the status and for the monitors, which raise an alarm when a logger is gone.

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

/// Most loggers whose tokens are followed.
const MOST: usize = 100_000;

pub(super) async fn run(mut tokens: PresenceWatch, status: Arc<Status>, alive: watch::Sender<HashSet<MachineId>>) {
    while let Some(change) = tokens.next().await {
        let Ok((machine, Kind::Alive)) = wire::parse_key(&change.key) else { continue };
        alive.send_modify(|alive| {
            if change.alive && alive.len() < MOST {
                if alive.insert(machine.clone()) {
                    tracing::info!(%machine, "its logger appeared");
                }
            } else if alive.remove(&machine) {
                tracing::warn!(%machine, "its logger is gone");
            }
            status.loggers.store(alive.len(), Relaxed);
        });
    }
}
