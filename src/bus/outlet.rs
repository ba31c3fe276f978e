//! Publishes alarms and health from its own thread, as a put blocks on a slow link.

use std::{
    collections::{HashMap, hash_map::Entry},
    convert::Infallible,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    thread,
};

use tokio::sync::{mpsc, oneshot};
use zenoh::{Session, Wait, bytes::Encoding, key_expr::KeyExpr, qos::CongestionControl};

use super::error::BusError;

/// Capacity of the queue: the health of a burst of throws. Alarms are few, and each waits for its result.
const QUEUE: usize = 1_024;
/// Counters since the start.
#[derive(Debug, Default)]
pub struct OutletCounters {
    /// Messages that zenoh accepted.
    pub published: AtomicU64,
    /// Health messages dropped because the queue was full. They are in the database.
    pub dropped: AtomicU64,
    /// Messages that zenoh refused.
    pub refused: AtomicU64,
}

enum Job {
    Alarm { key: String, payload: Vec<u8>, done: oneshot::Sender<Result<(), BusError>> },
    Health { key: String, payload: Vec<u8> },
}

/// Handle to the publishing thread, which ends when the last handle is dropped.
#[derive(Clone)]
pub struct Outlet {
    jobs: mpsc::Sender<Job>,
    counters: Arc<OutletCounters>,
}

/// The end of the publishing thread.
#[derive(Debug)]
pub struct OutletEnd(oneshot::Receiver<Infallible>);

impl OutletEnd {
    /// Waits until the thread has published its queue and ended.
    pub async fn reached(self) {
        // Always an error: the thread sends nothing, it only drops the sender.
        let _ = self.0.await;
    }
}

impl Outlet {
    /// Starts the thread. Close the session only after [`OutletEnd::reached`]: a put to a closing session panics in
    /// zenoh.
    ///
    /// # Errors
    /// When the thread cannot be started.
    pub fn start(session: Session) -> std::io::Result<(Self, OutletEnd)> {
        let (jobs, inbox) = mpsc::channel(QUEUE);
        let (running, end) = oneshot::channel();
        let counters = Arc::new(OutletCounters::default());
        let counting = Arc::clone(&counters);
        thread::Builder::new().name("publish".into()).spawn(move || {
            run(&session, inbox, &counting);
            drop(running);
        })?;
        Ok((Self { jobs, counters }, OutletEnd(end)))
    }

    /// The counters, shared with the thread.
    #[must_use]
    pub fn counters(&self) -> Arc<OutletCounters> {
        Arc::clone(&self.counters)
    }

    /// Publishes an alarm event; returns when zenoh has accepted it.
    ///
    /// # Errors
    /// When zenoh refuses the event, or the thread has ended.
    pub async fn alarm(&self, key: String, payload: Vec<u8>) -> Result<(), BusError> {
        let (done, answer) = oneshot::channel();
        let gone = || BusError::new("publish an alarm")("the publishing thread has ended".into());
        self.jobs.send(Job::Alarm { key, payload, done }).await.map_err(|_| gone())?;
        answer.await.map_err(|_| gone())?
    }

    /// Queues the health of a throw; counts it as dropped if the queue is full.
    pub fn health(&self, key: String, payload: Vec<u8>) {
        if self.jobs.try_send(Job::Health { key, payload }).is_err() {
            self.counters.dropped.fetch_add(1, Relaxed);
        }
    }

    /// Whether the thread has ended.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.jobs.is_closed()
    }
}

fn run(session: &Session, mut jobs: mpsc::Receiver<Job>, counters: &OutletCounters) {
    // For a declared key zenoh keeps the route. For any other it compares the key with every key of the network at each
    // put, which took 0.2 ms with 1,000 machines. At most two keys for each machine.
    let mut declared = HashMap::new();
    while let Some(job) = jobs.blocking_recv() {
        let is_published = match job {
            Job::Alarm { key, payload, done } => {
                // An alarm blocks on a slow link, and is not dropped.
                let result = put(session, &mut declared, key, payload, CongestionControl::Block);
                let is_published = result.is_ok();
                // Fails if the caller stopped waiting; the event is published anyway.
                let _ = done.send(result);
                is_published
            }
            Job::Health { key, payload } => put(session, &mut declared, key, payload, CongestionControl::Drop).is_ok(),
        };
        let counter = if is_published { &counters.published } else { &counters.refused };
        counter.fetch_add(1, Relaxed);
    }
}

/// Publishes on a key, which is declared at its first use.
fn put(
    session: &Session,
    declared: &mut HashMap<String, KeyExpr<'static>>,
    key: String,
    payload: Vec<u8>,
    congestion: CongestionControl,
) -> Result<(), BusError> {
    let failed = BusError::new(format!("publish on {key}"));
    let key = match declared.entry(key) {
        Entry::Occupied(known) => known.into_mut(),
        Entry::Vacant(new) => match session.declare_keyexpr(new.key().clone()).wait() {
            Ok(key) => new.insert(key),
            Err(error) => return Err(failed(error)),
        },
    };
    session
        .put(&*key, payload)
        .encoding(Encoding::APPLICATION_JSON)
        .congestion_control(congestion)
        .wait()
        .map_err(failed)
}
