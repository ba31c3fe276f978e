//! The device at a point machine that records and publishes its throws, here with simulated machines behind it.
//!
//! Publishing runs on a thread of its own: simulating a throw takes the processor, and a put waits for a slow link.

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

pub use publish::LoggerError;
pub use settings::{InvalidLogger, LoggerSettings};

use crate::{
    bus,
    simulate::{Fleet, FleetSettings},
    throw::MachineId,
    wire::{self, Health, Kind},
};
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
    /// Starts publishing the throws of a fleet: one boot, one liveliness token and one publisher a machine.
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
        let mut tokens = Vec::with_capacity(machines.len());
        for machine in &machines {
            tokens.push(bus::declare_alive(&session, &wire::machine_key(machine, Kind::Alive)).await?);
        }
        let published = Arc::new(AtomicU64::new(0));
        let stop = CancellationToken::new();
        let publishing = Publishing {
            session: session.clone(),
            settings: settings.clone(),
            boot_id: boot_id.clone(),
            published: Arc::clone(&published),
            stop: stop.clone(),
        };
        let (sender, done) = oneshot::channel();
        let named = machines.iter().cloned().zip(simulated).collect();
        let runtime = Handle::current();
        thread::Builder::new().name("logger".into()).spawn(move || {
            let (outcome, publishers) = match publishing.run(named) {
                Ok((throws, publishers)) => (Ok(throws), publishers),
                Err(error) => (Err(error), Vec::new()),
            };
            // Whoever started the logger may have gone.
            let _ = sender.send(outcome);
            runtime.block_on(publishing.stop.cancelled());
            drop((publishers, tokens));
        })?;
        Ok(Self { session, machines, boot_id, published, stop, done })
    }

    /// The machines, in order of their numbers.
    #[must_use]
    pub fn machines(&self) -> &[MachineId] {
        &self.machines
    }

    /// Throws published so far.
    #[must_use]
    pub fn published(&self) -> u64 {
        self.published.load(Relaxed)
    }

    /// Asks it to stop after the throw at hand.
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
    /// nobody answers. Until then the session must stay open: its cache is what a monitor recovers from.
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
        let key = wire::machine_key(machine, Kind::Health);
        let replies = bus::ask(&self.session, &key, None, Duration::from_secs(5)).await.ok()?;
        replies
            .iter()
            .filter_map(|(_, payload)| serde_json::from_slice::<Health>(payload).ok())
            .filter(|health| health.boot_id == self.boot_id)
            .map(|health| health.throw_no)
            .max()
    }
}

impl Drop for Logger {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}
