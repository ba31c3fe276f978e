//! The device at a point machine that records and publishes its throws, here with simulated machines behind it.
//!
//! Publishing runs on a thread of its own: simulating a throw takes the processor, and a put waits for a slow link.

mod backlog;
mod error;
mod publish;
mod settings;

use std::{
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
pub use settings::LoggerSettings;

use crate::{
    bus,
    simulate::{Fleet, FleetSettings},
    throw::MachineId,
    wire::{self, Health, Kind},
};
use backlog::Answering;
use publish::Publishing;

/// How long the monitor is given to judge the last throws.
const JUDGED_LIMIT: Duration = Duration::from_mins(1);
/// How often the monitor is asked how far it is.
const JUDGED_PACE: Duration = Duration::from_millis(200);

/// A running logger. It stops when this is dropped.
pub struct Logger {
    session: Session,
    machines: Vec<MachineId>,
    boot_id: String,
    published: Arc<AtomicU64>,
    stop: CancellationToken,
    done: oneshot::Receiver<Result<u64, LoggerError>>,
}

impl Logger {
    /// Starts publishing the throws of a fleet: one boot; for each machine a backlog, a liveliness token and a publisher.
    ///
    /// # Errors
    /// When the fleet cannot be built, zenoh refuses a key, or the system gives no thread.
    pub async fn start(
        session: Session,
        settings: &LoggerSettings,
        fleet: &FleetSettings,
        boot_id: String,
    ) -> Result<Self, LoggerError> {
        let simulated = Fleet::new(fleet, settings.seed)?.into_machines();
        let machines: Vec<_> = (0..simulated.len()).map(|number| settings.machine_id(number)).collect();
        let published = Arc::new(AtomicU64::new(0));
        let stop = CancellationToken::new();
        let publishing = Publishing {
            session: session.clone(),
            settings: settings.clone(),
            boot_id: boot_id.clone(),
            published: Arc::clone(&published),
            stop: stop.clone(),
        };
        let (answering, max_bytes) = (Answering::start()?, settings.backlog_mib << 20);
        let (mut sources, mut tokens) = (Vec::with_capacity(machines.len()), Vec::with_capacity(machines.len()));
        for (id, machine) in machines.iter().zip(simulated) {
            let key = wire::machine_key(id, Kind::Throw);
            let backlog = answering.declare(&session, &key, settings.backlog_throws, max_bytes)?;
            sources.push(publishing.source(id, backlog, machine)?);
            // After the backlog: a daemon that sees the token asks for it.
            tokens.push(bus::declare_alive(&session, &wire::machine_key(id, Kind::Alive)).await?);
        }
        let (sender, done) = oneshot::channel();
        let runtime = Handle::current();
        thread::Builder::new().name("logger".into()).spawn(move || {
            let (outcome, sources) = match publishing.run(sources) {
                Ok((throws, sources)) => (Ok(throws), sources),
                Err(error) => (Err(error), Vec::new()),
            };
            // The owner of the logger may have dropped it.
            let _ = sender.send(outcome);
            runtime.block_on(publishing.stop.cancelled());
            drop((sources, tokens));
        })?;
        Ok(Self { session, machines, boot_id, published, stop, done })
    }

    /// The machines, in order of their numbers.
    #[must_use]
    pub fn machines(&self) -> &[MachineId] {
        &self.machines
    }

    /// Throws published so far, of all machines.
    #[must_use]
    pub fn published(&self) -> u64 {
        self.published.load(Relaxed)
    }

    /// Stops after the throw that is being published.
    pub fn stop(&self) {
        self.stop.cancel();
    }

    /// Waits until all throws are published, or it was stopped; returns how many of each machine.
    ///
    /// # Errors
    /// When publishing failed.
    pub async fn finished(&mut self) -> Result<u64, LoggerError> {
        (&mut self.done).await.unwrap_or(Err(LoggerError::Thread))
    }

    /// Waits until the monitors have judged `throws` throws of every machine. False when they take too long, or
    /// nobody answers. Until then the session must stay open: a monitor reads its backlog.
    pub async fn judged(&self, throws: u64) -> bool {
        let all = async {
            for machine in &self.machines {
                while self.latest(machine).await.is_none_or(|latest| latest < throws) {
                    time::sleep(JUDGED_PACE).await;
                }
            }
        };
        throws == 0 || time::timeout(JUDGED_LIMIT, all).await.is_ok()
    }

    /// The highest throw number of this boot that a monitor has judged.
    async fn latest(&self, machine: &MachineId) -> Option<u64> {
        // The last throws: those that came from the backlog were stored after later ones.
        let selector = format!("{}?limit=100", wire::machine_key(machine, Kind::Health));
        let replies = bus::ask(&self.session, &selector, None, Duration::from_secs(5)).await.ok()?;
        replies
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
