//! The inbox: the subscription to live throws and its bounded queue.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    time::Duration,
};

use tokio::{
    sync::{Notify, mpsc},
    task, time,
};
use zenoh::{Session, Wait, pubsub::Subscriber, sample::Sample};

use super::{
    error::BusError,
    fair_queue::FairQueue,
    message::{Message, kept},
};

/// Payload after which a batch is full \[bytes\]; decoded throws take up to four times as much memory.
const BATCH_BYTES: usize = 8 << 20;
/// Capacity of the queue with the keys of dropped messages. If the queue is full, a key may be lost: the next throw of
/// its machine shows the gap too.
const DROPPED_KEYS: usize = 1_024;
/// Time limit of the close. A callback copies one message, which takes milliseconds.
const CLOSE_LIMIT: Duration = Duration::from_millis(500);

/// The queue of the inbox, and its counters since the start.
#[derive(Debug, Default)]
pub(crate) struct InboxCounters {
    pub received: AtomicU64,
    /// Messages dropped because the queue was full or their key had used its share.
    pub dropped: AtomicU64,
    queue: FairQueue,
    /// Notified when a message was queued.
    queued: Notify,
}

impl InboxCounters {
    /// Memory of the queued messages \[bytes\].
    pub(crate) fn queued_bytes(&self) -> usize {
        self.queue.bytes()
    }
}

/// The subscription to live throws and its queue.
pub(crate) struct Inbox {
    subscriber: Option<Subscriber<()>>,
    counters: Arc<InboxCounters>,
}

impl Inbox {
    /// Subscribes to a key expression. The returned receiver gets the keys of dropped messages.
    pub(crate) async fn subscribe(
        session: &Session,
        key_expression: &str,
        max_payload_bytes: usize,
        counters: Arc<InboxCounters>,
    ) -> Result<(Self, mpsc::Receiver<String>), BusError> {
        let (dropped, dropped_keys) = mpsc::channel(DROPPED_KEYS);
        let counting = Arc::clone(&counters);
        // It runs in the threads of zenoh, so it never waits.
        let on_sample = move |sample: Sample| {
            counting.received.fetch_add(1, Relaxed);
            let (key, content_type) = (sample.key_expr().as_str(), sample.encoding().to_string());
            let memory = kept(sample.payload().len(), max_payload_bytes) + key.len() + content_type.len();
            if counting.queue.push(key, memory, || Message::of(&sample, max_payload_bytes)) {
                return counting.queued.notify_one();
            }
            counting.dropped.fetch_add(1, Relaxed);
            // A key that does not fit may be lost: see `DROPPED_KEYS`.
            let _ = dropped.try_send(key.to_owned());
        };
        let subscriber = session
            .declare_subscriber(key_expression.to_owned())
            .callback(on_sample)
            .await
            .map_err(BusError::new(format!("subscribe to {key_expression}")))?;
        Ok((Self { subscriber: Some(subscriber), counters }, dropped_keys))
    }

    /// Waits for messages and moves up to `limit` of them into `batch`, fewer if they are large. Returns the number of
    /// moved messages: 0 only when the queue is empty after [`Self::close`]. Cancel safe.
    pub(crate) async fn receive(&mut self, batch: &mut Vec<Message>, limit: usize) -> usize {
        let before = batch.len();
        loop {
            let mut bytes = 0;
            while batch.len() - before < limit && bytes < BATCH_BYTES {
                let Some(message) = self.counters.queue.pop() else { break };
                bytes += message.memory();
                batch.push(message);
            }
            if batch.len() > before || self.subscriber.is_none() {
                return batch.len() - before;
            }
            self.counters.queued.notified().await;
        }
    }

    /// Ends the subscription without waiting, removes the queued messages, and returns their number.
    pub(crate) fn discard(&mut self) -> usize {
        drop(self.subscriber.take());
        std::iter::from_fn(|| self.counters.queue.pop()).count()
    }

    /// Ends the subscription, and waits for the messages that are being queued. Queued messages can still be received.
    pub(crate) async fn close(&mut self) {
        let Some(subscriber) = self.subscriber.take() else { return };
        // On a blocking thread, as it blocks until the callbacks have returned.
        let undeclare = task::spawn_blocking(move || subscriber.undeclare().wait_callbacks().wait());
        let closed = time::timeout(CLOSE_LIMIT, undeclare).await;
        if !matches!(closed, Ok(Ok(Ok(())))) {
            tracing::warn!(?closed, "ending the subscription failed, or takes too long");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::config_without_links;

    /// The copy of the message takes longer than the close of the subscription.
    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_message_that_is_being_queued_at_the_close_is_received() {
        const KEY: &str = "points/v1/north/21B/throw";
        let session = zenoh::open(config_without_links()).await.unwrap();
        let counters = Arc::<InboxCounters>::default();
        let (mut inbox, _dropped) = Inbox::subscribe(&session, KEY, usize::MAX, Arc::clone(&counters)).await.unwrap();
        let payload = vec![0; 48 << 20];
        let put = task::spawn_blocking(move || session.put(KEY, payload).wait());
        while counters.received.load(Relaxed) == 0 {
            task::yield_now().await;
        }
        inbox.close().await;
        assert_eq!(inbox.receive(&mut Vec::new(), 1).await, 1);
        put.await.unwrap().unwrap();
    }
}
