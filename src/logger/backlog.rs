//! The last throws of a machine, for daemons that were away: a queryable on the throw key gives them page by page.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc},
    thread,
};

use zenoh::{
    Session, Wait,
    bytes::{Encoding, ZBytes},
    query::{Query, Queryable},
};

use super::error::LoggerError;
use crate::{throw::ThrowRef, wire::BacklogQuery};

/// Queries that may be queued, of all machines; a daemon asks for one page of a machine at a time.
const QUERIES: usize = 256;

/// Throws of one machine, oldest first, up to a number and a size.
#[derive(Debug)]
struct Kept {
    throws: VecDeque<(ThrowRef, ZBytes)>,
    bytes: usize,
    max_throws: usize,
    max_bytes: usize,
}

/// The backlog of one machine. Its queryable answers until this is dropped.
pub(super) struct Backlog {
    kept: Arc<Mutex<Kept>>,
    _queryable: Queryable<()>,
}

/// A query and the backlog that it is about.
struct Question {
    query: Query,
    kept: Arc<Mutex<Kept>>,
}

/// The thread that answers: a reply waits for a slow link, which a callback of zenoh must not.
#[derive(Clone)]
pub(super) struct Answering(mpsc::SyncSender<Question>);

impl Answering {
    /// Starts the thread. It ends when this and all backlogs are dropped.
    pub(super) fn start() -> std::io::Result<Self> {
        let (sender, questions) = mpsc::sync_channel::<Question>(QUERIES);
        thread::Builder::new().name("backlog".into()).spawn(move || {
            for Question { query, kept } in questions {
                answer(&query, &kept);
            }
        })?;
        Ok(Self(sender))
    }

    /// Declares the backlog of a machine on its throw key.
    pub(super) fn declare(
        &self,
        session: &Session,
        key: &str,
        max_throws: usize,
        max_bytes: usize,
    ) -> Result<Backlog, LoggerError> {
        let kept = Arc::new(Mutex::new(Kept { throws: VecDeque::new(), bytes: 0, max_throws, max_bytes }));
        let (questions, asked) = (self.0.clone(), Arc::clone(&kept));
        let queryable = session
            .declare_queryable(key.to_owned())
            .callback(move |query| {
                // A daemon that gets no answer asks again.
                let _ = questions.try_send(Question { query, kept: Arc::clone(&asked) });
            })
            .wait()?;
        Ok(Backlog { kept, _queryable: queryable })
    }
}

impl Backlog {
    /// Keeps a throw as it is published; the oldest make room.
    pub(super) fn keep(&self, throw: ThrowRef, message: ZBytes) {
        let mut kept = lock(&self.kept);
        kept.bytes += message.len();
        kept.throws.push_back((throw, message));
        while kept.throws.len() > kept.max_throws || (kept.bytes > kept.max_bytes && kept.throws.len() > 1) {
            let Some((_, oldest)) = kept.throws.pop_front() else { break };
            kept.bytes -= oldest.len();
        }
    }
}

fn lock(kept: &Mutex<Kept>) -> MutexGuard<'_, Kept> {
    kept.lock().unwrap_or_else(PoisonError::into_inner)
}

fn answer(query: &Query, kept: &Mutex<Kept>) {
    let asked = BacklogQuery::parse(query.parameters().as_str());
    let page: Vec<ZBytes> = {
        let kept = lock(kept);
        let start = asked.start(kept.throws.iter().map(|(throw, _)| throw));
        kept.throws.iter().skip(start).take(asked.limit).map(|(_, message)| message.clone()).collect()
    };
    for message in page {
        if let Err(error) = query.reply(query.key_expr().clone(), message).encoding(Encoding::APPLICATION_CBOR).wait() {
            tracing::debug!(%error, "a page of the backlog was not taken");
            return;
        }
    }
}
