//! From the outbox to zenoh: at least once, in order, and again after a crash until zenoh has had time to send.

use std::{
    collections::VecDeque,
    sync::{Arc, atomic::Ordering::Relaxed},
    time::{Duration, Instant},
};

use tokio::{sync::Notify, time};
use tokio_util::sync::CancellationToken;
use zenoh::Session;

use super::{clock, heartbeat::TaskName, status::Status};
use crate::{
    bus::{self, Audience, Outlet},
    store::{Store, seldom},
};

/// Messages that are read from the outbox together.
const BATCH: u32 = 64;
/// A message stays in the outbox this long after zenoh took it: what still was in its buffers when the process died is
/// sent again by the next one.
const SETTLED: Duration = Duration::from_secs(2);
/// On a database that was used before nothing is published for so long after the start: subscribers have to find the new
/// process first, for which zenoh tries every 4 s at least. One that came later would get old events after new ones.
const RETURN: Duration = Duration::from_secs(6);
/// Longest wait for a first subscriber after the start.
const AUDIENCE_LIMIT: Duration = Duration::from_secs(30);
/// A put that takes longer hangs; zenoh itself gives a stalled link up after 5 s.
const PUT_LIMIT: Duration = Duration::from_secs(20);

/// The loop that publishes.
pub(super) struct Publisher {
    pub(super) store: Store,
    pub(super) session: Session,
    pub(super) outlet: Outlet,
    pub(super) status: Arc<Status>,
    pub(super) outbox: Arc<Notify>,
    /// Subscribers of alarms.
    pub(super) audience: Audience,
    /// Whether the database is new, so that no subscriber knows a process before this one.
    pub(super) is_first: bool,
    /// Whether the session is a leaf, which reaches others through a router only.
    pub(super) is_client: bool,
}

impl Publisher {
    /// Runs until `stop`, then publishes what still waits.
    pub(super) async fn run(self, stop: CancellationToken) {
        let mut beat = time::interval(Duration::from_secs(1));
        let mut taken: VecDeque<(i64, Instant)> = VecDeque::new();
        let mut last = 0;
        let start = clock::monotonic();
        loop {
            let stopping = stop.is_cancelled();
            let connected = bus::is_connected(&self.session).await;
            self.status.connected.store(connected, Relaxed);
            // Without its router, a client reaches no subscriber.
            let reaches = connected || !self.is_client;
            let since = clock::monotonic().duration_since(start);
            let waited = since >= AUDIENCE_LIMIT;
            let returned = self.is_first || since >= RETURN;
            if reaches && returned && (stopping || waited || self.audience.is_connected().await) {
                last = self.publish(last, &mut taken).await;
            }
            self.settle(&mut taken).await;
            self.status.heartbeats.beat(TaskName::Publish);
            if stopping || self.outlet.is_closed() {
                return;
            }
            tokio::select! {
                () = stop.cancelled() => {}
                () = self.outbox.notified() => {}
                _ = beat.tick() => {}
            }
        }
    }

    async fn publish(&self, mut last: i64, taken: &mut VecDeque<(i64, Instant)>) -> i64 {
        loop {
            let rows = match self.store.reader().outbox_pending(last, BATCH).await {
                Ok(rows) => rows,
                Err(error) => {
                    seldom!(warn, %error, "the outbox cannot be read; it is tried again");
                    return last;
                }
            };
            if rows.is_empty() {
                return last;
            }
            for message in rows {
                match time::timeout(PUT_LIMIT, self.outlet.alarm(message.key, message.payload)).await {
                    Ok(Ok(())) => {
                        last = message.row;
                        taken.push_back((message.row, clock::monotonic()));
                    }
                    Ok(Err(error)) => {
                        seldom!(warn, %error, "an alarm cannot be published; it is tried again");
                        return last;
                    }
                    Err(_) => {
                        seldom!(warn, "publishing an alarm takes too long; it is tried again");
                        return last;
                    }
                }
                self.status.heartbeats.beat(TaskName::Publish);
            }
        }
    }

    async fn settle(&self, taken: &mut VecDeque<(i64, Instant)>) {
        let now = clock::monotonic();
        let settled = taken.iter().take_while(|(_, at)| now.duration_since(*at) >= SETTLED).count();
        if settled == 0 {
            return;
        }
        let rows: Vec<i64> = taken.iter().take(settled).map(|(row, _)| *row).collect();
        match self.store.outbox_sent(&rows).await {
            Ok(()) => drop(taken.drain(..settled)),
            Err(error) => seldom!(warn, %error, "published messages stay in the outbox; they may be sent again"),
        }
    }
}
