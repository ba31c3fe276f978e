//! A logger that publishes independently of the daemon. Its machines have temporary faults, and sensors that sometimes
//! fail, so that alarms are raised and cleared all the time.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex, OnceLock,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use jiff::{SignedDuration, Timestamp};
use pointsd::{
    simulate::{Fault, Part, Shape},
    throw::{MachineId, Throw, ThrowRef, Trace},
    wire::{self, BacklogQuery, Kind},
};
use zenoh::{
    Session, Wait,
    bytes::Encoding as ContentType,
    liveliness::LivelinessToken,
    pubsub::Publisher,
    qos::CongestionControl,
    query::{Query, Queryable},
};

use crate::rig;

/// Configuration for alarms after a few throws.
pub(crate) const QUICK_ALARMS: &str =
    "[diagnosis]\nbaseline_throws = 12\nnot_monitored_throws = 1\noff_delay_throws = 2\n";

/// Throws of a phase of a machine; healthy and worn phases alternate.
const PHASE: u64 = 24;
/// Every seventh throw cannot be evaluated.
const UNREADABLE: u64 = 7;

/// Settings of a logger.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// Number of throws of each machine.
    pub(crate) throws: u64,
    /// Prefix of the names of its machines at the site `north`, followed by their number from 1.
    pub(crate) machine: &'static str,
    pub(crate) machines: usize,
    /// Throws of each machine in the backlog; 0: no backlog.
    pub(crate) kept: usize,
    /// Time between consecutive throws of all machines.
    pub(crate) pace: Duration,
    /// Identifies this start of the logger.
    pub(crate) boot_id: String,
}

impl Default for Plan {
    /// Two machines with a long backlog that never stop.
    fn default() -> Self {
        let pace = Duration::from_millis(10);
        Self { throws: u64::MAX, machine: "m", machines: 2, kept: 10_000, pace, boot_id: "b1".to_owned() }
    }
}

/// A logger that publishes until it is stopped.
pub(crate) struct Logger {
    session: Session,
    stop: Arc<AtomicBool>,
    rounds: Arc<Mutex<u64>>,
    thread: JoinHandle<Vec<Source>>,
}

/// A logger that has stopped publishing. Its backlogs reply until it is dropped.
pub(crate) struct Silent {
    /// Last published number of each machine; the first is 1.
    pub(crate) published: u64,
    _sources: Vec<Source>,
    _session: Session,
}

/// The backlog of a machine, oldest throw first.
type Kept = Arc<Mutex<VecDeque<(ThrowRef, Vec<u8>)>>>;

/// A machine of a logger.
struct Source {
    publisher: Publisher<'static>,
    kept: Kept,
    _backlog: Option<Queryable<()>>,
    _token: LivelinessToken,
}

/// A throw of a machine with alternating phases.
pub(crate) fn throw(boot_id: &str, throw_no: u64) -> Throw {
    let id = ThrowRef { boot_id: boot_id.to_owned(), throw_no };
    if throw_no.is_multiple_of(UNREADABLE) {
        return rig::stub(boot_id, throw_no);
    }
    let (healthy, worn) = simulated();
    let phase = if (throw_no / PHASE).is_multiple_of(2) { healthy } else { worn };
    let like = &phase[usize::try_from(throw_no % PHASE).unwrap()];
    let first: Timestamp = "2026-05-04T10:00:00Z".parse().unwrap();
    // Different samples for each throw.
    let mut current = like.trace.current_a().to_vec();
    current[0] += 1e-6 * throw_no as f64;
    let trace = Trace::new(like.trace.sample_rate_hz(), current, like.trace.position_mm().to_vec()).unwrap();
    Throw { id, started_at: first + SignedDuration::from_mins(10 * throw_no.cast_signed()), trace, ..like.clone() }
}

