//! A load: many machines that throw at a given rate, with prepared traces.
//!
//! The throws are simulated before the load begins, so that the simulation does not limit the rate. New sensor noise
//! makes each trace different.

use std::{
    collections::{HashMap, HashSet},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread,
    time::{Duration, Instant},
};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::Deserialize;
use zenoh::{
    Session, Wait,
    pubsub::{Publisher, Subscriber},
    sample::Sample,
};

use super::{error::LoggerError, publish::publisher};
use crate::{
    daemon::clock,
    simulate::{Fleet, FleetSettings, SimulatedThrow},
    throw::{MachineId, Throw, ThrowRef, Trace},
    wire::{self, Encoding, Kind},
};

/// Number of simulated machines; the others repeat them.
const MODELS: usize = 16;
/// Prepared throws of a simulated machine, half of them in each direction.
const THROWS: usize = 4;
/// Standard deviation of the added noise: a step of a 14-bit converter over 40 A \[A\] and over 160 mm \[mm\].
const CURRENT_A: f64 = 0.0025;
const POSITION_MM: f64 = 0.01;
/// Number of prepared noise values; each throw uses a stretch of them.
const NOISE_VALUES: usize = 1 << 17;

/// Settings of a load.
#[derive(Debug, Clone)]
pub struct Load {
    /// The machines in the order of their throws.
    pub machines: Vec<MachineId>,
    /// Throws per second of all machines together.
    pub rate: f64,
    /// Number of throws to publish.
    pub throws: u64,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Result of a load.
#[derive(Debug, Clone)]
pub struct Loaded {
    /// Time from the first to the last publication.
    pub publishing: Duration,
    /// Number of throws judged before the last publication.
    pub judged_meanwhile: u64,
    /// Times from the publication of a throw to the receipt of its health, sorted.
    pub latencies: Vec<Duration>,
    /// Time from the last publication to the last health.
    pub behind: Duration,
}

impl Loaded {
    /// The latency quantile for this share of the judged throws; `None` without judged throws.
    #[must_use]
    pub fn quantile(&self, share: f64) -> Option<Duration> {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a length")]
        let rank = (share * self.latencies.len() as f64).ceil() as usize;
        self.latencies.get(rank.max(1) - 1).copied()
    }
}

/// Throws without a received health message, and the latencies of the others.
#[derive(Default)]
struct Tracking {
    published: HashMap<(MachineId, u64), Instant>,
    latencies: Vec<Duration>,
}

impl Load {
    /// Publishes the throws, and waits until the health of all has arrived, or none has arrived for `patience`.
    ///
    /// # Errors
    /// When the simulation or zenoh fails.
    pub fn run(&self, session: &Session, boot_id: &str, patience: Duration) -> Result<Loaded, LoggerError> {
        let prepared = self.prepare()?;
        let tracking = Arc::new(Mutex::new(Tracking::default()));
        let _subscribers = self.subscribe(session, boot_id, &tracking)?;
        let publishers = self.publishers(session)?;
        let mut noise = Noise::new(self.seed);
        let start = clock::monotonic();
        for number in 0..self.throws {
            let (round, at) = (number / self.machines.len() as u64, index(number, self.machines.len()));
            let model = &prepared[at % prepared.len()];
            let throw_no = round + 1;
            let message = message(boot_id, throw_no, &model[index(round, model.len())], &mut noise)?;
            let due = start + Duration::from_secs_f64(number as f64 / self.rate);
            thread::sleep(due.saturating_duration_since(clock::monotonic()));
            lock(&tracking).published.insert((self.machines[at].clone(), throw_no), clock::monotonic());
            publishers[at].put(message).wait()?;
        }
        let end = clock::monotonic();
        let judged_meanwhile = lock(&tracking).latencies.len() as u64;
        let (mut judged, mut last) = (judged_meanwhile, end);
        while judged < self.throws && last.elapsed() < patience {
            thread::sleep(Duration::from_millis(20));
            let now = lock(&tracking).latencies.len() as u64;
            if now > judged {
                (judged, last) = (now, clock::monotonic());
            }
        }
        let mut latencies = std::mem::take(&mut lock(&tracking).latencies);
        latencies.sort_unstable();
        Ok(Loaded { publishing: end - start, judged_meanwhile, latencies, behind: last - end })
    }

