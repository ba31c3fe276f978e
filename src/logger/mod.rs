//! The simulated logger: simulates the throws of a fleet and publishes them as a real logger does.
//!
//! Simulation and publishing run on a thread of their own: the simulation needs the processor, and a put blocks on a
//! slow link.

mod backlog;
mod error;
mod load;
mod publish;
mod settings;

use std::{
    hash::{BuildHasher as _, RandomState},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    thread,
    time::Duration,
};

use tokio::{runtime::Handle, sync::oneshot, time};
use tokio_util::sync::CancellationToken;
use zenoh::Session;

pub use error::LoggerError;
pub use load::{LoadResult, LoadTest};
pub use settings::LoggerSettings;

use crate::{
    bus,
    simulate::FleetSettings,
    throw::MachineId,
    wire::{self, Health, Kind},
};
use backlog::AnswerThread;
use publish::{Publishing, Source};

/// Name of the publishing thread.
const THREAD: &str = "logger";
/// Longest wait until the daemons have judged the last throws.
const JUDGED_TIMEOUT: Duration = Duration::from_mins(1);
/// Time between two queries for the last judged throw.
const JUDGED_POLL_INTERVAL: Duration = Duration::from_millis(200);
/// Seed of the simulated machines if no seed is configured.
const SEED: u64 = 1;

/// A running logger. When it is dropped, it stops after the present throw.
pub struct Logger {
    session: Session,
    machines: Vec<MachineId>,
    boot_id: String,
    published: Arc<AtomicU64>,
    stop: CancellationToken,
    done: oneshot::Receiver<Result<u64, LoggerError>>,
}

impl Logger {
    /// Starts to publish the throws of a fleet as one boot. Each machine gets a backlog, a liveliness token and a
    /// publisher.
    ///
    /// # Errors
    /// When a setting of the fleet is out of range, zenoh refuses a declaration, or no thread can be started.
    pub async fn start(
        session: Session,
        settings: &LoggerSettings,
        fleet: &FleetSettings,
        boot_id: String,
    ) -> Result<Self, LoggerError> {
        // A daemon rejects a trace that the machine has sent before, so each boot needs other throws.
        let mut simulated = fleet.build(settings.seed.unwrap_or(SEED))?;
        if settings.seed.is_none() {
            let seed = RandomState::new().hash_one(&boot_id);
            for machine in &mut simulated {
                machine.reseed(seed);
            }
        }
        let machines: Vec<_> = (0..simulated.len()).map(|number| settings.machine_id(number)).collect();
        let published = Arc::new(AtomicU64::new(0));
        let stop = CancellationToken::new();
        let publishing = Publishing {
            settings: settings.clone(),
            boot_id: boot_id.clone(),
            published: Arc::clone(&published),
            stop: stop.clone(),
        };
        let (answering, max_bytes) = (AnswerThread::start()?, settings.backlog_mib << 20);
        let (mut sources, mut tokens) = (Vec::with_capacity(machines.len()), Vec::with_capacity(machines.len()));
        for (id, machine) in machines.iter().zip(simulated) {
            let key = wire::machine_key(id, Kind::Throw);
            let backlog = answering.declare(&session, &key, settings.backlog_throws, max_bytes)?;
            sources.push(Source { publisher: publish::publisher(&session, id)?, backlog, machine });
            // The token follows the backlog: a daemon that sees the token asks for the backlog at once.
            tokens.push(bus::declare_alive(&session, &wire::machine_key(id, Kind::Alive)).await?);
        }
        let (sender, done) = oneshot::channel();
        let runtime = Handle::current();
        let spawned = thread::Builder::new().name(THREAD.into()).spawn(move || {
            // Sending fails if the logger was dropped; then nobody needs the result.
            let _ = sender.send(publishing.run(&mut sources));
            // The backlogs stay until the logger is dropped, as a daemon may still read them.
            runtime.block_on(publishing.stop.cancelled());
            drop((sources, tokens));
        });
        spawned.map_err(|source| LoggerError::Spawn { thread: THREAD, source })?;
        Ok(Self { session, machines, boot_id, published, stop, done })
    }

    /// The machines of the fleet, in the order of their index.
    pub fn machines(&self) -> &[MachineId] {
        &self.machines
    }

    /// Number of throws published so far, of all machines.
    pub fn published(&self) -> u64 {
        self.published.load(Relaxed)
    }

    /// Waits until all throws are published or the logger is stopped; returns the number of throws of each machine.
    ///
    /// # Errors
    /// When publishing failed.
    pub async fn finished(&mut self) -> Result<u64, LoggerError> {
        (&mut self.done).await.unwrap_or(Err(LoggerError::Thread))
    }

    /// Waits until daemons have judged `throws` throws of every machine; false if this takes over a minute. The session
    /// must stay open meanwhile, as the daemons may still read the backlog.
    pub async fn judged(&self, throws: u64) -> bool {
        let all = async {
            for machine in &self.machines {
                while self.latest(machine).await.is_none_or(|latest| latest < throws) {
                    time::sleep(JUDGED_POLL_INTERVAL).await;
                }
            }
        };
        throws == 0 || time::timeout(JUDGED_TIMEOUT, all).await.is_ok()
    }

    /// The highest throw number of this boot that a daemon has judged.
    async fn latest(&self, machine: &MachineId) -> Option<u64> {
        // The highest number of the last 100 rows, as the last stored throw may come from the backlog.
        let selector = format!("{}?limit=100", wire::machine_key(machine, Kind::Health));
        let replies = bus::ask(&self.session, &selector, None, Duration::from_secs(5)).await.ok()?;
        replies
            .messages
            .iter()
            .filter_map(|(_, payload)| serde_json::from_slice::<Health>(payload).ok())
            .filter(|health| health.throw.boot_id == self.boot_id)
            .map(|health| health.throw.throw_no)
            .max()
    }
}

impl Drop for Logger {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}
