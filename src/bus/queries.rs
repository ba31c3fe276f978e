//! Queries on health, alarms and commands, through bounded queues of queries and of replies.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering::Relaxed},
};

use tokio::{
    runtime::Handle,
    sync::{
        OwnedSemaphorePermit, Semaphore,
        mpsc::{self, error::TrySendError},
    },
    time::Instant,
};
use zenoh::{
    Session, Wait,
    bytes::{Encoding, ZBytes},
    query::{Query, Queryable},
};

use super::{error::BusError, operator::ANSWER_TIMEOUT};

/// Capacity of the queue \[queries\]: a dashboard sends a few queries per second.
const QUEUE: usize = 64;
/// Number of queries whose replies are sent at the same time: a client on a slow link does not delay the others.
const SENDING: usize = 8;
/// Permits for the error reply to a query above [`MAX_BYTES`], which stays in memory until the reply is sent: half of
/// [`SENDING`], so that at most two are in memory.
const LARGE: u32 = 4;
/// Largest query that gets this error reply \[bytes\]; larger ones get none, as a slow link keeps them in memory.
const MAX_REFUSED_BYTES: usize = 1 << 20;
/// Error reply to a query that found the queue full, or waited in it for longer than [`ANSWER_TIMEOUT`].
const BUSY: &str = "too many queries wait at this daemon: ask again in some seconds";
/// Largest query \[bytes\]; commands have a few hundred. With [`QUEUE`], it limits the memory of waiting queries.
const MAX_BYTES: usize = 64 << 10;

/// A queryable with a bounded queue of queries.
pub struct QueryQueue {
    /// The queries, each with the time of its arrival.
    waiting: mpsc::Receiver<(Instant, Query)>,
    dropped: Arc<AtomicU64>,
    /// A permit for each query whose replies are being sent.
    sending: Arc<Semaphore>,
    _queryable: Queryable<()>,
}

impl QueryQueue {
    /// Declares the queryable.
    ///
    /// # Errors
    /// When zenoh refuses the key expression.
    pub async fn declare(session: &Session, key_expression: &str) -> Result<Self, BusError> {
        let (sender, waiting) = mpsc::channel(QUEUE);
        let dropped = Arc::<AtomicU64>::default();
        let sending = Arc::new(Semaphore::new(SENDING));
        let (counter, permits, runtime) = (Arc::clone(&dropped), Arc::clone(&sending), Handle::current());
        let queryable = session
            .declare_queryable(key_expression.to_owned())
            .callback(move |query: Query| {
                // A waiting query stays in memory, so a large one does not wait.
                let bytes = bytes(&query);
                if bytes > MAX_BYTES {
                    counter.fetch_add(1, Relaxed);
                    if bytes <= MAX_REFUSED_BYTES {
                        let problem = format!("the query has {bytes} bytes, must be at most {MAX_BYTES}");
                        refuse(&runtime, query, problem, &permits, LARGE);
                    }
                } else if let Err(TrySendError::Full((_, query))) = sender.try_send((Instant::now(), query)) {
                    counter.fetch_add(1, Relaxed);
                    refuse(&runtime, query, BUSY.to_owned(), &permits, 1);
                }
            })
            .await
            .map_err(BusError::new(format!("answer queries on {key_expression}")))?;
        Ok(Self { waiting, dropped, sending, _queryable: queryable })
    }

    /// Number of queries refused since the last call: the queue was full, they waited too long, or they were too large.
    pub fn take_dropped(&self) -> u64 {
        self.dropped.swap(0, Relaxed)
    }

    /// The next query with the time of its arrival; `None` when the session is closed. Queries that waited for longer
    /// than the programs of operators do are refused: nobody would receive their answer, and an expired command must
    /// not be applied. Cancel safe.
    pub async fn next(&mut self) -> Option<(Instant, Query)> {
        loop {
            let (arrived, query) = self.waiting.recv().await?;
            if arrived.elapsed() < ANSWER_TIMEOUT {
                return Some((arrived, query));
            }
            self.dropped.fetch_add(1, Relaxed);
            refuse(&Handle::current(), query, BUSY.to_owned(), &self.sending, 1);
        }
    }

