//! The publishing thread: simulate, wait for the moment, put.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    thread,
    time::{Duration, Instant},
};

use jiff::{SignedDuration, Timestamp};
use tokio_util::sync::CancellationToken;
use zenoh::{Session, Wait, bytes::Encoding as ContentType, qos::CongestionControl};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

use super::LoggerSettings;
use crate::{
    bus::BusError,
    daemon::clock,
    simulate::{InvalidParameter, SimulatedMachine, SimulatedThrow},
    throw::{MachineId, Throw, ThrowRef},
    wire::{self, Encoding, Kind},
};

/// How often a publisher tells what it sent last, so that a lost last throw is noticed.
const HEARTBEAT: Duration = Duration::from_secs(1);
/// How often a waiting thread looks whether it should stop.
const LOOK: Duration = Duration::from_millis(50);

/// Why throws cannot be published.
#[derive(Debug, thiserror::Error)]
pub enum LoggerError {
    /// The simulated machine cannot be built or moved.
    #[error("the simulated fleet: {0}")]
    Simulation(#[from] InvalidParameter),
    /// Zenoh cannot be used.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Zenoh refused something.
    #[error("zenoh: {0}")]
    Zenoh(#[from] zenoh::Error),
    /// The system gives no thread.
    #[error("the system gives no thread to publish from: {0}")]
    Spawn(#[from] std::io::Error),
    /// The publishing thread died.
    #[error("the publishing thread died")]
    Thread,
}

pub(super) struct Publishing {
    pub(super) session: Session,
    pub(super) settings: LoggerSettings,
    pub(super) boot_id: String,
    pub(super) published: Arc<AtomicU64>,
    pub(super) stop: CancellationToken,
}

/// A simulated machine and where its throws go.
pub(super) struct Source {
    publisher: AdvancedPublisher<'static>,
    machine: SimulatedMachine,
}

impl Publishing {
    /// Publishes the throws of all machines in turn; returns how many of each, and the publishers: their caches are
    /// what a monitor recovers from.
    pub(super) fn run(&self, machines: Vec<(MachineId, SimulatedMachine)>) -> Result<(u64, Vec<Source>), LoggerError> {
        let mut sources = Vec::with_capacity(machines.len());
        for (id, machine) in machines {
            sources.push(Source { publisher: self.declare(&id)?, machine });
        }
        if self.settings.wait_for_monitor {
            self.wait_for_monitor(&sources)?;
        }
        let started_at = self.settings.started_at.unwrap_or_else(clock::now);
        let start = clock::monotonic();
        let interval = Duration::from_secs_f64(self.settings.interval_s / self.settings.time_scale);
        let last = self.settings.throws.unwrap_or(u64::MAX);
        let count = sources.len().max(1) as f64;
        for round in 0..last {
            for (number, source) in sources.iter_mut().enumerate() {
                // Machines throw one after the other, spread over the interval.
                let share = number as f64 / count;
                let due = (round as f64 + share) * interval.as_secs_f64();
                let message = self.message(source.machine.next_throw()?, started_at, round as f64 + share);
                if !self.wait_until(start + Duration::from_secs_f64(due)) {
                    return Ok((round, sources));
                }
                source.publisher.put(message).wait()?;
                self.published.fetch_add(1, Relaxed);
            }
        }
        Ok((last, sources))
    }

    fn declare(&self, machine: &MachineId) -> Result<AdvancedPublisher<'static>, LoggerError> {
        let publisher = self
            .session
            .declare_publisher(wire::machine_key(machine, Kind::Throw))
            .encoding(ContentType::APPLICATION_CBOR)
            .congestion_control(CongestionControl::Block)
            .cache(CacheConfig::default().max_samples(self.settings.cache))
            .sample_miss_detection(MissDetectionConfig::default().sporadic_heartbeat(HEARTBEAT))
            .publisher_detection()
            .wait()?;
        Ok(publisher)
    }

    fn wait_for_monitor(&self, sources: &[Source]) -> Result<(), LoggerError> {
        for source in sources {
            while !source.publisher.matching_status().wait()?.matching() && !self.stop.is_cancelled() {
                thread::sleep(LOOK);
            }
        }
        Ok(())
    }

    /// Waits for a moment; false when asked to stop.
    fn wait_until(&self, moment: Instant) -> bool {
        loop {
            if self.stop.is_cancelled() {
                return false;
            }
            let left = moment.saturating_duration_since(clock::monotonic());
            if left.is_zero() {
                return true;
            }
            thread::sleep(left.min(LOOK));
        }
    }

    fn message(&self, simulated: SimulatedThrow, started_at: Timestamp, intervals: f64) -> Vec<u8> {
        let elapsed = SignedDuration::try_from_secs_f64(intervals * self.settings.interval_s).unwrap_or_default();
        let throw = Throw {
            id: ThrowRef { boot_id: self.boot_id.clone(), throw_no: simulated.throw_index + 1 },
            started_at: started_at.saturating_add(elapsed).unwrap_or(started_at),
            direction: Some(simulated.direction),
            trace: simulated.trace,
            temperature_c: Some(simulated.temperature_c),
            supply_v: Some(simulated.supply_v),
            anti_alias_hz: simulated.anti_alias_hz,
        };
        wire::encode_throw(Encoding::Cbor, &throw)
    }
}
