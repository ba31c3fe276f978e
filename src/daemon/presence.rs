//! Counts the loggers that are connected, and says when one goes.

use std::{
    collections::HashSet,
    sync::{Arc, atomic::Ordering::Relaxed},
};

use super::status::Status;
use crate::{
    bus::PresenceWatch,
    wire::{self, Kind},
};

/// Loggers that are remembered; tokens beyond that are not counted.
const MOST: usize = 100_000;

pub(super) async fn run(mut watch: PresenceWatch, status: Arc<Status>) {
    let mut alive = HashSet::new();
    while let Some(change) = watch.next().await {
        let Ok((machine, Kind::Alive)) = wire::parse_key(&change.key) else { continue };
        if change.alive && alive.len() < MOST {
            if alive.insert(machine.clone()) {
                tracing::info!(%machine, "its logger is there");
            }
        } else if alive.remove(&machine) {
            tracing::warn!(%machine, "its logger is gone");
        }
        status.loggers.store(alive.len(), Relaxed);
    }
}
