//! Publishes alarms and health on two threads of their own, as a put blocks on a slow link. Zenoh waits for a slow
//! subscriber, and closes the link to a subscriber that hangs. Meanwhile the queue of health messages may fill; then
//! further health messages are dropped and counted.

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

/// Capacity of the queue of health messages: enough for a burst of throws.
const QUEUE: usize = 1_024;
/// Capacity of the queue of alarms: they are few, and each waits for its result.
const ALARMS: usize = 16;
/// From this number of machines on, the keys of a site are declared. Zenoh keeps 2.6 kB for a declared key and its
/// route, as long as the session is open. At each put with an undeclared key, zenoh compares it with every key of the
/// site, which takes 0.2 µs for each of them.
const LARGE_SITE: usize = 300;

/// The keys of the machines of each site; `None` if a key is not declared.
type Keys = HashMap<String, HashMap<String, Option<KeyExpr<'static>>>>;

/// Counters since the start.
#[derive(Debug, Default)]
pub(crate) struct OutletCounters {
    pub published: AtomicU64,
    /// Health messages dropped because the queue was full. They are in the database.
    pub dropped: AtomicU64,
}

/// A message to publish. The sender of an alarm waits for its result.
struct Publication {
    key: String,
    payload: Vec<u8>,
    done: Option<oneshot::Sender<Result<(), BusError>>>,
}

/// Handle to the publishing threads, which end when the last handle is dropped.
#[derive(Clone)]
pub(crate) struct Outlet {
    alarms: mpsc::Sender<Publication>,
    healths: mpsc::Sender<Publication>,
    counters: Arc<OutletCounters>,
}

impl Outlet {
    /// Starts the threads. When the last handle is dropped, they publish the rest of their queues and end. Close the
    /// session only after their ends: a put to a closing session panics in zenoh.
    pub(crate) fn start(session: &Session, counters: Arc<OutletCounters>) -> (Self, [JoinHandle<()>; 2]) {
        // With a higher priority, alarms do not wait behind health messages in zenoh.
        let (alarms, first) = publisher(session, Priority::InteractiveHigh, ALARMS, &counters);
        let (healths, second) = publisher(session, Priority::Data, QUEUE, &counters);
        (Self { alarms, healths, counters }, [first, second])
    }

    /// Publishes an alarm event; returns when zenoh has accepted it.
    pub(crate) async fn alarm(&self, key: String, payload: Vec<u8>) -> Result<(), BusError> {
        let (done, answer) = oneshot::channel();
        let gone = || BusError::new("publish an alarm")("the publishing thread has ended".into());
        self.alarms.send(Publication { key, payload, done: Some(done) }).await.map_err(|_| gone())?;
        answer.await.map_err(|_| gone())?
    }

    /// Queues the health of a throw; counts it as dropped if the queue is full.
    pub(crate) fn health(&self, key: String, payload: Vec<u8>) {
        if self.healths.try_send(Publication { key, payload, done: None }).is_err() {
            self.counters.dropped.fetch_add(1, Relaxed);
        }
    }

    /// Whether a thread has ended.
    pub(crate) fn is_closed(&self) -> bool {
        self.alarms.is_closed() || self.healths.is_closed()
    }
}

/// Starts a publishing thread; returns its queue and the handle to wait for its end.
fn publisher(
    session: &Session,
    priority: Priority,
    capacity: usize,
    counters: &Arc<OutletCounters>,
) -> (mpsc::Sender<Publication>, JoinHandle<()>) {
    let (sender, publications) = mpsc::channel(capacity);
    let (session, counters) = (session.clone(), Arc::clone(counters));
    (sender, task::spawn_blocking(move || run(&session, publications, priority, &counters)))
}

fn run(
    session: &Session,
    mut publications: mpsc::Receiver<Publication>,
    priority: Priority,
    counters: &OutletCounters,
) {
    let mut keys = Keys::default();
    while let Some(Publication { key, payload, done }) = publications.blocking_recv() {
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
    // The start of the key, up to the site.
    let site = key.rsplitn(3, '/').last().unwrap_or(key);
    let site = keys.entry(site.to_owned()).or_default();
    let is_large = site.len() >= LARGE_SITE;
    let declared = site.entry(key.to_owned()).or_default();
    if is_large && declared.is_none() {
        *declared = Some(session.declare_keyexpr(key.to_owned()).wait().map_err(failed)?);
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
