//! Sends alarm events to the webhook, in order and at least once. An event stays in the database until the receiver has
//! accepted it, or has refused it as a message that it cannot use. In a flood many events become one summary.

mod post;
mod summary;

use std::{
    pin::pin,
    sync::Arc,
    time::{Duration, Instant},
};

use tokio::{sync::Notify, time};

use super::{
    clock,
    config::{Config, Webhook},
    error::StartError,
    supervision::{heartbeat::TaskName, status::Status},
};
use crate::{
    store::{Store, seldom},
    throw::MachineId,
    wire::{self, Alarm},
};
use post::{PostError, WebhookServer};
use summary::Summary;

/// Pause after the first failed attempt; doubled with each further attempt up to [`LONGEST_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_secs(1);
/// Longest pause between two attempts: the longest delay of an alarm after the receiver works again.
const LONGEST_PAUSE: Duration = Duration::from_mins(1);
/// Time between two heartbeats during a wait.
const BEAT: Duration = Duration::from_secs(5);
/// Number of notifications read for the next message. Further ones are read only if the filters remove all of them.
const BATCH: u32 = 64;
/// Number of notifications read for a summary: all that the store keeps.
const ALL: u32 = 10_000;

/// The sending loop.
pub(super) struct Notifier {
    store: Store,
    settings: Webhook,
    server: WebhookServer,
    monitor: MachineId,
    status: Arc<Status>,
    /// Notified when an alarm event is stored.
    wake: Arc<Notify>,
    /// Time in which at most `webhook.max_messages` messages are sent.
    period: Duration,
    /// Start of the present period, and number of messages sent in it.
    sent: (Instant, u32),
}

impl Notifier {
    /// Prepares the loop; `None` if no webhook is configured.
    ///
    /// # Errors
    /// When the database or the certificates cannot be used.
    pub(super) async fn new(
        store: Store,
        config: &Config,
        status: Arc<Status>,
        wake: Arc<Notify>,
    ) -> Result<Option<Self>, StartError> {
        let server = WebhookServer::new(&config.webhook).map_err(StartError::Webhook)?;
        store.set_webhook(server.is_some()).await?;
        let (settings, monitor) = (config.webhook.clone(), config.monitor.as_machine());
        let (period, sent) = (Duration::from_secs_f64(settings.period_s), (clock::monotonic(), 0));
        Ok(server.map(|server| Self { store, settings, server, monitor, status, wake, period, sent }))
    }

    /// Runs until the future is dropped.
    pub(super) async fn run(mut self) {
        loop {
            if self.sent.0.elapsed() >= self.period {
                self.sent = (clock::monotonic(), 0);
            }
            let is_flood = self.sent.1 >= self.settings.max_messages;
            let mut pending = self.pending(BATCH).await;
            if pending.is_empty() {
                self.wait(self.wake.notified()).await;
                continue;
            }
            if is_flood {
                self.wait(time::sleep_until((self.sent.0 + self.period).into())).await;
                pending = self.pending(ALL).await;
            } else {
                pending.truncate(1);
            }
            self.sent.1 += 1;
            self.deliver(&pending).await;
        }
    }

    /// Reads up to `limit` pending events, and returns those that pass the filters. If none passes, the events are
    /// removed, and the next ones are read. Empty if no event is pending.
    async fn pending(&self, limit: u32) -> Vec<(i64, Alarm)> {
        loop {
            let rows = match self.store.reader().notifications(limit).await {
                Ok(rows) => rows,
                Err(error) => {
                    seldom!(warn, %error, "reading the notifications failed; retrying");
                    self.wait(time::sleep(FIRST_PAUSE)).await;
                    continue;
                }
            };
            let Some((last, _)) = rows.last() else { return Vec::new() };
            let last = *last;
            let read = |(row, payload): (i64, String)| match serde_json::from_str::<Alarm>(&payload) {
                Ok(alarm) => Some((row, alarm)),
                Err(error) => {
                    tracing::error!(row, %error, "an alarm event that another version stored cannot be read: it is LOST for the webhook");
                    None
                }
            };
            let wanted = rows.into_iter().filter_map(read).filter(|(_, alarm)| self.settings.wants(alarm));
            let wanted: Vec<_> = wanted.collect();
            if !wanted.is_empty() {
                return wanted;
            }
            self.remove(last).await;
        }
    }

    /// Sends events in one message, a single event as it is and several as a summary, again and again until the receiver
    /// accepts or refuses it. Then removes their notifications.
    async fn deliver(&self, pending: &[(i64, Alarm)]) {
        let Some((last, alarm)) = pending.last() else { return };
        let (events, mut pause) = (pending.len() as u64, FIRST_PAUSE);
        let alarms = pending.iter().map(|(_, alarm)| alarm);
        let body =
            if events == 1 { wire::json(alarm) } else { wire::json(&Summary::of(alarms.collect(), &self.monitor)) };
        loop {
            self.beat();
            match self.server.post(body.clone().into()).await {
                Ok(()) => break,
                Err(error @ PostError::Refused(_)) => {
                    tracing::error!(%error, events, body, "webhook: the receiver refuses alarm events, which are not sent again");
                    self.status.edit().webhook_refused += events;
                    break;
                }
                Err(error) => {
                    self.status.edit().webhook_fails = true;
                    seldom!(warn, %error, "webhook: sending an alarm failed; retrying");
                }
            }
            self.wait(time::sleep(pause)).await;
            pause = (2 * pause).min(LONGEST_PAUSE);
        }
        self.status.edit().webhook_fails = false;
        self.remove(*last).await;
    }

    /// Removes the notifications up to a row.
    async fn remove(&self, last: i64) {
        while let Err(error) = self.store.notified(last).await {
            seldom!(warn, %error, "removing sent notifications failed; they may be sent again");
            self.wait(time::sleep(FIRST_PAUSE)).await;
        }
    }

    /// Waits until `end`, with heartbeats: a loop that waits on purpose does not hang.
    async fn wait(&self, end: impl Future<Output = ()>) {
        let (mut end, mut pace) = (pin!(end), time::interval(BEAT));
        loop {
            tokio::select! {
                biased;
                _ = pace.tick() => self.beat(),
                () = &mut end => return,
            }
        }
    }

    fn beat(&self) {
        self.status.heartbeats.beat(TaskName::Webhook);
    }
}
