//! Publishes alarms and health from two threads of their own, as a put blocks on a slow link. Nothing is dropped without
//! a count: zenoh waits for a slow subscriber and closes the link to one that hangs, and meanwhile the queue of health
//! fills.

use std::{
    collections::HashMap,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
};

use tokio::{
    sync::{mpsc, oneshot},
    task::{self, JoinHandle},
};
use zenoh::{
    Session, Wait,
    bytes::Encoding,
    key_expr::KeyExpr,
    qos::{CongestionControl, Priority},
};

use super::error::BusError;

/// Capacity of the queue of health messages: a burst of throws.
const QUEUE: usize = 1_024;
/// Capacity of the queue of alarms: they are few, and each waits for its result.
const ALARMS: usize = 16;
/// Number of machines of a site from which their keys are declared. Of a declared key zenoh keeps 2.6 kB with its route,
/// as long as the session is open. It compares any other key with every key of the site at each put: 0.2 µs for each.
const LARGE_SITE: usize = 100;
/// Number of machines of a site from which their keys are declared although [`DECLARED`] keys are: a put of any other key
/// takes up to 60 µs longer.
const VERY_LARGE_SITE: usize = 300;
/// Number of declared keys from which on only those of very large sites are declared. With 20,000 machines in sites of a
/// hundred, each with two throws, the daemon took 293 MiB with all keys declared, and 177 MiB with this bound.
const DECLARED: usize = 1_000;

/// The keys of the machines, and how many of them are declared.
#[derive(Default)]
struct Keys {
    /// For each site; `None` while a key is not declared.
    sites: HashMap<String, HashMap<String, Option<KeyExpr<'static>>>>,
    declared: usize,
}

/// Counters since the start.
#[derive(Debug, Default)]
pub(crate) struct OutletCounters {
    pub published: AtomicU64,
    /// Health messages dropped because the queue was full. They are in the database.
    pub dropped: AtomicU64,
}

/// A message, with the receiver of the result if it is an alarm.
struct Job {
    key: String,
    payload: Vec<u8>,
    done: Option<oneshot::Sender<Result<(), BusError>>>,
}

/// Handle to the publishing threads, which end when the last handle is dropped.
#[derive(Clone)]
pub(crate) struct Outlet {
    alarms: mpsc::Sender<Job>,
    healths: mpsc::Sender<Job>,
    counters: Arc<OutletCounters>,
}

impl Outlet {
    /// Starts the threads, which end when they have published their queues. Close the session only after their ends: a put
    /// to a closing session panics in zenoh.
    pub(crate) fn start(session: &Session) -> (Self, [JoinHandle<()>; 2]) {
        let counters = Arc::<OutletCounters>::default();
        // With a priority of their own alarms do not wait in zenoh behind health.
        let (alarms, first) = publisher(session, Priority::InteractiveHigh, ALARMS, &counters);
        let (healths, second) = publisher(session, Priority::Data, QUEUE, &counters);
        (Self { alarms, healths, counters }, [first, second])
    }

    /// Counters of published and dropped messages, shared with the threads.
    pub(crate) fn counters(&self) -> Arc<OutletCounters> {
        Arc::clone(&self.counters)
    }

    /// Publishes an alarm event; returns when zenoh has accepted it.
    pub(crate) async fn alarm(&self, key: String, payload: Vec<u8>) -> Result<(), BusError> {
        let (done, answer) = oneshot::channel();
        let gone = || BusError::new("publish an alarm")("the publishing thread has ended".into());
        self.alarms.send(Job { key, payload, done: Some(done) }).await.map_err(|_| gone())?;
        answer.await.map_err(|_| gone())?
    }

    /// Queues the health of a throw; counts it as dropped if the queue is full.
    pub(crate) fn health(&self, key: String, payload: Vec<u8>) {
        if self.healths.try_send(Job { key, payload, done: None }).is_err() {
            self.counters.dropped.fetch_add(1, Relaxed);
        }
    }

    /// Whether a thread has ended.
    pub(crate) fn is_closed(&self) -> bool {
        self.alarms.is_closed() || self.healths.is_closed()
    }
}

/// Starts a publishing thread; returns its queue and its end.
fn publisher(
    session: &Session,
    priority: Priority,
    capacity: usize,
    counters: &Arc<OutletCounters>,
) -> (mpsc::Sender<Job>, JoinHandle<()>) {
    let (jobs, inbox) = mpsc::channel(capacity);
    let (session, counters) = (session.clone(), Arc::clone(counters));
    (jobs, task::spawn_blocking(move || run(&session, inbox, priority, &counters)))
}

fn run(session: &Session, mut jobs: mpsc::Receiver<Job>, priority: Priority, counters: &OutletCounters) {
    let mut keys = Keys::default();
    while let Some(Job { key, payload, done }) = jobs.blocking_recv() {
        let result = put(session, &mut keys, &key, payload, priority);
        if result.is_ok() {
            counters.published.fetch_add(1, Relaxed);
        }
        match (done, result) {
            // Fails if the caller stopped waiting; the event is published anyway.
            (Some(done), result) => drop(done.send(result)),
            (None, Ok(())) => {}
            (None, Err(error)) => {
                counters.dropped.fetch_add(1, Relaxed);
                tracing::debug!(%error, "publishing the health of a throw failed");
            }
        }
    }
}

/// Publishes on a key, which is declared if its site is large.
fn put(session: &Session, keys: &mut Keys, key: &str, payload: Vec<u8>, priority: Priority) -> Result<(), BusError> {
    let failed = |error| BusError::new(format!("publish on {key}"))(error);
    // The key without machine and kind.
    let site = key.rsplitn(3, '/').last().unwrap_or(key);
    let site = keys.sites.entry(site.to_owned()).or_default();
    let is_large = site.len() >= if keys.declared < DECLARED { LARGE_SITE } else { VERY_LARGE_SITE };
    let declared = site.entry(key.to_owned()).or_default();
    if is_large && declared.is_none() {
        *declared = Some(session.declare_keyexpr(key.to_owned()).wait().map_err(failed)?);
        keys.declared += 1;
    }
    let put = match declared {
        Some(declared) => session.put(&*declared, payload),
        None => session.put(key, payload),
    };
    put.encoding(Encoding::APPLICATION_JSON)
        .priority(priority)
        .congestion_control(CongestionControl::Block)
        .wait()
        .map_err(failed)
}