    fn prepare(&self) -> Result<Vec<Vec<SimulatedThrow>>, LoggerError> {
        let settings = FleetSettings { machines: MODELS.min(self.machines.len()), ..FleetSettings::default() };
        let machines = Fleet::new(&settings, self.seed)?.into_machines().into_iter();
        let throws = machines.map(|mut machine| (0..THROWS).map(|_| machine.next_throw()).collect());
        Ok(throws.collect::<Result<_, _>>()?)
    }

    fn subscribe(
        &self,
        session: &Session,
        boot_id: &str,
        tracking: &Arc<Mutex<Tracking>>,
    ) -> Result<Vec<Subscriber<()>>, LoggerError> {
        /// The fields of a health message that identify the throw.
        #[derive(Deserialize)]
        struct Which {
            boot_id: String,
            throw_no: u64,
        }
        let sites: HashSet<_> = self.machines.iter().map(|id| &id.site).collect();
        let subscribers = sites.into_iter().map(|site| {
            let (boot_id, tracking) = (boot_id.to_owned(), Arc::clone(tracking));
            let on_health = move |sample: Sample| {
                let now = clock::monotonic();
                let which = serde_json::from_slice::<Which>(&sample.payload().to_bytes());
                if let (Ok(which), Ok((machine, _))) = (which, wire::parse_key(sample.key_expr()))
                    && which.boot_id == boot_id
                {
                    let mut tracking = lock(&tracking);
                    if let Some(published) = tracking.published.remove(&(machine, which.throw_no)) {
                        tracking.latencies.push(now - published);
                    }
                }
            };
            session.declare_subscriber(wire::site_key(site, Kind::Health)).callback(on_health).wait()
        });
        Ok(subscribers.collect::<Result<_, _>>()?)
    }

    /// A publisher for each machine, after a daemon has subscribed to all of them.
    fn publishers(&self, session: &Session) -> Result<Vec<Publisher<'static>>, LoggerError> {
        let mut publishers = Vec::with_capacity(self.machines.len());
        for machine in &self.machines {
            let publisher = publisher(session, machine)?;
            while !publisher.matching_status().wait()?.matching() {
                thread::sleep(Duration::from_millis(10));
            }
            publishers.push(publisher);
        }
        Ok(publishers)
    }
}

fn index(number: u64, count: usize) -> usize {
    usize::try_from(number % count as u64).unwrap_or(0)
}

fn lock(tracking: &Mutex<Tracking>) -> MutexGuard<'_, Tracking> {
    tracking.lock().unwrap_or_else(PoisonError::into_inner)
}

fn message(
    boot_id: &str,
    throw_no: u64,
    simulated: &SimulatedThrow,
    noise: &mut Noise,
) -> Result<Vec<u8>, LoggerError> {
    let throw = Throw {
        id: ThrowRef { boot_id: boot_id.to_owned(), throw_no },
        started_at: clock::now(),
        direction: Some(simulated.direction),
        trace: noise.on(&simulated.trace)?,
        temperature_c: Some(simulated.temperature_c),
        supply_v: Some(simulated.supply_v),
        anti_alias_hz: simulated.anti_alias_hz,
    };
    Ok(wire::encode_throw(Encoding::Cbor, &throw))
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

    /// A trace with noise from a random position.
    fn on(&mut self, trace: &Trace) -> Result<Trace, LoggerError> {
        let mut channel = |samples: &[f64], sd: f64| {
            let from = self.rng.random_range(0..self.values.len());
            let noise = self.values.iter().cycle().skip(from);
            samples.iter().zip(noise).map(|(sample, noise)| sample + sd * noise).collect()
        };
        let (current, position) = (channel(trace.current_a(), CURRENT_A), channel(trace.position_mm(), POSITION_MM));
        Ok(Trace::new(trace.sample_rate_hz(), current, position)?)
    }
}
