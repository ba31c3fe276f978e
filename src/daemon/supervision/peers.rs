//! Presence of the other daemons that this daemon watches: nobody monitors the machines of a daemon that is away.

use std::{
    collections::BTreeSet,
    time::{Duration, Instant},
};

use jiff::Timestamp;
use tokio::sync::watch;
use zenoh::Session;

use super::presence::{self, Tokens};
use crate::{
    bus::BusError,
    daemon::clock,
    throw::MachineId,
    wire::{EVERY_MONITOR_ALIVE, parse_monitor_key},
};

/// Least absence that raises an alarm: a restart takes only seconds.
const GRACE: Duration = Duration::from_secs(30);

/// The watched daemons.
#[derive(Debug)]
pub(crate) struct Peers {
    started: Instant,
    watched: BTreeSet<MachineId>,
    tokens: watch::Receiver<Tokens>,
}

impl Peers {
    /// Watches these daemons while the session is open. Each counts as away until its token arrives.
    pub(crate) async fn watch(session: &Session, watched: BTreeSet<MachineId>) -> Result<Self, BusError> {
        let (sender, tokens) = watch::channel(Tokens::default());
        if !watched.is_empty() {
            let names = watched.clone();
            let name_of = move |key: &str| parse_monitor_key(key).filter(|daemon| names.contains(daemon));
            let log = |daemon: &MachineId, is_alive, _| {
                if is_alive {
                    tracing::info!(%daemon, "watched daemon connected");
                } else {
                    tracing::warn!(%daemon, "watched daemon disconnected");
                }
            };
            presence::watch(session, EVERY_MONITOR_ALIVE, name_of, log, sender).await?;
        }
        Ok(Self { started: clock::monotonic(), watched, tokens })
    }

    /// The daemons that have been away for at least [`GRACE`], each with the time when its token disappeared; that time
    /// is `None` for a daemon that was never present. The result is `None` for [`GRACE`] after the start, unless all
    /// daemons are present: their tokens may still arrive.
    pub(crate) fn away(&self) -> Option<Vec<(MachineId, Option<Timestamp>)>> {
        let (now, at, tokens) = (clock::monotonic(), clock::now(), self.tokens.borrow());
        let absent = self.watched.iter().filter(|daemon| !tokens.alive.contains(*daemon));
        let is_known = now.duration_since(self.started) >= GRACE || absent.clone().next().is_none();
        let long = absent.filter_map(|daemon| {
            let gone = tokens.gone.get(daemon);
            let absence = now.duration_since(*gone.unwrap_or(&self.started));
            (absence >= GRACE).then(|| (daemon.clone(), gone.and_then(|_| at.checked_sub(absence).ok())))
        });
        is_known.then(|| long.collect())
    }
}
