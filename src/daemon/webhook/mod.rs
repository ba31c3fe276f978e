//! Sends alarm events to the webhook, in order and at least once. An event stays in the database until the receiver has
//! accepted it, or has refused it as a message that it cannot use. Only the newest 10,000 events wait: a trigger drops
//! older ones, and counts them for the alarm `data_loss`. In a flood many events become one summary.

mod post;
mod summary;

use std::{
    collections::VecDeque,
    pin::pin,
    sync::Arc,
    time::{Duration, Instant},
};

use tokio::time;

use super::{clock, error::StartError, shared::Shared, supervision::heartbeat::TaskName};
use crate::{
    store::seldom,
    wire::{self, Alarm},
};
use post::{PostError, WebhookServer};
use summary::Summary;

/// Pause after the first failed attempt; doubled with each further attempt up to [`LONGEST_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_secs(1);
/// Longest pause between two attempts: the longest delay of an alarm after the receiver works again.
const LONGEST_PAUSE: Duration = Duration::from_mins(1);
/// Time between two heartbeats during a wait, and between two attempts to read or to remove notifications.
const BEAT: Duration = Duration::from_secs(5);
/// Number of notifications read for the next message. Further ones are read only if the filters remove all of them.
const BATCH: u32 = 64;
/// Number of notifications read for a summary: all that the store keeps.
const ALL: u32 = 10_000;
/// Largest number of events sent before they were committed that are recognised when they are committed. Of each alarm
/// about the daemon itself there are at most two, its raise and its last event, and few such alarms in an outage.
const EARLY: usize = 8;

/// An alarm event to send, with its row; `None` before it is committed.
type Pending = (Option<i64>, Alarm);

/// A period of `webhook.period_s`.
struct Period {
    start: Instant,
    /// Number of messages sent in it.
    sent: u32,
}

impl Period {
    fn begin() -> Self {
        Self { start: clock::monotonic(), sent: 0 }
    }
}

/// The sending loop.
pub(super) struct Notifier {
    shared: Arc<Shared>,
    server: WebhookServer,
    period: Period,
    /// The last row that need not be sent any more. The database may still have it: on a full or failing disk it cannot be
    /// removed.
    last: i64,
    /// Whether the last removal of sent notifications failed.
    removal_failed: bool,
    /// The last events that were sent before they were committed.
    early: VecDeque<Alarm>,
}

impl Notifier {
    /// Prepares the loop; `None` if no webhook is configured.
    ///
    /// # Errors
    /// When the database or the certificates cannot be used.
    pub(super) async fn new(shared: Arc<Shared>) -> Result<Option<Self>, StartError> {
        let server = WebhookServer::new(&shared.config.webhook).map_err(StartError::Webhook)?;
        shared.store.set_webhook(server.is_some()).await?;
        let period = Period::begin();
        Ok(server.map(|server| Self { shared, server, period, last: 0, removal_failed: false, early: VecDeque::new() }))
    }

    /// Runs until the future is dropped.
    pub(super) async fn run(mut self) {
        let length = Duration::from_secs_f64(self.shared.config.webhook.period_s);
        loop {
            if self.period.start.elapsed() >= length {
                self.period = Period::begin();
            }
            let is_flood = self.period.sent >= self.shared.config.webhook.max_messages;
            let mut pending = self.pending(BATCH).await;
            if pending.is_empty() {
                if self.removal_failed {
                    self.remove().await;
                }
                // With a time limit, to repeat a read or a removal that failed.
                let _ = self.wait(time::timeout(BEAT, self.shared.webhook.notified())).await;
                continue;
            }
            if is_flood {
                self.wait(time::sleep_until((self.period.start + length).into())).await;
                pending = self.pending(ALL).await;
            } else {
                pending.truncate(1);
            }
            self.period.sent += 1;
            self.deliver(pending).await;
        }
    }

