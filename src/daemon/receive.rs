//! Receives, decodes and stores throws. A message that is not a valid throw goes to quarantine with its reason. Storing
//! is retried until it succeeds or the daemon must end.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError, atomic::Ordering::Relaxed},
    time::Duration,
};

use jiff::Timestamp;
use tokio::{sync::Notify, task, time};
use tokio_util::sync::CancellationToken;

use super::{clock, heartbeat::TaskName, status::Status};
use crate::{
    bus::{Inbox, Message},
    store::{ALL_MACHINES, QUARANTINED_BYTES, Refused, Spooled, Store, StoreError, seldom},
    throw::{MachineId, Throw},
    wire::{self, Encoding},
};

/// Largest batch \[messages\]. A large batch shares one sync among its rejected messages; a small one keeps the wait
/// for the previous batch below a second.
const BATCH: usize = 256;
/// Least time between two batches: the throws of a busy fleet share syncs, statements and wake-ups, which cost half of
/// the processor time at 400 throws/s. A single throw is stored at once.
const PACE: Duration = Duration::from_millis(20);
/// Least time after a batch of more than [`FEW`] throws, as in a fleet of more than 200 throws/s.
const BUSY_PACE: Duration = Duration::from_millis(50);
const FEW: usize = 4;
/// First pause after a failed write; doubled up to [`LONGEST_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_millis(50);
/// Longest pause, within which freed disk space is noticed.
const LONGEST_PAUSE: Duration = Duration::from_secs(2);

/// Time after a live throw for which a logger without a liveliness token counts as connected: longer than a gap is
/// awaited, shorter than most cuts of a link.
const LIVE: Duration = Duration::from_mins(1);

/// A decoded throw with its machine and the time of reception.
pub(super) type Received = (MachineId, Throw, Timestamp);

/// Decodes live messages and pages of backlogs, and rejects invalid throws and machines.
pub(super) struct Intake {
    pub(super) store: Store,
    pub(super) status: Arc<Status>,
    /// Known machines, at most `max_machines`, with the time of the last live throw since the start.
    pub(super) machines: Mutex<HashMap<MachineId, Option<time::Instant>>>,
    pub(super) max_machines: usize,
    pub(super) max_payload_bytes: usize,
    /// Name of the daemon as a machine; no real machine may have it.
    pub(super) itself: MachineId,
}

impl Intake {
    /// Decodes messages in order; puts rejected ones into quarantine. `live` is false for pages of backlogs.
    pub(super) async fn read(&self, messages: Vec<Message>, live: bool) -> Vec<Received> {
        let (limit, count) = (self.max_payload_bytes, messages.len() as u64);
        // Decoding a large message takes milliseconds, too long for an async worker.
        let decoded = task::spawn_blocking(move || {
            let received_at = clock::now();
            messages.into_iter().map(|message| decode(message, received_at, limit)).collect::<Vec<_>>()
        });
        let decoded = match decoded.await {
            Ok(decoded) => decoded,
            Err(error) => {
                tracing::error!(%error, messages = count, "decoding failed: a batch of messages is LOST");
                self.status.lost.fetch_add(count, Relaxed);
                return Vec::new();
            }
        };
        let (mut throws, mut refused) = (Vec::with_capacity(decoded.len()), Vec::new());
        for outcome in decoded {
            match outcome.and_then(|received| self.admit(received, live)) {
                Ok(received) => throws.push(received),
                Err(why) => refused.push(why),
            }
        }
        for refused in refused.iter().filter(|_| live) {
            if let Ok((machine, _)) = wire::parse_key(&refused.key)
                && self.known().contains_key(&machine)
            {
                self.status.count_invalid(machine, &refused.reason);
            }
        }
        self.quarantine(refused).await;
        throws
    }

    /// Whether a live throw of a machine was received in the last minute.
    pub(super) fn is_live(&self, machine: &MachineId) -> bool {
        self.known().get(machine).copied().flatten().is_some_and(|last| last.elapsed() < LIVE)
    }

    fn known(&self) -> MutexGuard<'_, HashMap<MachineId, Option<time::Instant>>> {
        self.machines.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Accepts a throw of a known or new machine.
    fn admit(&self, (machine, throw, received_at): Received, live: bool) -> Result<Received, Refused> {
        let mut known = self.known();
        // Checked first: the daemon itself is in the database as a machine after its first alarm.
        let reason = if machine == self.itself {
            "this is the name of pointsd itself (monitor.site, monitor.id): a machine needs another".to_owned()
        } else if machine.machine.as_str() == ALL_MACHINES {
            format!("{ALL_MACHINES} is the name of the common alarms of a site: a machine needs another")
        } else if known.len() >= self.max_machines && !known.contains_key(&machine) {
            self.status.machines_refused.add(1);
            format!("more than {} machines: raise subscribe.max_machines", self.max_machines)
        } else {
            let last = known.entry(machine.clone()).or_default();
            *last = live.then(time::Instant::now).or(*last);
            if live {
                self.status.count_valid(&machine);
            }
            return Ok((machine, throw, received_at));
        };
        Err(Refused::throw(&machine, &throw, reason, received_at))
    }

    async fn quarantine(&self, refused: Vec<Refused>) {
        let Some(Refused { key, reason, bytes, .. }) = refused.first() else { return };
        // One log line for the batch, so that a flood of messages does not flood the log.
        let count = refused.len() as u64;
        seldom!(warn, key, reason, bytes, and_others = count - 1, "message quarantined");
        match self.store.quarantine(refused).await {
            Ok(()) => self.status.quarantined.fetch_add(count, Relaxed),
            Err(error) => {
                seldom!(error, %error, messages = count, "storing messages in quarantine failed: they are LOST");
                self.status.lost.fetch_add(count, Relaxed)
            }
        };
    }
}