    /// Replies to a query with JSON messages, each on its key, or with one error text. Returns before the replies are
    /// sent, but first waits while replies to `SENDING` other queries are being sent.
    pub(crate) async fn answer(&self, question: Query, replies: Result<Vec<(String, Vec<u8>)>, String>) {
        // The result is always `Ok`, as nothing closes the semaphore.
        if let Ok(permit) = Arc::clone(&self.sending).acquire_owned().await {
            send(&Handle::current(), question, replies, permit);
        }
    }
}

/// The memory of a query, all of whose parts may be large.
fn bytes(query: &Query) -> usize {
    let encoding = query.encoding().map_or(0, |encoding| encoding.to_string().len());
    let parts = [query.payload(), query.attachment()].into_iter().flatten().map(ZBytes::len);
    query.key_expr().as_str().len() + query.parameters().as_str().len() + encoding + parts.sum::<usize>()
}

/// Replies with a problem, and uses this number of permits meanwhile. While slow links use too many, the query ends
/// without a reply.
fn refuse(runtime: &Handle, query: Query, problem: String, permits: &Arc<Semaphore>, count: u32) {
    if let Ok(permit) = Arc::clone(permits).try_acquire_many_owned(count) {
        send(runtime, query, Err(problem), permit);
    }
}

/// Sends replies on a blocking thread: a reply blocks on a slow link, until zenoh closes the link after 5 s without
/// progress.
fn send(runtime: &Handle, query: Query, replies: Result<Vec<(String, Vec<u8>)>, String>, permit: OwnedSemaphorePermit) {
    runtime.spawn_blocking(move || {
        let _permit = permit;
        let failed = |error| tracing::debug!(%error, "sending a reply failed");
        match replies {
            Ok(messages) => {
                for (key, payload) in messages {
                    query.reply(key, payload).encoding(Encoding::APPLICATION_JSON).wait().unwrap_or_else(failed);
                }
            }
            Err(problem) => query.reply_err(problem).encoding(Encoding::TEXT_PLAIN).wait().unwrap_or_else(failed),
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::config_without_links;

    /// A session without links, and its queue.
    async fn alone() -> (Session, QueryQueue) {
        let session = zenoh::open(config_without_links()).await.unwrap();
        let queue = QueryQueue::declare(&session, "points/v1/north/21B/health").await.unwrap();
        (session, queue)
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_large_query_does_not_wait() {
        let (session, queue) = alone().await;
        let large = || "x".repeat(MAX_BYTES);
        let get = |parameters: &str| session.get(format!("points/v1/north/21B/health?{parameters}"));
        for get in [
            get(&large()),
            get("").payload(large()),
            get("").attachment(large()),
            get("").payload("x").encoding(Encoding::from(large())),
        ] {
            let reply = get.await.unwrap().recv_async().await.unwrap();
            let problem = reply.result().unwrap_err().payload().try_to_string().unwrap().into_owned();
            assert!(problem.ends_with("bytes, must be at most 65536"), "{problem}");
        }
        assert_eq!((queue.take_dropped(), queue.waiting.len()), (4, 0));
        let _small = get("limit=1").await.unwrap();
        assert_eq!((queue.take_dropped(), queue.waiting.len()), (0, 1));
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_query_that_waited_too_long_is_refused() {
        let (session, mut queue) = alone().await;
        let (sender, waiting) = mpsc::channel(2);
        let mut arriving = std::mem::replace(&mut queue.waiting, waiting);
        let ask = async |selector: &str| session.get(selector.to_owned()).await.unwrap();
        let late = ask("points/v1/north/21B/health?late").await;
        let (arrived, query) = arriving.recv().await.unwrap();
        sender.try_send((arrived.checked_sub(ANSWER_TIMEOUT).unwrap(), query)).unwrap();
        let fresh = ask("points/v1/north/21B/health?fresh").await;
        sender.try_send(arriving.recv().await.unwrap()).unwrap();
        assert_eq!(queue.next().await.unwrap().1.parameters().as_str(), "fresh");
        let reply = late.recv_async().await.unwrap();
        assert_eq!(reply.result().unwrap_err().payload().try_to_string().unwrap(), BUSY);
        assert!(fresh.is_empty() && queue.take_dropped() == 1);
    }
}
