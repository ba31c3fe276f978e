//! A load test of a daemon: publishes throws of many machines at a given rate, with prepared traces.
//!
//! The throws are simulated before the test begins, so that the simulation does not limit the rate. New sensor noise
//! makes each trace different.

use std::{
    collections::HashMap,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use jiff::Timestamp;
use parking_lot::Mutex;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::de::DeserializeOwned;
use zenoh::{
    Session, Wait, bytes::Encoding as ContentType, key_expr::KeyExpr, pubsub::Subscriber, qos::CongestionControl,
    sample::Sample,
};

use super::{
    error::LoggerError,
    publish::{publisher, until_subscribed},
};
use crate::{
    bus::BusError,
    daemon::clock,
    simulate::FleetSettings,
    throw::{MachineId, Throw, ThrowRef, Trace},
    wire::{self, Alarm, Health, Kind, Scope},
};

/// Number of simulated machines; all other machines repeat their throws.
const MODELS: usize = 16;
/// Number of prepared throws of a simulated machine, half of them in each direction.
const PREPARED_THROWS: usize = 4;
/// Standard deviation of the noise added to the current \[A\]: a step of a 14-bit converter over 40 A.
const CURRENT_NOISE_A: f64 = 0.0025;
/// Standard deviation of the noise added to the position \[mm\]: a step of a 14-bit converter over 160 mm.
const POSITION_NOISE_MM: f64 = 0.01;
/// Number of prepared noise values. Each channel of a throw uses successive values from a random position.
const NOISE_VALUES: usize = 1 << 17;

/// Settings of a load test.
#[derive(Debug, Clone)]
pub struct LoadTest {
    /// The machines, in the order in which they throw.
    pub machines: Vec<MachineId>,
    /// Throws per second of all machines together.
    pub rate: f64,
    /// Number of throws to publish.
    pub throws: u64,
    /// The toe of every n-th machine does not move in its first throw, which raises an alarm; 0 for none.
    pub blocked: u64,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Result of a load test.
#[derive(Debug, Clone)]
pub struct LoadResult {
    /// Time from the first to the last publication.
    pub publishing: Duration,
    /// Number of throws judged before the last publication.
    pub judged_meanwhile: u64,
    /// Times from the publication of a throw to the receipt of its health, sorted.
    pub latencies: Vec<Duration>,
    /// Times from the publication of a throw that raises an alarm to the receipt of the alarm, sorted.
    pub alarm_latencies: Vec<Duration>,
    /// Time from the last publication to the last health.
    pub behind: Duration,
}

/// The published throws whose message has not been received yet, and the latencies of the others.
#[derive(Default)]
struct Tracking {
    /// Time of the publication, by machine and throw number.
    published: HashMap<(MachineId, u64), Instant>,
    latencies: Vec<Duration>,
}

impl Tracking {
    fn on_message(&mut self, throw: &(MachineId, u64), now: Instant) {
        if let Some(published) = self.published.remove(throw) {
            self.latencies.push(now - published);
        }
    }

    fn sorted(&mut self) -> Vec<Duration> {
        self.latencies.sort_unstable();
        std::mem::take(&mut self.latencies)
    }
}

type Shared = Arc<Mutex<Tracking>>;

impl LoadTest {
    /// Publishes the throws, and waits until the health of every throw has arrived, or no health has arrived for
    /// `patience`.
    ///
    /// # Errors
    /// When the simulation or zenoh fails.
    pub fn run(&self, session: &Session, boot_id: &str, patience: Duration) -> Result<LoadResult, LoggerError> {
        let prepared = self.prepare()?;
        let (healths, alarms) = (Shared::default(), Shared::default());
        let own_boot = boot_id.to_owned();
        let of_health = move |Health { machine, throw, .. }: Health| {
            (throw.boot_id == own_boot).then_some((machine, throw.throw_no))
        };
        let of_alarm = |Alarm { machine, event, .. }: Alarm| Some((machine, event.last_throw?.throw_no));
        let _subscribers = [
            subscribe(session, Kind::Health, &healths, of_health)?,
            subscribe(session, Kind::Alarm, &alarms, of_alarm)?,
        ];
        let keys = self.keys(session, patience)?;
        let mut noise = Noise::new(self.seed);
        let start = clock::monotonic();
        for number in 0..self.throws {
            let (round, at) = (number / self.machines.len() as u64, index(number, self.machines.len()));
            let model = &prepared[at % prepared.len()];
            let throw = (self.machines[at].clone(), round + 1);
            let is_blocked = round == 0 && self.blocked > 0 && number.is_multiple_of(self.blocked);
            let simulated = &model[index(round, model.len())];
            let message = message(boot_id, throw.1, simulated, is_blocked, &mut noise)?;
            let due = start + Duration::from_secs_f64(number as f64 / self.rate);
            thread::sleep(due.saturating_duration_since(clock::monotonic()));
            if is_blocked {
                alarms.lock().published.insert(throw.clone(), clock::monotonic());
            }
            healths.lock().published.insert(throw, clock::monotonic());
            session
                .put(&keys[at], message)
                .encoding(ContentType::APPLICATION_CBOR)
                .congestion_control(CongestionControl::Block)
                .wait()
                .map_err(BusError::new("publish a throw"))?;
        }
        let end = clock::monotonic();
        let judged_meanwhile = healths.lock().latencies.len() as u64;
        let last = wait_for_all(&healths, end, patience);
        wait_for_all(&alarms, clock::monotonic(), patience);
        let [latencies, alarm_latencies] = [healths, alarms].map(|tracking| tracking.lock().sorted());
        Ok(LoadResult { publishing: end - start, judged_meanwhile, latencies, alarm_latencies, behind: last - end })
    }

    fn prepare(&self) -> Result<Vec<Vec<Throw>>, LoggerError> {
        let settings = FleetSettings { machines: MODELS.min(self.machines.len()), ..FleetSettings::default() };
        let throws = settings.build(self.seed)?.into_iter().map(|mut machine| {
            // Boot and time are those of the publication.
            (0..PREPARED_THROWS).map(|_| machine.next_throw("", Timestamp::UNIX_EPOCH)).collect()
        });
        Ok(throws.collect::<Result<_, _>>()?)
    }

    /// Waits until a daemon has subscribed to the throws of the first machine, and returns the throw keys of all
    /// machines. The keys are not declared: with a publisher for each machine, zenoh compares every new publisher with
    /// all others, which took minutes for 20,000 machines.
    fn keys(&self, session: &Session, patience: Duration) -> Result<Vec<KeyExpr<'static>>, LoggerError> {
        if let Some(first) = self.machines.first() {
            let start = clock::monotonic();
            if !until_subscribed(&publisher(session, first)?, || start.elapsed() >= patience)? {
                return Err(LoggerError::NoSubscriber(first.clone()));
            }
        }
        let keys = self.machines.iter().map(|machine| KeyExpr::try_from(wire::machine_key(machine, Kind::Throw)));
        let keys: Result<_, _> = keys.collect();
        Ok(keys.map_err(BusError::new("use the key of a machine"))?)
    }
}

/// Subscribes to the messages of one kind of all machines. `throw`: the throw of a message; `None` if it does not count.
fn subscribe<M: DeserializeOwned>(
    session: &Session,
    kind: Kind,
    tracking: &Shared,
    throw: impl Fn(M) -> Option<(MachineId, u64)> + Send + Sync + 'static,
) -> Result<Subscriber<()>, BusError> {
    let tracking = Arc::clone(tracking);
    let on_message = move |sample: Sample| {
        let now = clock::monotonic();
        if let Some(throw) = serde_json::from_slice(&sample.payload().to_bytes()).ok().and_then(&throw) {
            tracking.lock().on_message(&throw, now);
        }
    };
    let subscribed = session.declare_subscriber(Scope::default().key_expression(kind)).callback(on_message).wait();
    subscribed.map_err(BusError::new("subscribe to the answers of the daemons"))
}

/// Waits until every published throw has its message, or no message has arrived for `patience`. Returns the time of
/// the last message, or `start` without one.
fn wait_for_all(tracking: &Shared, start: Instant, patience: Duration) -> Instant {
    let (mut awaited, mut last) = (tracking.lock().published.len(), start);
    while awaited > 0 && last.elapsed() < patience {
        thread::sleep(Duration::from_millis(20));
        let now = tracking.lock().published.len();
        if now < awaited {
            (awaited, last) = (now, clock::monotonic());
        }
    }
    last
}

fn index(number: u64, count: usize) -> usize {
    usize::try_from(number % count as u64).unwrap_or(0)
}

fn message(
    boot_id: &str,
    throw_no: u64,
    prepared: &Throw,
    is_blocked: bool,
    noise: &mut Noise,
) -> Result<Vec<u8>, LoggerError> {
    let (id, trace) = (ThrowRef { boot_id: boot_id.to_owned(), throw_no }, noise.add_to(&prepared.trace, is_blocked)?);
    Ok(wire::encode_throw(&Throw { id, started_at: clock::now(), trace, ..prepared.clone() }))
}

/// Prepared sensor noise.
struct Noise {
    values: Vec<f64>,
    rng: ChaCha8Rng,
}

impl Noise {
    fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        Self { values: (0..NOISE_VALUES).map(|_| rng.sample(StandardNormal)).collect(), rng }
    }

    /// The trace with noise added, and without a movement of the toe if the machine is blocked.
    fn add_to(&mut self, trace: &Trace, is_blocked: bool) -> Result<Trace, LoggerError> {
        let mut channel = |samples: &[f64], sd: f64, moves: bool| {
            let from = self.rng.random_range(0..self.values.len());
            let noise = self.values.iter().cycle().skip(from);
            let value = |sample: f64| if moves { sample } else { samples[0] };
            samples.iter().zip(noise).map(|(sample, noise)| value(*sample) + sd * noise).collect()
        };
        let current = channel(trace.current_a(), CURRENT_NOISE_A, true);
        let position = channel(trace.position_mm(), POSITION_NOISE_MM, !is_blocked);
        Ok(Trace::new(trace.sample_rate_hz(), current, position)?)
    }
}