    /// Reads up to `limit` pending events, and returns those that pass the filters. If none passes, the events are
    /// removed, and the next ones are read. Without such events it returns those that cannot be committed yet. Empty if
    /// no event is pending.
    async fn pending(&mut self, limit: u32) -> Vec<Pending> {
        loop {
            let rows = self.shared.store.reader().notifications(self.last, limit).await.unwrap_or_else(|error| {
                seldom!(warn, %error, "reading the notifications failed; retrying");
                Vec::new()
            });
            let Some((last, _)) = rows.last() else { return self.uncommitted() };
            let last = *last;
            let read = |(row, payload): (i64, String)| match serde_json::from_str::<Alarm>(&payload) {
                Ok(alarm) => Some((Some(row), alarm)),
                Err(error) => {
                    tracing::error!(row, %error, "an alarm event that another version stored cannot be read: it is LOST for the webhook");
                    None
                }
            };
            let wanted = rows.into_iter().filter_map(read).filter(|(_, alarm)| self.is_wanted(alarm));
            let wanted: Vec<_> = wanted.collect();
            if !wanted.is_empty() {
                return wanted;
            }
            self.last = last;
            self.remove().await;
        }
    }

    /// The alarms about the daemon itself that are published and that the database cannot store yet.
    fn uncommitted(&self) -> Vec<Pending> {
        let alarms = self.shared.status.with_uncommitted(Vec::new()).into_iter();
        alarms.filter(|alarm| self.is_wanted(alarm)).map(|alarm| (None, alarm.published())).collect()
    }

    /// Whether an event passes the filters, and was not sent before it was committed.
    fn is_wanted(&self, alarm: &Alarm) -> bool {
        let is_same = |early: &Alarm| (&early.alarm_id, early.event_no) == (&alarm.alarm_id, alarm.event_no);
        self.shared.config.webhook.wants(alarm) && !self.early.iter().any(is_same)
    }

    /// Sends events in one message, a single event as it is and several as a summary, again and again until the receiver
    /// accepts or refuses it. Then removes their notifications.
    async fn deliver(&mut self, pending: Vec<Pending>) {
        let Some((_, alarm)) = pending.last() else { return };
        let (events, mut pause) = (pending.len() as u64, FIRST_PAUSE);
        let alarms = pending.iter().map(|(_, alarm)| alarm);
        let body = if events == 1 {
            wire::json(alarm)
        } else {
            wire::json(&Summary::of(alarms.collect(), &self.shared.config.monitor.as_machine()))
        };
        loop {
            self.beat();
            match self.server.post(body.clone().into()).await {
                Ok(()) => break,
                Err(error @ PostError::Refused(_)) => {
                    tracing::error!(%error, events, body, "webhook: the receiver refuses alarm events, which are not sent again");
                    self.shared.status.edit().webhook_refused += events;
                    break;
                }
                Err(error) => {
                    self.shared.status.edit().webhook_fails = true;
                    seldom!(warn, %error, "webhook: sending an alarm failed; retrying");
                }
            }
            self.wait(time::sleep(pause)).await;
            pause = (2 * pause).min(LONGEST_PAUSE);
        }
        self.shared.status.edit().webhook_fails = false;
        for (row, alarm) in pending {
            if let Some(row) = row {
                self.last = row;
            } else {
                // The judge replaced an older event of the alarm, except its raise, by this one.
                self.early.retain(|early| early.alarm_id != alarm.alarm_id || early.event_no == 1);
                self.early.push_back(alarm);
            }
        }
        let older = self.early.len().saturating_sub(EARLY);
        self.early.drain(..older);
        // While removals fail, no alarm waits for the next attempt.
        if !self.removal_failed {
            self.remove().await;
        }
    }

    /// Removes the notifications that need not be sent any more.
    async fn remove(&mut self) {
        let removed = self.wait(self.shared.store.notified(self.last)).await;
        self.removal_failed = removed.is_err();
        if let Err(error) = removed {
            seldom!(warn, %error, "removing sent notifications failed; they may be sent again");
        }
    }

    /// Waits until `end`, with heartbeats: a loop that waits on purpose does not hang.
    async fn wait<T>(&self, end: impl Future<Output = T>) -> T {
        let (mut end, mut pace) = (pin!(end), clock::every(BEAT));
        loop {
            tokio::select! {
                biased;
                _ = pace.tick() => self.beat(),
                ended = &mut end => return ended,
            }
        }
    }

    fn beat(&self) {
        self.shared.status.heartbeats.beat(TaskName::Webhook);
    }
}