/// Throws of a healthy phase, and of a phase with 50 % more friction.
fn simulated() -> &'static (Vec<Throw>, Vec<Throw>) {
    static THROWS: OnceLock<(Vec<Throw>, Vec<Throw>)> = OnceLock::new();
    THROWS.get_or_init(|| {
        let friction = Fault { part: Part::Friction, shape: Shape::Step, size_pct: 50.0, from_throw: 0 };
        (rig::throws("any", PHASE), rig::faulty_throws(friction, "any", PHASE))
    })
}

impl Logger {
    /// Declares the publishers, waits for a daemon, and publishes.
    pub(crate) async fn start(endpoint: &str, plan: Plan) -> Self {
        let session = rig::client_of(endpoint).await;
        let sources: Vec<_> = (1..=plan.machines).map(|number| declare(&session, &plan, number)).collect();
        simulated();
        let (stop, rounds) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new(0)));
        let (stopped, counted) = (Arc::clone(&stop), Arc::clone(&rounds));
        let thread = thread::spawn(move || {
            for Source { publisher, .. } in &sources {
                while !publisher.matching_status().wait().unwrap().matching() && !stopped.load(Relaxed) {
                    thread::sleep(Duration::from_millis(5));
                }
            }
            for throw_no in 1..=plan.throws {
                if stopped.load(Relaxed) {
                    break;
                }
                let message = wire::encode_throw(&throw(&plan.boot_id, throw_no));
                for Source { publisher, kept, .. } in &sources {
                    keep(kept, &plan, throw_no, message.clone());
                    publisher.put(message.clone()).wait().unwrap();
                    thread::sleep(plan.pace);
                }
                *counted.lock().unwrap() = throw_no;
            }
            sources
        });
        Self { session, stop, rounds, thread }
    }

    /// Stops after the current round of throws.
    pub(crate) fn stop(self) -> Silent {
        self.stop.store(true, Relaxed);
        self.finish()
    }

    /// Waits until all throws are published.
    pub(crate) fn finish(self) -> Silent {
        let sources = self.thread.join().unwrap();
        let published = *self.rounds.lock().unwrap();
        Silent { published, _sources: sources, _session: self.session }
    }
}

fn keep(kept: &Kept, plan: &Plan, throw_no: u64, message: Vec<u8>) {
    let mut kept = kept.lock().unwrap();
    kept.push_back((ThrowRef { boot_id: plan.boot_id.clone(), throw_no }, message));
    while kept.len() > plan.kept {
        kept.pop_front();
    }
}

fn declare(session: &Session, plan: &Plan, number: usize) -> Source {
    let machine = MachineId::new("north", &format!("{}{number}", plan.machine)).unwrap();
    let (key, kept) = (wire::machine_key(&machine, Kind::Throw), Kept::default());
    let answering = Arc::clone(&kept);
    // A reply may wait for a slow link, so it has its own thread.
    let on_query = move |query| {
        let kept = Arc::clone(&answering);
        thread::spawn(move || answer(&query, &kept));
    };
    let backlog = (plan.kept > 0).then(|| session.declare_queryable(key.clone()).callback(on_query).wait().unwrap());
    let alive = wire::machine_key(&machine, Kind::Alive);
    let publisher = session
        .declare_publisher(key)
        .encoding(ContentType::APPLICATION_CBOR)
        .congestion_control(CongestionControl::Block);
    Source {
        publisher: publisher.wait().unwrap(),
        kept,
        _backlog: backlog,
        _token: session.liveliness().declare_token(alive).wait().unwrap(),
    }
}

fn answer(query: &Query, kept: &Kept) {
    let asked = BacklogQuery::parse(query.parameters().as_str());
    let page: Vec<Vec<u8>> = {
        let kept = kept.lock().unwrap();
        let start = asked.start(kept.iter().map(|(throw, _)| throw));
        kept.iter().skip(start).take(asked.limit).map(|(_, message)| message.clone()).collect()
    };
    for message in page {
        let reply = query.reply(query.key_expr().clone(), message).encoding(ContentType::APPLICATION_CBOR);
        if reply.wait().is_err() {
            return;
        }
    }
}