/// The receiving loop of live throws.
pub(super) struct ReceiveLoop {
    pub(super) inbox: Inbox,
    pub(super) intake: Arc<Intake>,
    pub(super) store: Store,
    pub(super) status: Arc<Status>,
    /// Notified when throws were stored.
    pub(super) spooled: Arc<Notify>,
    /// Notified when a throw may be missing.
    pub(super) missing: Arc<Notify>,
    /// Cancelled when the daemon must end: unstored throws are then lost, and logged as lost.
    pub(super) give_up: CancellationToken,
}

impl ReceiveLoop {
    /// Runs until `stop`, then stores the rest of the queue.
    pub(super) async fn run(mut self, stop: CancellationToken) {
        let mut batch = Vec::with_capacity(BATCH);
        let mut beat = time::interval(Duration::from_secs(1));
        let mut open = true;
        loop {
            let count = tokio::select! {
                biased;
                () = stop.cancelled(), if open => {
                    self.inbox.close().await;
                    open = false;
                    continue;
                }
                count = self.inbox.receive(&mut batch, BATCH) => count,
                _ = beat.tick() => {
                    self.status.heartbeats.beat(TaskName::Receive);
                    continue;
                }
            };
            if count == 0 {
                return;
            }
            let next = time::Instant::now() + if count > FEW { BUSY_PACE } else { PACE };
            let throws = self.intake.read(std::mem::take(&mut batch), true).await;
            self.spool(throws).await;
            self.missing.notify_one();
            self.status.heartbeats.beat(TaskName::Receive);
            time::sleep_until(next).await;
        }
    }

    /// Stores throws, with retries.
    async fn spool(&mut self, mut throws: Vec<Received>) {
        let mut pause = FIRST_PAUSE;
        while !throws.is_empty() {
            let answers = self.store.spool_all(&throws).await;
            let mut failed = Vec::new();
            let mut error = None;
            for (received, answer) in throws.into_iter().zip(answers) {
                match answer {
                    Ok(spooled) => self.count(spooled),
                    Err(why) => {
                        error = Some(why);
                        failed.push(received);
                    }
                }
            }
            self.spooled.notify_one();
            let Some(error) = error else {
                self.storing_works();
                return;
            };
            self.storing_fails(&error);
            if self.give_up.is_cancelled() {
                self.lose(&failed, &error);
                return;
            }
            throws = self.without_the_unstorable(failed, &error).await;
            if throws.is_empty() {
                // The database has stored or quarantined each of them.
                self.storing_works();
                return;
            }
            tokio::select! {
                () = time::sleep(pause) => {}
                () = self.give_up.cancelled() => {}
            }
            pause = (2 * pause).min(LONGEST_PAUSE);
        }
    }

    fn count(&self, spooled: Spooled) {
        match spooled {
            Spooled::New(_) => self.status.stored.fetch_add(1, Relaxed),
            Spooled::Duplicate => self.status.duplicates.fetch_add(1, Relaxed),
        };
    }

    fn storing_works(&self) {
        if self.status.storing_fails.swap(false, Relaxed) {
            tracing::info!("the database accepts throws again; waiting throws are stored");
        }
    }

    fn storing_fails(&self, error: &StoreError) {
        self.status.heartbeats.beat(TaskName::Receive);
        if !self.status.storing_fails.swap(true, Relaxed) {
            tracing::error!(%error, "storing throws failed; retrying");
        }
    }

    fn lose(&self, throws: &[Received], error: &StoreError) {
        for (machine, throw, _) in throws {
            tracing::error!(%machine, boot_id = throw.id.boot_id, throw_no = throw.id.throw_no, %error, "a throw is LOST");
        }
        self.status.lost.fetch_add(throws.len() as u64, Relaxed);
    }

    /// Stores each throw alone. A throw whose statement SQLite refuses (constraint, type) goes to quarantine; after any
    /// other error it is retried.
    async fn without_the_unstorable(&self, throws: Vec<Received>, error: &StoreError) -> Vec<Received> {
        if !matches!(error, StoreError::Refused(_)) {
            return throws;
        }
        let mut storable = Vec::with_capacity(throws.len());
        for received in throws {
            self.status.heartbeats.beat(TaskName::Receive);
            match self.store.spool(&received.0, &received.1, received.2).await {
                Ok(spooled) => self.count(spooled),
                Err(error @ StoreError::Refused(_)) => {
                    let reason = format!("the database rejects it: {error}");
                    let refused = Refused::throw(&received.0, &received.1, reason, received.2);
                    match self.store.quarantine(vec![refused]).await {
                        Ok(()) => drop(self.status.quarantined.fetch_add(1, Relaxed)),
                        Err(_) => storable.push(received),
                    }
                }
                Err(_) => storable.push(received),
            }
        }
        storable
    }
}

fn decode(message: Message, received_at: Timestamp, limit: usize) -> Result<Received, Refused> {
    let Message { key, content_type, payload, bytes } = message;
    let read = if bytes > limit {
        Err(format!("{bytes} bytes, more than subscribe.max_payload_bytes = {limit}"))
    } else {
        match wire::parse_key(&key) {
            Ok((machine, _)) => wire::decode_throw(Encoding::of(&content_type, &payload), &payload)
                .map(|throw| (machine, throw, received_at))
                .map_err(|error| error.to_string()),
            Err(error) => Err(error.to_string()),
        }
    };
    read.map_err(|reason| {
        let mut beginning = payload;
        beginning.truncate(QUARANTINED_BYTES);
        Refused { key, reason, bytes, beginning, at: received_at }
    })
}
