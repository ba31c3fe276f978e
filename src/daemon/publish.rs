//! Publishes the alarm events in the outbox, in order and at least once. An event stays in the outbox until zenoh has
//! had time to send it, so the next process publishes it again after a crash.

use std::{
    collections::VecDeque,
    sync::Arc,
    time::{Duration, Instant},
};

use tokio::time;

use super::{clock, shared::Shared, supervision::heartbeat::TaskName};
use crate::{
    bus::{self, Outlet},
    store::seldom,
};

/// Number of messages read from the outbox in one query.
const BATCH: u32 = 64;
/// Time that a message stays in the outbox after zenoh accepted it. If the process dies with the message in zenoh's
/// buffers, the next process sends it again.
const SETTLED: Duration = Duration::from_secs(2);
/// Pause before the first publication of a process with an existing database. Its subscribers have to reconnect, which
/// zenoh tries every 4 s. A subscriber that reconnects after the first publication would get old events after new ones.
const RECONNECT_WAIT: Duration = Duration::from_secs(6);
/// Time limit, from the start, of the wait for a subscriber.
const AUDIENCE_LIMIT: Duration = Duration::from_secs(30);
/// Time limit of a put; zenoh closes a stalled link after 5 s.
const PUT_LIMIT: Duration = Duration::from_secs(20);

/// The publishing loop.
pub(super) struct Publisher {
    pub(super) shared: Arc<Shared>,
    pub(super) outlet: Outlet,
    /// Publishes nothing: shows whether alarms have a subscriber.
    pub(super) audience: zenoh::pubsub::Publisher<'static>,
    /// Whether the database is new: no earlier process published from it, so no subscriber has to reconnect.
    pub(super) is_first: bool,
}

impl Publisher {
    /// Runs until its stop signal, then publishes the rest of the outbox.
    pub(super) async fn run(self) {
        let Shared { session, status, stops, outbox, is_client, .. } = &*self.shared;
        let mut beat = clock::every(Duration::from_secs(1));
        // Rows that zenoh accepted, with the time.
        let mut accepted: VecDeque<(i64, Instant)> = VecDeque::new();
        let mut last = 0;
        let start = clock::monotonic();
        loop {
            let stopping = stops.publish.is_cancelled();
            let connected = bus::is_connected(session).await;
            status.edit().connected = connected;
            // A client without its router reaches no subscriber.
            let reaches = connected || !is_client;
            let since = start.elapsed();
            let waited = since >= AUDIENCE_LIMIT;
            let may_begin = self.is_first || since >= RECONNECT_WAIT;
            let has_audience = async || self.audience.matching_status().await.is_ok_and(|status| status.matching());
            if reaches && may_begin && (stopping || waited || has_audience().await) {
                last = self.publish(last, &mut accepted).await;
            }
            self.remove_settled(&mut accepted).await;
            status.heartbeats.beat(TaskName::Publish);
            if stopping || self.outlet.is_closed() {
                return;
            }
            tokio::select! {
                () = stops.publish.cancelled() => {}
                () = outbox.notified() => {}
                _ = beat.tick() => {}
            }
        }
    }

    /// Publishes the messages after the row `last`; returns the last row that zenoh accepted.
    async fn publish(&self, mut last: i64, accepted: &mut VecDeque<(i64, Instant)>) -> i64 {
        loop {
            let rows = match self.shared.store.reader().outbox_pending(last, BATCH).await {
                Ok(rows) => rows,
                Err(error) => {
                    seldom!(warn, %error, "reading the outbox failed; retrying");
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
                        accepted.push_back((message.row, clock::monotonic()));
                    }
                    Ok(Err(error)) => {
                        seldom!(warn, %error, "publishing an alarm failed; retrying");
                        return last;
                    }
                    Err(_) => {
                        seldom!(warn, "publishing an alarm takes too long; retrying");
                        return last;
                    }
                }
                self.shared.status.heartbeats.beat(TaskName::Publish);
            }
        }
    }

    /// Removes the messages that zenoh accepted at least [`SETTLED`] ago from the outbox.
    async fn remove_settled(&self, accepted: &mut VecDeque<(i64, Instant)>) {
        let now = clock::monotonic();
        let settled = accepted.iter().take_while(|(_, at)| now.duration_since(*at) >= SETTLED).count();
        if settled == 0 {
            return;
        }
        let rows: Vec<i64> = accepted.iter().take(settled).map(|(row, _)| *row).collect();
        match self.shared.store.outbox_sent(&rows).await {
            Ok(()) => drop(accepted.drain(..settled)),
            Err(error) => {
                seldom!(warn, %error, "removing published messages from the outbox failed; they may be sent again");
            }
        }
    }
}
