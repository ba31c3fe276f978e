//! Throws as they arrive: an advanced subscriber that recovers what a cut link missed, and a bounded queue.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    time::Duration,
};

use tokio::sync::mpsc;
use zenoh::{
    Session,
    sample::{Sample, SampleKind},
};
use zenoh_ext::{AdvancedSubscriber, AdvancedSubscriberBuilderExt, HistoryConfig, Miss, RecoveryConfig};

use super::{
    BusError,
    room::{self, Room},
};

/// Payloads of one batch: what is decoded takes up to four times as much \[bytes\].
const BATCH_BYTES: usize = 8 << 20;
/// How long the caches of loggers are given to answer for missed throws.
const RECOVERY_TIMEOUT: Duration = Duration::from_secs(20);
/// What is known of a publisher that went, some kilobytes, is kept for so long. After a longer absence it is asked for all
/// that it has cached; what was stored before counts as a duplicate.
const PUBLISHER_MEMORY: Duration = Duration::from_mins(10);

/// One message as it arrived.
#[derive(Debug)]
pub struct Message {
    /// The key it came on.
    pub key: String,
    /// Its content type; empty when the sender gave none.
    pub content_type: String,
    /// The payload; of one that is too large, only the beginning.
    pub payload: Vec<u8>,
    /// The size of the whole payload \[bytes\].
    pub bytes: usize,
}

/// What bounds the inbox.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Largest payload that is taken whole \[bytes\].
    pub max_payload_bytes: usize,
    /// How much of a larger one is kept as a sample \[bytes\].
    pub kept_of_larger_bytes: usize,
}

/// Counts that only grow.
#[derive(Debug, Default)]
pub struct InboxCounters {
    /// Messages that arrived.
    pub received: AtomicU64,
    /// Messages that were dropped because the queue was full.
    pub dropped: AtomicU64,
    /// Samples that zenoh reports as missed beyond recovery.
    pub missed: AtomicU64,
    room: Arc<Room>,
}

impl InboxCounters {
    /// Room that the messages take that wait to be stored \[bytes\].
    #[must_use]
    pub fn queued_bytes(&self) -> usize {
        self.room.taken()
    }
}

/// The subscription and its queue.
pub struct Inbox {
    subscriber: Option<AdvancedSubscriber<()>>,
    messages: mpsc::Receiver<Message>,
    room: Arc<Room>,
    counters: Arc<InboxCounters>,
}

impl Inbox {
    /// Subscribes to a key expression.
    ///
    /// # Errors
    /// When zenoh refuses the subscription.
    pub async fn subscribe(session: &Session, key_expression: &str, limits: Limits) -> Result<Self, BusError> {
        let (sender, messages) = mpsc::channel(room::MESSAGES);
        let room = Arc::new(Room::new());
        let counters = Arc::new(InboxCounters { room: Arc::clone(&room), ..InboxCounters::default() });
        let (taking, counting) = (Arc::clone(&room), Arc::clone(&counters));
        let subscriber = session
            .declare_subscriber(key_expression.to_owned())
            .callback(move |sample| take(&sample, &sender, &taking, &counting, limits))
            .history(HistoryConfig::default().detect_late_publishers())
            .recovery(RecoveryConfig::default().heartbeat().retention_period(PUBLISHER_MEMORY))
            .query_timeout(RECOVERY_TIMEOUT)
            .await
            .map_err(BusError::new(format!("subscribe to {key_expression}")))?;
        let counting = Arc::clone(&counters);
        subscriber
            .sample_miss_listener()
            .callback(move |miss: Miss| {
                counting.missed.fetch_add(u64::from(miss.nb()), Relaxed);
            })
            .background()
            .await
            .map_err(BusError::new("listen for missed samples"))?;
        Ok(Self { subscriber: Some(subscriber), messages, room, counters })
    }

    /// The counts.
    #[must_use]
    pub fn counters(&self) -> Arc<InboxCounters> {
        Arc::clone(&self.counters)
    }

    /// Waits for messages and moves up to `limit` of them into `batch`, fewer when they are large; returns how many. 0
    /// after [`Self::close`], once the queue is empty.
    pub async fn receive(&mut self, batch: &mut Vec<Message>, limit: usize) -> usize {
        let before = batch.len();
        let mut next = self.messages.recv().await;
        let mut bytes = 0;
        while let Some(message) = next {
            self.room.give_back(&message.key, message.payload.len());
            bytes += message.payload.len();
            batch.push(message);
            let is_full = batch.len() - before >= limit || bytes >= BATCH_BYTES;
            next = if is_full { None } else { self.messages.try_recv().ok() };
        }
        batch.len() - before
    }

    /// Messages that wait.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.messages.len()
    }

    /// Ends the subscription. What waits in the queue can still be received.
    pub async fn close(&mut self) {
        if let Some(subscriber) = self.subscriber.take()
            && let Err(error) = subscriber.undeclare().await
        {
            tracing::warn!(%error, "the subscription could not be ended in good order");
        }
        self.messages.close();
    }
}

/// Runs in zenoh's thread: counts, copies, hands over, returns; in a burst, as soon as there is room.
fn take(sample: &Sample, queue: &mpsc::Sender<Message>, room: &Room, counters: &InboxCounters, limits: Limits) {
    if sample.kind() != SampleKind::Put {
        return;
    }
    counters.received.fetch_add(1, Relaxed);
    let (key, bytes) = (sample.key_expr().as_str(), sample.payload().len());
    let kept = if bytes > limits.max_payload_bytes { limits.kept_of_larger_bytes } else { bytes };
    if !room.wait_for(key, kept) {
        counters.dropped.fetch_add(1, Relaxed);
        return;
    }
    let mut payload = Vec::with_capacity(kept);
    for slice in sample.payload().slices() {
        let left = kept - payload.len();
        payload.extend_from_slice(&slice[..slice.len().min(left)]);
    }
    let message = Message { key: key.to_owned(), content_type: sample.encoding().to_string(), payload, bytes };
    if queue.try_send(message).is_err() {
        room.give_back(key, kept);
        counters.dropped.fetch_add(1, Relaxed);
    }
}
