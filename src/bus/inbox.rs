//! Live throws, in a bounded queue.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering::Relaxed},
};

use tokio::sync::mpsc;
use zenoh::{
    Session,
    pubsub::Subscriber,
    sample::{Sample, SampleKind},
};

use super::{
    error::BusError,
    message::{Limits, Message},
    room::{self, Room},
};

/// Payloads of one batch: what is decoded takes up to four times as much \[bytes\].
const BATCH_BYTES: usize = 8 << 20;
/// Keys of dropped messages that wait for the backlog to be asked. Beyond that the next throw of a machine shows the gap.
const DROPPED_KEYS: usize = 1_024;

/// Counts that only grow, and the queue.
#[derive(Debug, Default)]
pub struct InboxCounters {
    /// Messages that arrived.
    pub received: AtomicU64,
    /// Messages that were dropped because the queue was full, or their sender had more than its share of it.
    pub dropped: AtomicU64,
    room: Room,
}

impl InboxCounters {
    /// Memory that the queued messages take \[bytes\].
    #[must_use]
    pub fn queued_bytes(&self) -> usize {
        self.room.taken()
    }
}

/// The subscription to live throws and its queue.
pub struct Inbox {
    subscriber: Option<Subscriber<()>>,
    messages: mpsc::Receiver<Message>,
    counters: Arc<InboxCounters>,
}

impl Inbox {
    /// Subscribes to a key expression. The receiver gets the keys of messages that were dropped.
    ///
    /// # Errors
    /// When zenoh refuses the subscription.
    pub async fn subscribe(
        session: &Session,
        key_expression: &str,
        limits: Limits,
    ) -> Result<(Self, mpsc::Receiver<String>), BusError> {
        let (sender, messages) = mpsc::channel(room::MESSAGES);
        let (dropped, dropped_keys) = mpsc::channel(DROPPED_KEYS);
        let counters = Arc::<InboxCounters>::default();
        let callback = Callback { messages: sender, dropped, counters: Arc::clone(&counters), limits };
        let subscriber = session
            .declare_subscriber(key_expression.to_owned())
            .callback(move |sample| callback.on_sample(&sample))
            .await
            .map_err(BusError::new(format!("subscribe to {key_expression}")))?;
        Ok((Self { subscriber: Some(subscriber), messages, counters }, dropped_keys))
    }

    /// The counts.
    #[must_use]
    pub fn counters(&self) -> Arc<InboxCounters> {
        Arc::clone(&self.counters)
    }

    /// Waits for messages and moves up to `limit` of them into `batch`, fewer when they are large; returns how many. 0
    /// after [`Self::close`], once the queue is empty. Cancel safe.
    pub async fn receive(&mut self, batch: &mut Vec<Message>, limit: usize) -> usize {
        let before = batch.len();
        let mut next = self.messages.recv().await;
        let mut bytes = 0;
        while let Some(message) = next {
            self.counters.room.give_back(&message.key, message.memory());
            bytes += message.memory();
            batch.push(message);
            let is_full = batch.len() - before >= limit || bytes >= BATCH_BYTES;
            next = if is_full { None } else { self.messages.try_recv().ok() };
        }
        batch.len() - before
    }

    /// Ends the subscription. Queued messages can still be received.
    pub async fn close(&mut self) {
        if let Some(subscriber) = self.subscriber.take()
            && let Err(error) = subscriber.undeclare().await
        {
            tracing::warn!(%error, "the subscription could not be ended in good order");
        }
        self.messages.close();
    }
}

/// Runs in zenoh's threads: counts, copies, queues, returns.
struct Callback {
    messages: mpsc::Sender<Message>,
    dropped: mpsc::Sender<String>,
    counters: Arc<InboxCounters>,
    limits: Limits,
}

impl Callback {
    fn on_sample(&self, sample: &Sample) {
        if sample.kind() != SampleKind::Put {
            return;
        }
        self.counters.received.fetch_add(1, Relaxed);
        let (key, content_type) = (sample.key_expr().as_str(), sample.encoding().to_string());
        let memory = self.limits.kept(sample.payload().len()) + key.len() + content_type.len();
        if self.counters.room.take(key, memory) {
            if self.messages.try_send(Message::of(sample, self.limits)).is_ok() {
                return;
            }
            self.counters.room.give_back(key, memory);
        }
        self.counters.dropped.fetch_add(1, Relaxed);
        // A full queue has the key already, or the next throw shows the gap.
        let _ = self.dropped.try_send(key.to_owned());
    }
}
