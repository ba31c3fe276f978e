//! The publishing thread: simulates each throw, waits until it is due, publishes it.

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
use zenoh::{
    Session, Wait,
    bytes::{Encoding as ContentType, ZBytes},
    pubsub::Publisher,
    qos::CongestionControl,
};

use super::{backlog::Backlog, error::LoggerError, settings::LoggerSettings};
use crate::{
    bus::BusError,
    daemon::clock,
    simulate::SimulatedMachine,
    throw::{MachineId, ThrowRef},
    wire::{self, Kind},
};

/// Time between two checks of the stop flag while the thread waits.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Settings and state of the publishing thread.
pub(super) struct Publishing {
    pub(super) settings: LoggerSettings,
    pub(super) boot_id: String,
    pub(super) published: Arc<AtomicU64>,
    pub(super) stop: CancellationToken,
}

/// A simulated machine with its publisher and backlog.
pub(super) struct Source {
    pub(super) publisher: Publisher<'static>,
    pub(super) backlog: Backlog,
    pub(super) machine: SimulatedMachine,
}

/// Declares the publisher of a machine's throws.
pub(super) fn publisher(session: &Session, id: &MachineId) -> Result<Publisher<'static>, BusError> {
    let publisher = session
        .declare_publisher(wire::machine_key(id, Kind::Throw))
        .encoding(ContentType::APPLICATION_CBOR)
        .congestion_control(CongestionControl::Block);
    publisher.wait().map_err(BusError::new("declare a publisher of throws"))
}

/// Waits until a daemon subscribes to the throws of a publisher; false if `is_over` ended the wait.
pub(super) fn until_subscribed(publisher: &Publisher<'_>, is_over: impl Fn() -> bool) -> Result<bool, BusError> {
    loop {
        let status = publisher.matching_status().wait().map_err(BusError::new("ask for the subscribers of throws"))?;
        if status.matching() || is_over() {
            return Ok(status.matching());
        }
        thread::sleep(POLL_INTERVAL);
    }
}

impl Publishing {
    /// Publishes the throws of all machines in turn. Returns the number of throws of each machine.
    pub(super) fn run(&self, sources: &mut [Source]) -> Result<u64, LoggerError> {
        for source in sources.iter().filter(|_| self.settings.wait_for_monitor) {
            until_subscribed(&source.publisher, || self.stop.is_cancelled())?;
        }
        let started_at = self.settings.first_throw_at(clock::now());
        let start = clock::monotonic();
        let interval = Duration::from_secs_f64(self.settings.interval_s / self.settings.time_scale);
        let last = self.settings.throws.unwrap_or(u64::MAX);
        let count = sources.len().max(1) as f64;
        for round in 0..last {
            for (number, source) in sources.iter_mut().enumerate() {
                // The machines throw one after the other, evenly distributed over the interval.
                let share = number as f64 / count;
                let due = (round as f64 + share) * interval.as_secs_f64();
                let (throw, message) = self.message(&mut source.machine, started_at, round as f64 + share)?;
                if !self.wait_until(start + Duration::from_secs_f64(due)) {
                    return Ok(round);
                }
                // The backlog comes first: a daemon may ask for the throw as soon as it is published.
                source.backlog.keep(throw, message.clone());
                source.publisher.put(message).wait().map_err(BusError::new("publish a throw"))?;
                self.published.fetch_add(1, Relaxed);
            }
        }
        Ok(last)
    }

    /// Waits until `moment`; false if the logger was stopped.
    fn wait_until(&self, moment: Instant) -> bool {
        loop {
            if self.stop.is_cancelled() {
                return false;
            }
            let left = moment.saturating_duration_since(clock::monotonic());
            if left.is_zero() {
                return true;
            }
            thread::sleep(left.min(POLL_INTERVAL));
        }
    }

    fn message(
        &self,
        machine: &mut SimulatedMachine,
        started_at: Timestamp,
        intervals: f64,
    ) -> Result<(ThrowRef, ZBytes), LoggerError> {
        let elapsed = SignedDuration::try_from_secs_f64(intervals * self.settings.interval_s).unwrap_or_default();
        let started_at = started_at.saturating_add(elapsed).unwrap_or(started_at);
        let throw = machine.next_throw(&self.boot_id, started_at)?;
        let message = wire::encode_throw(&throw).into();
        Ok((throw.id, message))
    }
}
