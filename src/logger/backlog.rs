//! The backlog of a machine: its last throws, which a queryable on the throw key gives page by page.

use std::{
    collections::VecDeque,
    sync::{Arc, mpsc},
    thread,
};

use parking_lot::Mutex;
use zenoh::{
    Session, Wait,
    bytes::{Encoding, ZBytes},
    query::{Query, Queryable},
};

use super::error::LoggerError;
use crate::{bus::BusError, throw::ThrowRef, wire::BacklogQuery};

/// Name of the thread that answers the queries.
const THREAD: &str = "backlog";
/// Capacity of the queue of queries, for all machines together; a daemon queries one page of a machine at a time.
const QUEUE: usize = 256;

/// Throws of one machine, oldest first, limited in number and bytes.
#[derive(Debug)]
struct Kept {
    throws: VecDeque<(ThrowRef, ZBytes)>,
    bytes: usize,
    max_throws: usize,
    max_bytes: usize,
}

/// The backlog of one machine. Dropping it ends its queryable.
pub(super) struct Backlog {
    kept: Arc<Mutex<Kept>>,
    _queryable: Queryable<()>,
}

/// The thread that sends the replies: a reply blocks on a slow link, and a callback of zenoh must not block. It gets
/// each query with the throws of its machine.
pub(super) struct AnswerThread(mpsc::SyncSender<(Query, Arc<Mutex<Kept>>)>);

impl AnswerThread {
    /// Starts the thread. It ends when the handle and all backlogs are dropped.
    pub(super) fn start() -> Result<Self, LoggerError> {
        let (sender, requests) = mpsc::sync_channel::<(Query, Arc<Mutex<Kept>>)>(QUEUE);
        let spawned = thread::Builder::new().name(THREAD.into()).spawn(move || {
            for (query, kept) in requests {
                answer(&query, &kept);
            }
        });
        spawned.map_err(|source| LoggerError::Spawn { thread: THREAD, source })?;
        Ok(Self(sender))
    }

    /// Declares the backlog of a machine on its throw key, with its limits. A query on a wildcard is for other data, and
    /// gets no throws.
    pub(super) fn declare(
        &self,
        session: &Session,
        key: &str,
        max_throws: usize,
        max_bytes: usize,
    ) -> Result<Backlog, LoggerError> {
        let kept = Arc::new(Mutex::new(Kept { throws: VecDeque::new(), bytes: 0, max_throws, max_bytes }));
        let (requests, answered, own_key) = (self.0.clone(), Arc::clone(&kept), key.to_owned());
        let queryable = session
            .declare_queryable(key.to_owned())
            .callback(move |query| {
                if query.key_expr().as_str() != own_key {
                    return;
                }
                // If the queue is full, the query ends without a reply, as if there were no newer throws. A daemon
                // sends at most eight queries at a time, so the queue does not fill.
                let _ = requests.try_send((query, Arc::clone(&answered)));
            })
            .wait()
            .map_err(BusError::new("declare the backlog of a logger"))?;
        Ok(Backlog { kept, _queryable: queryable })
    }
}

impl Backlog {
    /// Adds a published message; drops the oldest beyond the limits.
    pub(super) fn keep(&self, throw: ThrowRef, message: ZBytes) {
        let mut kept = self.kept.lock();
        kept.bytes += message.len();
        kept.throws.push_back((throw, message));
        while kept.throws.len() > kept.max_throws || (kept.bytes > kept.max_bytes && kept.throws.len() > 1) {
            let Some((_, oldest)) = kept.throws.pop_front() else { break };
            kept.bytes -= oldest.len();
        }
    }
}

fn answer(query: &Query, kept: &Mutex<Kept>) {
    let wanted = BacklogQuery::parse(query.parameters().as_str());
    let page: Vec<ZBytes> = {
        let kept = kept.lock();
        let start = wanted.start(kept.throws.iter().map(|(throw, _)| throw));
        kept.throws.iter().skip(start).take(wanted.limit).map(|(_, message)| message.clone()).collect()
    };
    for message in page {
        if let Err(error) = query.reply(query.key_expr().clone(), message).encoding(Encoding::APPLICATION_CBOR).wait() {
            tracing::debug!(%error, "sending a page of the backlog failed");
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::config_without_links;

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn only_a_query_on_the_throw_key_gets_throws() {
        const KEY: &str = "points/v1/north/21B/throw";
        let session = zenoh::open(config_without_links()).await.unwrap();
        let backlog = AnswerThread::start().unwrap().declare(&session, KEY, 10, 1_000).unwrap();
        backlog.keep(ThrowRef { boot_id: "boot".to_owned(), throw_no: 1 }, ZBytes::from("throw"));
        for (selector, expected) in [(KEY, 1), ("points/v1/north/21B/*", 0), ("points/v1/**?limit=10", 0)] {
            let replies = session.get(selector).await.unwrap();
            let mut found = 0;
            while let Ok(reply) = replies.recv_async().await {
                assert_eq!(reply.result().unwrap().key_expr().as_str(), KEY);
                found += 1;
            }
            assert_eq!(found, expected, "{selector}");
        }
    }
}
