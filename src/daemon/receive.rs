//! From zenoh to the database: decode, spool, and nothing else. What cannot be read goes to quarantine with its
//! reason; what cannot be stored is tried again until it can, or until the daemon has to stop.

use std::{
    collections::HashSet,
    sync::{Arc, atomic::Ordering::Relaxed},
    time::Duration,
};

use tokio::{sync::Notify, task, time};
use tokio_util::sync::CancellationToken;

use super::{clock, heartbeat::Organ, status::Status};
use crate::{
    bus::{Inbox, Message},
    store::{QUARANTINED_BYTES, Refused, Spooled, Store, StoreError},
    throw::{MachineId, Throw},
    wire::{self, Encoding},
};

/// Messages that are taken together. Many, because all that must be refused of them costs the disk one sync: a flood of
/// bad messages must not hold good ones up.
const BATCH: usize = 1_024;
/// First pause after a failed write; doubled up to [`LONGEST_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_millis(50);
/// A disk that was freed is noticed within this time.
const LONGEST_PAUSE: Duration = Duration::from_secs(2);

type Received = (MachineId, Throw, jiff::Timestamp);

/// The loop that receives.
pub(super) struct Receiver {
    pub(super) inbox: Inbox,
    pub(super) store: Store,
    pub(super) status: Arc<Status>,
    /// Rung when something was stored.
    pub(super) spooled: Arc<Notify>,
    /// Machines that are known; no more than `max_machines` ever are.
    pub(super) machines: HashSet<MachineId>,
    pub(super) max_machines: usize,
    pub(super) max_payload_bytes: usize,
    /// The name under which the daemon's own alarms stand: no machine may speak under it.
    pub(super) itself: MachineId,
    /// The daemon must end now: what could not be stored until then is lost, and said to be.
    pub(super) give_up: CancellationToken,
}

impl Receiver {
    /// Runs until `stop`, then takes in what has arrived before it.
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
                    self.status.heartbeats.beat(Organ::Receive);
                    continue;
                }
            };
            if count == 0 {
                return;
            }
            self.take(std::mem::take(&mut batch)).await;
            self.status.heartbeats.beat(Organ::Receive);
        }
    }

    async fn take(&mut self, batch: Vec<Message>) {
        let (limit, count) = (self.max_payload_bytes, batch.len() as u64);
        // Decoding a large message takes milliseconds, which an async worker must not spend.
        let decoded = task::spawn_blocking(move || {
            let received_at = clock::now();
            batch.into_iter().map(|message| decode(message, received_at, limit)).collect::<Vec<_>>()
        });
        let decoded = match decoded.await {
            Ok(decoded) => decoded,
            Err(error) => {
                tracing::error!(%error, messages = count, "decoding failed: a batch of messages is LOST");
                self.status.lost.fetch_add(count, Relaxed);
                return;
            }
        };
        let (mut throws, mut refused) = (Vec::with_capacity(decoded.len()), Vec::new());
        for outcome in decoded {
            match outcome.and_then(|received| self.admit(received)) {
                Ok(received) => throws.push(received),
                Err(why) => refused.push(why),
            }
        }
        self.quarantine(refused).await;
        self.spool(throws).await;
    }

    /// Lets a throw pass whose machine is known or may become so.
    fn admit(&mut self, (machine, throw, received_at): Received) -> Result<Received, Refused> {
        // Asked first: after an alarm of its own the daemon is among the machines of the database.
        let reason = if machine == self.itself {
            "this is the name of pointsd itself (monitor.site, monitor.id): a machine needs another".to_owned()
        } else if self.machines.len() >= self.max_machines && !self.machines.contains(&machine) {
            format!("more than {} machines: raise subscribe.max_machines", self.max_machines)
        } else {
            self.machines.insert(machine.clone());
            return Ok((machine, throw, received_at));
        };
        Err(Refused::throw(&machine, &throw, reason, received_at))
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
            Spooled::Duplicate { .. } => self.status.duplicates.fetch_add(1, Relaxed),
        };
    }

    fn storing_works(&self) {
        if self.status.storing_fails.swap(false, Relaxed) {
            tracing::info!("the database takes throws again; those that waited are stored");
        }
    }

    fn storing_fails(&self, error: &StoreError) {
        self.status.heartbeats.beat(Organ::Receive);
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

    async fn quarantine(&self, refused: Vec<Refused>) {
        let Some(Refused { key, reason, bytes, .. }) = refused.first() else { return };
        // One line for all of them, or a flood of messages becomes one of the log.
        let count = refused.len() as u64;
        tracing::warn!(key, reason, bytes, and_others = count - 1, "a message goes to quarantine");
        match self.store.quarantine(refused).await {
            Ok(()) => self.status.quarantined.fetch_add(count, Relaxed),
            Err(error) => {
                tracing::error!(%error, messages = count, "messages could not even be put in quarantine");
                self.status.lost.fetch_add(count, Relaxed)
            }
        };
    }
}

fn decode(message: Message, received_at: jiff::Timestamp, limit: usize) -> Result<Received, Refused> {
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
