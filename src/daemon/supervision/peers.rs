//! Presence of the other daemons that this daemon watches: nobody monitors the machines of a daemon that is away.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};

use jiff::Timestamp;
use parking_lot::Mutex;
use zenoh::Session;

use crate::{
    bus::{self, BusError},
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
    /// Absence of each watched daemon; `None` while it is connected.
    away: Mutex<BTreeMap<MachineId, Option<Absence>>>,
}

#[derive(Debug, Clone, Copy)]
struct Absence {
    since: Instant,
    /// Time by the clock of the computer; `None` if the daemon was away at the start.
    at: Option<Timestamp>,
}

impl Peers {
    /// Watches these daemons. Each counts as away until its token arrives.
    pub(crate) fn new(peers: impl IntoIterator<Item = MachineId>) -> Self {
        let started = clock::monotonic();
        let away = Absence { since: started, at: None };
        let peers = peers.into_iter().map(|peer| (peer, Some(away))).collect();
        Self { started, away: Mutex::new(peers) }
    }

    /// Follows the tokens of all daemons while the session is open.
    pub(crate) async fn follow(self: Arc<Self>, session: &Session) -> Result<(), BusError> {
        let on_change = move |key: &str, is_alive: bool| {
            if let Some(daemon) = parse_monitor_key(key) {
                self.change(&daemon, is_alive);
            }
        };
        bus::watch_tokens(session, EVERY_MONITOR_ALIVE, on_change).await
    }

    fn change(&self, daemon: &MachineId, is_alive: bool) {
        let mut peers = self.away.lock();
        match peers.get_mut(daemon) {
            Some(away) if is_alive => {
                tracing::info!(%daemon, "watched daemon connected");
                *away = None;
            }
            Some(away @ None) => {
                tracing::warn!(%daemon, "watched daemon disconnected");
                *away = Some(Absence { since: clock::monotonic(), at: Some(clock::now()) });
            }
            _ => {}
        }
    }

    /// The daemons that have been away for at least [`GRACE`], each with the time when its token disappeared; that time
    /// is `None` for a daemon that was never present. The result is `None` for [`GRACE`] after the start, unless all
    /// daemons are present: their tokens may still arrive.
    pub(crate) fn away(&self) -> Option<Vec<(MachineId, Option<Timestamp>)>> {
        let peers = self.away.lock();
        let now = clock::monotonic();
        let is_known = now.duration_since(self.started) >= GRACE || peers.values().all(Option::is_none);
        let away = peers.iter().filter_map(|(peer, away)| Some((peer, (*away)?)));
        let long = away.filter(|(_, away)| now.duration_since(away.since) >= GRACE);
        is_known.then(|| long.map(|(peer, away)| (peer.clone(), away.at)).collect())
    }
}
