//! What the daemon publishes, from a thread of its own: a put waits inside zenoh while a link is slow.

use std::{
    collections::HashMap,
    convert::Infallible,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    thread,
    time::Duration,
};

use tokio::sync::{mpsc, oneshot};
use zenoh::{Session, Wait, bytes::Encoding, qos::CongestionControl};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

use super::BusError;

/// Messages that may wait for the thread: health of a burst of throws. Alarms wait for their answer and are few.
const QUEUE: usize = 1_024;
/// Events of one machine's alarms that its publisher keeps for those who come late or missed some.
const CACHE: usize = 64;
/// How often a publisher tells what it sent last, so that a lost last event is noticed.
const HEARTBEAT: Duration = Duration::from_secs(1);
/// Machines with an alarm publisher of their own; alarms of further ones are published without a cache.
const MAX_PUBLISHERS: usize = 4_096;

/// Counts that only grow.
#[derive(Debug, Default)]
pub struct OutletCounters {
    /// Messages that zenoh took.
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

/// The way to the publishing thread. It ends when the last of these is dropped.
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
    let mut publishers = HashMap::new();
    while let Some(job) = jobs.blocking_recv() {
        let result = match job {
            Job::Alarm { key, payload, done } => {
                let result = put_alarm(session, &mut publishers, &key, payload);
                let taken = result.is_ok();
                // Whoever asked may have given up; the event is published all the same.
                let _ = done.send(result);
                taken
            }
            Job::Health { key, payload } => session
                .put(key, payload)
                .encoding(Encoding::APPLICATION_JSON)
                .congestion_control(CongestionControl::Drop)
                .wait()
                .is_ok(),
        };
        let counter = if result { &counters.published } else { &counters.refused };
        counter.fetch_add(1, Relaxed);
    }
}

fn put_alarm(
    session: &Session,
    publishers: &mut HashMap<String, AdvancedPublisher<'static>>,
    key: &str,
    payload: Vec<u8>,
) -> Result<(), BusError> {
    if !publishers.contains_key(key) && publishers.len() < MAX_PUBLISHERS {
        let publisher = declare(session, key).map_err(BusError::new(format!("declare a publisher on {key}")))?;
        publishers.insert(key.to_owned(), publisher);
    }
    let put = match publishers.get(key) {
        Some(publisher) => publisher.put(payload).wait(),
        None => session.put(key.to_owned(), payload).encoding(Encoding::APPLICATION_JSON).wait(),
    };
    put.map_err(BusError::new(format!("publish on {key}")))
}

fn declare(session: &Session, key: &str) -> zenoh::Result<AdvancedPublisher<'static>> {
    session
        .declare_publisher(key.to_owned())
        .encoding(Encoding::APPLICATION_JSON)
        .congestion_control(CongestionControl::Block)
        .cache(CacheConfig::default().max_samples(CACHE))
        .sample_miss_detection(MissDetectionConfig::default().sporadic_heartbeat(HEARTBEAT))
        .publisher_detection()
        .wait()
}
