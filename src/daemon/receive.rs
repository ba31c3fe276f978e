//! From zenoh to the database: decode and store. A message that is no throw goes to quarantine with its reason; storing is
//! retried until it works, or until the daemon has to stop.

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
    store::{QUARANTINED_BYTES, Refused, Spooled, Store, StoreError, seldom},
    throw::{MachineId, Throw},
    wire::{self, Encoding},
};

/// Messages that are taken together. Many, because all that must be refused of them costs the disk one sync; few enough
/// that a throw waits a fraction of a second for the batch before its own.
const BATCH: usize = 256;
/// First pause after a failed write; doubled up to [`LONGEST_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_millis(50);
/// A disk that was freed is noticed within this time.
const LONGEST_PAUSE: Duration = Duration::from_secs(2);

/// A decoded throw, its machine, and when it was received.
pub(super) type Received = (MachineId, Throw, Timestamp);

/// Decodes messages, and refuses what is no throw of a machine that may speak. Live throws and pages of backlogs share it.
pub(super) struct Intake {
    pub(super) store: Store,
    pub(super) status: Arc<Status>,
    /// Known machines, no more than `max_machines`, and whether a live throw of each was received since the start.
    pub(super) machines: Mutex<HashMap<MachineId, bool>>,
    pub(super) max_machines: usize,
    pub(super) max_payload_bytes: usize,
    /// The name under which the daemon's own alarms stand: no machine may have it.
    pub(super) itself: MachineId,
}

impl Intake {
    /// The throws of the messages, in their order; what is none goes to quarantine. `live`: they were published just now.
    pub(super) async fn read(&self, messages: Vec<Message>, live: bool) -> Vec<Received> {
        let (limit, count) = (self.max_payload_bytes, messages.len() as u64);
        // Decoding a large message takes milliseconds, which an async worker must not spend.
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
        self.quarantine(refused).await;
        throws
    }

    /// Whether a live throw of a machine was received since the start.
    pub(super) fn is_live(&self, machine: &MachineId) -> bool {
        self.known().get(machine) == Some(&true)
    }

    fn known(&self) -> MutexGuard<'_, HashMap<MachineId, bool>> {
        self.machines.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets a throw pass whose machine is known or may become so.
    fn admit(&self, (machine, throw, received_at): Received, live: bool) -> Result<Received, Refused> {
        let mut known = self.known();
        // Asked first: after an alarm of its own the daemon is among the machines of the database.
        let reason = if machine == self.itself {
            "this is the name of pointsd itself (monitor.site, monitor.id): a machine needs another".to_owned()
        } else if known.len() >= self.max_machines && !known.contains_key(&machine) {
            self.status.machines_refused.add(1);
            format!("more than {} machines: raise subscribe.max_machines", self.max_machines)
        } else {
            *known.entry(machine.clone()).or_default() |= live;
            return Ok((machine, throw, received_at));
        };
        Err(Refused::throw(&machine, &throw, reason, received_at))
    }

    async fn quarantine(&self, refused: Vec<Refused>) {
        let Some(Refused { key, reason, bytes, .. }) = refused.first() else { return };
        // One line for all of them, or a flood of messages becomes one of the log.
        let count = refused.len() as u64;
        seldom!(warn, key, reason, bytes, and_others = count - 1, "a message goes to quarantine");
        match self.store.quarantine(refused).await {
            Ok(()) => self.status.quarantined.fetch_add(count, Relaxed),
            Err(error) => {
                seldom!(error, %error, messages = count, "messages could not even be put in quarantine");
                self.status.lost.fetch_add(count, Relaxed)
            }
        };
    }
}

/// The loop that receives live throws.
pub(super) struct Receiver {
    pub(super) inbox: Inbox,
    pub(super) intake: Arc<Intake>,
    pub(super) store: Store,
    pub(super) status: Arc<Status>,
    /// Rung when throws were stored.
    pub(super) spooled: Arc<Notify>,
    /// Rung when a throw may be missing.
    pub(super) missing: Arc<Notify>,
    /// The daemon must end now: what could not be stored until then is lost, and logged as lost.
    pub(super) give_up: CancellationToken,
}

impl Receiver {
    /// Runs until `stop`, then stores what has arrived before it.
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
            let throws = self.intake.read(std::mem::take(&mut batch), true).await;
            self.spool(throws).await;
            self.missing.notify_one();
            self.status.heartbeats.beat(TaskName::Receive);
        }
    }

    /// Stores throws; tries again what fails.
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
            tracing::info!("the database takes throws again; those that waited are stored");
        }
    }

    fn storing_fails(&self, error: &StoreError) {
        self.status.heartbeats.beat(TaskName::Receive);
        if !self.status.storing_fails.swap(true, Relaxed) {
            tracing::error!(%error, "throws cannot be stored; they wait");
        }
    }

    fn lose(&self, throws: &[Received], error: &StoreError) {
        for (machine, throw, _) in throws {
            tracing::error!(%machine, boot_id = throw.id.boot_id, throw_no = throw.id.throw_no, %error, "a throw is LOST");
        }
        self.status.lost.fetch_add(throws.len() as u64, Relaxed);
    }

    /// When the database takes a note about a throw but not the throw, the throw itself is at fault: it must not stop
    /// all others.
    async fn without_the_unstorable(&self, throws: Vec<Received>, error: &StoreError) -> Vec<Received> {
        if !matches!(error, StoreError::Write(_) | StoreError::ThrowNumber(_)) {
            return throws;
        }
        let mut storable = Vec::with_capacity(throws.len());
        for received in throws {
            match self.store.spool(&received.0, &received.1, received.2).await {
                Ok(spooled) => self.count(spooled),
                Err(error @ (StoreError::Write(_) | StoreError::ThrowNumber(_))) => {
                    let reason = format!("the database does not take it: {error}");
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
