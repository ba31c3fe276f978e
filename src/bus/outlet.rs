//! Publishes alarms and health from a thread of its own: a put waits inside zenoh while a link is slow.

use std::{
    convert::Infallible,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    thread,
};

use tokio::sync::{mpsc, oneshot};
use zenoh::{Session, Wait, bytes::Encoding, qos::CongestionControl};

use super::error::BusError;

/// Messages that may wait for the thread: health of a burst of throws. Alarms wait for their answer and are few.
const QUEUE: usize = 1_024;
/// Counts that only grow.
#[derive(Debug, Default)]
pub struct OutletCounters {
    /// Messages that zenoh accepted.
    pub published: AtomicU64,
    /// Health messages that were dropped because the thread was busy. They stay in the database.
    pub dropped: AtomicU64,
    /// Messages that zenoh refused.
    pub refused: AtomicU64,
}

enum Job {
    Alarm { key: String, payload: Vec<u8>, done: oneshot::Sender<Result<(), BusError>> },
    Health { key: String, payload: Vec<u8> },
}

/// A handle to the publishing thread. It ends when the last of these is dropped.
#[derive(Clone)]
pub struct Outlet {
    jobs: mpsc::Sender<Job>,
    counters: Arc<OutletCounters>,
}

/// The end of the publishing thread.
#[derive(Debug)]
pub struct OutletEnd(oneshot::Receiver<Infallible>);

impl OutletEnd {
    /// Waits until the thread has published what was handed to it and is gone.
    pub async fn reached(self) {
        // An error is all that can come: the thread drops its end and never sends.
        let _ = self.0.await;
    }
}

impl Outlet {
    /// Starts the thread. The session may be closed after its end: zenoh panics in a put to a session that closes.
    ///
    /// # Errors
    /// When the system gives no thread.
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

    /// The counts.
    #[must_use]
    pub fn counters(&self) -> Arc<OutletCounters> {
        Arc::clone(&self.counters)
    }

    /// Publishes an alarm event; returns once zenoh took it.
    ///
    /// # Errors
    /// When zenoh refuses it, or the thread is gone.
    pub async fn alarm(&self, key: String, payload: Vec<u8>) -> Result<(), BusError> {
        let (done, answer) = oneshot::channel();
        let gone = || BusError::new("publish an alarm")("the publishing thread has ended".into());
        self.jobs.send(Job::Alarm { key, payload, done }).await.map_err(|_| gone())?;
        answer.await.map_err(|_| gone())?
    }

    /// Publishes the health of a throw if the thread has room; otherwise counts it as dropped.
    pub fn health(&self, key: String, payload: Vec<u8>) {
        if self.jobs.try_send(Job::Health { key, payload }).is_err() {
            self.counters.dropped.fetch_add(1, Relaxed);
        }
    }

    /// Whether the thread is gone.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.jobs.is_closed()
    }
}

fn run(session: &Session, mut jobs: mpsc::Receiver<Job>, counters: &OutletCounters) {
    while let Some(job) = jobs.blocking_recv() {
        let is_published = match job {
            Job::Alarm { key, payload, done } => {
                // Alarms wait for a slow link.
                let result = put(session, key, payload, CongestionControl::Block);
                let is_published = result.is_ok();
                // The asker may have given up; the event is published all the same.
                let _ = done.send(result);
                is_published
            }
            Job::Health { key, payload } => put(session, key, payload, CongestionControl::Drop).is_ok(),
        };
        let counter = if is_published { &counters.published } else { &counters.refused };
        counter.fetch_add(1, Relaxed);
    }
}

fn put(session: &Session, key: String, payload: Vec<u8>, congestion: CongestionControl) -> Result<(), BusError> {
    let failed = BusError::new(format!("publish on {key}"));
    session.put(key, payload).encoding(Encoding::APPLICATION_JSON).congestion_control(congestion).wait().map_err(failed)
}
