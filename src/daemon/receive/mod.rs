//! Receives, decodes and stores throws. A message that is not a valid throw goes to quarantine with its reason. Storing
//! is retried until it succeeds or the daemon must end.

pub(super) mod backlog;
mod pages;

use std::{
    collections::{HashMap, HashSet},
    hash::{DefaultHasher, Hash, Hasher},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
    time::{Duration, Instant},
};

use jiff::Timestamp;
use parking_lot::Mutex;
use tokio::{task, time};

use super::{clock, shared::Shared, supervision::heartbeat::TaskName};
use crate::{
    bus::{self, Inbox, Message},
    store::{QuarantinedMessage, ReceivedThrow, Spooled, StoreError, seldom},
    throw::{MachineId, Throw},
    wire::{self, Encoding, Kind},
};

/// Largest batch \[messages\]. A large batch needs one disk sync for all its quarantined messages. A small batch keeps
/// the next one waiting for less than a second.
const BATCH: usize = 256;
/// Least time from the start of a batch to the next. The throws of a batch share disk syncs, statements and wake-ups,
/// which otherwise cost half of the processor time at 400 throws/s. A throw after a pause is stored at once.
const PACE: Duration = Duration::from_millis(20);
/// The same after a batch of more than [`FEW`] messages.
const BUSY_PACE: Duration = Duration::from_millis(50);
/// Messages in a batch of a fleet with 200 throws/s, within [`PACE`].
const FEW: usize = 4;
/// First pause after a failed write; doubled up to [`LONGEST_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_millis(50);
/// Longest pause after a failed write: the delay until freed disk space is used.
const LONGEST_PAUSE: Duration = Duration::from_secs(2);

/// Longest reason of a quarantined message \[characters\], so that alarms and the status stay readable.
const MAX_REASON: usize = 512;
/// Largest number of remembered hashes of quarantined messages; a larger set is cleared.
const REFUSED_BEFORE: usize = 10_000;

/// Time after a live throw for which a logger without a liveliness token counts as connected. It is longer than the
/// wait until missing throws are written off (5 s), and shorter than most cuts of a link. During a short cut, only a
/// queryable that disappears shows that the logger is not connected: see [`Intake::may_reply`].
const LIVE: Duration = Duration::from_mins(1);

/// The way by which a message arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Origin {
    /// The logger published it.
    Live,
    /// A reply to a query for a backlog.
    Backlog,
}

/// Signs of a logger since the start of the daemon.
#[derive(Default)]
struct LoggerSeen {
    /// Time of its last live throw.
    live_at: Option<Instant>,
    /// Whether it had a queryable for its backlog.
    had_queryable: bool,
}

/// Decodes live messages and pages of backlogs, and quarantines invalid messages and throws of machines that are not
/// allowed.
pub(super) struct Intake {
    shared: Arc<Shared>,
    /// Known machines, at most `max_machines`.
    machines: Mutex<HashMap<MachineId, LoggerSeen>>,
    /// Hashes of invalid messages from backlogs, and whether each is in quarantine: the same page may be queried again and
    /// again.
    refused_before: Mutex<HashMap<u64, bool>>,
}

impl Intake {
    /// `machines` are those of the database that this daemon serves.
    pub(super) fn new(shared: Arc<Shared>, machines: Vec<MachineId>) -> Self {
        let machines = machines.into_iter().map(|machine| (machine, LoggerSeen::default())).collect();
        Self { shared, machines: Mutex::new(machines), refused_before: Mutex::default() }
    }

    /// Decodes messages in order. Also returns those that are no valid throw, for quarantine.
    async fn read(&self, messages: Vec<Message>, origin: Origin) -> (Vec<ReceivedThrow>, Vec<QuarantinedMessage>) {
        let (limit, count) = (self.shared.config.subscribe.max_payload_bytes, messages.len() as u64);
        // Decoding a large message takes milliseconds, too long for an async worker.
        let decoded = task::spawn_blocking(move || {
            let received_at = clock::now();
            let decode = |message: &Message| decode(message, received_at, limit);
            messages.into_iter().map(|message| guarded(message, received_at, decode)).collect::<Vec<_>>()
        });
        let decoded = match decoded.await {
            Ok(decoded) => decoded,
            Err(error) => {
                tracing::error!(%error, messages = count, "decoding failed: a batch of messages is LOST");
                self.shared.status.edit().lost += count;
                return (Vec::new(), Vec::new());
            }
        };
        let (mut throws, mut refused) = (Vec::with_capacity(decoded.len()), Vec::new());
        for outcome in decoded {
            match outcome.and_then(|received| self.admit(received, origin)) {
                Ok(received) => throws.push(received),
                Err(why) => refused.push(why),
            }
        }
        (throws, refused)
    }

    /// Decodes live messages in order, and quarantines those that are no valid throw.
    async fn read_live(&self, messages: Vec<Message>) -> Vec<ReceivedThrow> {
        let (throws, refused) = self.read(messages, Origin::Live).await;
        for refused in &refused {
            if let Some((machine, _)) = wire::parse_key(&refused.key).ok().filter(|(machine, _)| self.knows(machine)) {
                self.shared.status.count_invalid(machine, &refused.reason);
            }
        }
        let messages = refused.len() as u64;
        if let Err(error) = self.quarantine(refused).await {
            self.count_lost(messages, &error);
        }
        throws
    }

    /// Quarantines messages from a backlog, each only once. After an error their page is queried again. If SQLite refuses
    /// them (constraint, type), a retry would fail for ever: then they count as lost, each only once too.
    async fn quarantine_of_backlog(&self, mut refused: Vec<QuarantinedMessage>) -> Result<(), StoreError> {
        let (all, mut hashes) = (refused.len(), HashSet::new());
        refused.retain(|refused| {
            let hash = hash_of(refused);
            self.refused_before.lock().get(&hash) != Some(&true) && hashes.insert(hash)
        });
        let repeated = (all - refused.len()) as u64;
        let stored = self.quarantine(refused).await;
        if let Err(error) = &stored
            && !matches!(error, StoreError::Refused(_))
        {
            return stored;
        }
        self.shared.status.edit().duplicates += repeated;
        let mut before = self.refused_before.lock();
        if before.len() >= REFUSED_BEFORE {
            before.clear();
        }
        hashes.retain(|hash| before.insert(*hash, stored.is_ok()).is_none());
        if let Err(error) = stored
            && !hashes.is_empty()
        {
            self.count_lost(hashes.len() as u64, &error);
        }
        Ok(())
    }

    fn count_lost(&self, messages: u64, error: &StoreError) {
        seldom!(error, %error, messages, "storing messages in quarantine failed: they are LOST");
        self.shared.status.edit().lost += messages;
    }

    /// Whether a logger is connected: it has a token, or it sent a live throw in the last minute. After the loss of its
    /// token only throws from [`LIVE`] later on count, as received throws wait before they are decoded.
    fn is_connected(&self, machine: &MachineId) -> bool {
        let loggers = self.shared.loggers.borrow();
        let live_at = || self.machines.lock().get(machine).and_then(|seen| seen.live_at);
        loggers.alive.contains(machine) || live_at().is_some_and(|last| is_live(last, loggers.gone.get(machine)))
    }

    /// Whether a logger that counts as connected can reply to a query, or never could. After its link closed, a query
    /// ends as if the logger had no newer throw, and only its missing queryable shows the closed link. A logger that had
    /// no queryable since the start of the daemon has no backlog.
    async fn may_reply(&self, machine: &MachineId) -> bool {
        if self.shared.loggers.borrow().alive.contains(machine) {
            return true;
        }
        let has_queryable = bus::has_queryable(&self.shared.session, wire::machine_key(machine, Kind::Throw)).await;
        let mut machines = self.machines.lock();
        let Some(seen) = machines.get_mut(machine) else { return true };
        seen.had_queryable |= has_queryable;
        has_queryable || !seen.had_queryable
    }

    /// The known machines whose loggers have no token now. A logger that lost its token may go on without it.
    fn without_token(&self) -> Vec<MachineId> {
        let loggers = self.shared.loggers.borrow();
        self.machines.lock().keys().filter(|machine| !loggers.alive.contains(*machine)).cloned().collect()
    }

    /// Whether a throw of a machine was ever received.
    pub(super) fn knows(&self, machine: &MachineId) -> bool {
        self.machines.lock().contains_key(machine)
    }

    /// Whether the throws of a machine are stored. Otherwise they go to quarantine.
    fn may_store(&self, machine: &MachineId) -> bool {
        self.refusal(&self.machines.lock(), machine).is_none()
    }

    /// The reason why the throws of a machine go to quarantine; `None` if it is known, or may become known.
    fn refusal(&self, known: &HashMap<MachineId, LoggerSeen>, machine: &MachineId) -> Option<String> {
        let max_machines = self.shared.config.subscribe.max_machines;
        let is_full = known.len() >= max_machines && !known.contains_key(machine);
        let full = || is_full.then(|| format!("more than {max_machines} machines: raise subscribe.max_machines"));
        // Checked first, so that a reserved name gets its own reason even when max_machines is reached.
        self.shared.config.monitor.reserves(machine).or_else(full)
    }

    /// Accepts a throw of a known machine, or of a new one if it is allowed; otherwise returns the throw for
    /// quarantine.
    fn admit(&self, received: ReceivedThrow, origin: Origin) -> Result<ReceivedThrow, QuarantinedMessage> {
        let ReceivedThrow { machine, throw, received_at } = &received;
        let mut known = self.machines.lock();
        if let Some(reason) = self.refusal(&known, machine) {
            if origin == Origin::Live && self.shared.config.monitor.reserves(machine).is_none() {
                self.shared.status.machines_refused.add(1);
            }
            return Err(QuarantinedMessage::throw(machine, throw, reason, *received_at));
        }
        let seen = known.entry(machine.clone()).or_default();
        if origin == Origin::Live {
            seen.live_at = Some(clock::monotonic());
            self.shared.status.count_valid(machine);
        }
        Ok(received)
    }

    /// Stores messages in quarantine.
    async fn quarantine(&self, refused: Vec<QuarantinedMessage>) -> Result<(), StoreError> {
        let Some(QuarantinedMessage { key, reason, bytes, .. }) = refused.first() else { return Ok(()) };
        // One log line for the batch, so that a flood of messages does not flood the log.
        let count = refused.len() as u64;
        seldom!(warn, key, reason, bytes, and_others = count - 1, "message quarantined");
        self.shared.store.quarantine(refused).await?;
        self.shared.status.edit().quarantined += count;
        Ok(())
    }
}

/// The receiving loop of live throws.
pub(super) struct ReceiveLoop {
    shared: Arc<Shared>,
    inbox: Inbox,
    intake: Arc<Intake>,
    /// Number of received messages that are not decoded yet.
    undecoded: u64,
    unstored: Vec<ReceivedThrow>,
    /// Whether the last write failed. The log then has one line about it, and not one for each retry.
    storing_fails: bool,
}

impl ReceiveLoop {
    pub(super) fn new(shared: Arc<Shared>, inbox: Inbox, intake: Arc<Intake>) -> Self {
        Self { shared, inbox, intake, undecoded: 0, unstored: Vec::new(), storing_fails: false }
    }

    /// Receives and stores messages until its stop signal, then stores the rest of the queue. When `give_up` is
    /// cancelled, the messages that are not stored yet are lost.
    pub(super) async fn run(mut self) {
        let shared = Arc::clone(&self.shared);
        tokio::select! {
            biased;
            () = self.receive() => {}
            () = shared.stops.give_up.cancelled() => self.log_lost().await,
        }
    }

    async fn receive(&mut self) {
        let mut batch = Vec::with_capacity(BATCH);
        let mut beat = clock::every(Duration::from_secs(1));
        let mut open = true;
        loop {
            let count = tokio::select! {
                biased;
                () = self.shared.stops.receive.cancelled(), if open => {
                    self.inbox.close().await;
                    open = false;
                    continue;
                }
                count = self.inbox.receive(&mut batch, BATCH) => count,
                _ = beat.tick() => {
                    self.shared.status.heartbeats.beat(TaskName::Receive);
                    continue;
                }
            };
            if count == 0 {
                return;
            }
            let next = time::Instant::now() + if count > FEW { BUSY_PACE } else { PACE };
            self.undecoded = count as u64;
            self.unstored = self.intake.read_live(std::mem::take(&mut batch)).await;
            self.undecoded = 0;
            // Each of the two writes may wait for as long as another program locks the database.
            self.shared.status.heartbeats.beat(TaskName::Receive);
            self.spool().await;
            self.shared.missing.notify_one();
            self.shared.status.heartbeats.beat(TaskName::Receive);
            if open {
                time::sleep_until(next).await;
            }
        }
    }

    /// Stores the throws of a batch, with retries.
    async fn spool(&mut self) {
        let mut pause = FIRST_PAUSE;
        while !self.unstored.is_empty() {
            match self.shared.store.spool_all(&self.unstored).await {
                Ok(spooled) => {
                    self.unstored.clear();
                    for spooled in spooled {
                        self.count(spooled);
                    }
                }
                Err(error) => {
                    self.shared.status.heartbeats.beat(TaskName::Receive);
                    if !std::mem::replace(&mut self.storing_fails, true) {
                        tracing::error!(%error, "storing throws failed; retrying");
                    }
                    self.quarantine_the_unstorable(&error).await;
                }
            }
            self.shared.stored.notify_one();
            if self.unstored.is_empty() {
                // The database has stored or quarantined every throw of the batch.
                if std::mem::take(&mut self.storing_fails) {
                    tracing::info!("the database accepts throws again; waiting throws are stored");
                }
                return;
            }
            time::sleep(pause).await;
            pause = (2 * pause).min(LONGEST_PAUSE);
        }
    }

    fn count(&self, spooled: Spooled) {
        match spooled {
            Spooled::New(_) => self.shared.status.edit().stored += 1,
            Spooled::Duplicate => self.shared.status.edit().duplicates += 1,
        }
    }

    /// Logs the throws that are not stored, and ends the subscription.
    async fn log_lost(&mut self) {
        for ReceivedThrow { machine, throw, .. } in &self.unstored {
            tracing::error!(%machine, boot_id = throw.id.boot_id, throw_no = throw.id.throw_no, "a throw is LOST");
        }
        self.inbox.close().await;
    }

    /// After a refusal by SQLite (constraint, type), stores each throw alone. A throw that SQLite refuses again goes to
    /// quarantine. After any other error a throw is retried later.
    async fn quarantine_the_unstorable(&mut self, error: &StoreError) {
        if !matches!(error, StoreError::Refused(_)) {
            return;
        }
        // A throw stays in `unstored` until it is stored, as `give_up` can end this loop at each `await`.
        let mut at = 0;
        while let Some(ReceivedThrow { machine, throw, received_at }) = self.unstored.get(at) {
            self.shared.status.heartbeats.beat(TaskName::Receive);
            let is_done = match self.shared.store.spool(machine, throw, *received_at).await {
                Ok(spooled) => {
                    self.count(spooled);
                    true
                }
                Err(StoreError::Refused(problem)) => {
                    let refused = unstorable(machine, throw, &problem, *received_at);
                    let is_kept = self.shared.store.quarantine(vec![refused]).await.is_ok();
                    self.shared.status.edit().quarantined += u64::from(is_kept);
                    is_kept
                }
                Err(_) => false,
            };
            if is_done {
                self.unstored.remove(at);
            } else {
                at += 1;
            }
        }
    }
}

/// Counts the messages that are not stored when the loop gives up or panics. A write in progress may still be
/// committed, so the count is an upper bound.
impl Drop for ReceiveLoop {
    fn drop(&mut self) {
        let messages = self.undecoded + self.inbox.discard() as u64;
        self.shared.status.edit().lost += messages + self.unstored.len() as u64;
        if messages > 0 {
            tracing::error!(messages, "received messages could not be stored: they are LOST");
        }
    }
}

/// Whether a logger without a token is connected, from its last live throw and the loss of its token, if it had one.
fn is_live(last: Instant, gone_at: Option<&Instant>) -> bool {
    last.elapsed() < LIVE && gone_at.is_none_or(|gone_at| last > *gone_at + LIVE)
}

/// Hash of a message, to recognise it in the next page.
fn hash_of(QuarantinedMessage { key, bytes, beginning, .. }: &QuarantinedMessage) -> u64 {
    let mut hasher = DefaultHasher::new();
    (key, bytes, beginning).hash(&mut hasher);
    hasher.finish()
}

/// A throw that SQLite refuses to store.
fn unstorable(machine: &MachineId, throw: &Throw, problem: &str, at: Timestamp) -> QuarantinedMessage {
    QuarantinedMessage::throw(machine, throw, format!("the database rejects it: {problem}"), at)
}

/// Decodes a message. A message that makes the decoder panic goes to quarantine like any invalid message, and the rest
/// of its batch is kept.
fn guarded(
    message: Message,
    received_at: Timestamp,
    decode: impl Fn(&Message) -> Result<ReceivedThrow, String>,
) -> Result<ReceivedThrow, QuarantinedMessage> {
    let with_id = |reason| (reason, wire::throw_id(encoding(&message), &message.payload));
    let decoded = catch_unwind(AssertUnwindSafe(|| decode(&message).map_err(with_id)));
    let failed = |_| Err(("the decoder failed on this message: please report it".to_owned(), None));
    decoded.unwrap_or_else(failed).map_err(|(reason, id)| {
        let Message { key, payload: beginning, bytes, .. } = message;
        let reason = reason.chars().take(MAX_REASON).collect();
        QuarantinedMessage { key, reason, bytes, id: id.map(Box::new), beginning, at: received_at }
    })
}

fn encoding(message: &Message) -> Encoding {
    Encoding::of(&message.content_type, &message.payload)
}

fn decode(message: &Message, received_at: Timestamp, limit: usize) -> Result<ReceivedThrow, String> {
    let Message { key, payload, bytes, .. } = message;
    if message.is_delete {
        return Err("a delete, which is no throw: a logger only puts".to_owned());
    }
    if *bytes > limit {
        return Err(format!("{bytes} bytes, more than subscribe.max_payload_bytes = {limit}"));
    }
    let (machine, _) = wire::parse_key(key)?;
    let throw = wire::decode_throw(encoding(message), payload)?;
    Ok(ReceivedThrow { machine, throw, received_at })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_logger_that_goes_on_without_its_token_is_live() {
        let gone_at = clock::monotonic().checked_sub(10 * LIVE).unwrap();
        let now = clock::monotonic();
        assert!(is_live(now, None) && is_live(now, Some(&gone_at)));
        assert!(!is_live(now, Some(&now)), "a throw from before the loss of the token");
        assert!(!is_live(gone_at + 2 * LIVE, Some(&gone_at)), "silent since");
    }

    #[test]
    fn a_message_that_makes_the_decoder_panic_costs_no_other() {
        let message = |key: &str| Message {
            key: key.to_owned(),
            content_type: String::new(),
            payload: vec![7; 2 * wire::QUARANTINED_BYTES],
            bytes: 2 * wire::QUARANTINED_BYTES,
            is_delete: false,
        };
        let decoded = ["good", "poison", "good"].map(|key| {
            guarded(message(key), Timestamp::UNIX_EPOCH, |message| {
                assert!(message.key != "poison", "a defect of the decoder");
                Err("é".repeat(10 * MAX_REASON))
            })
        });
        let reasons = decoded.map(|refused| refused.unwrap_err().reason);
        assert!(
            reasons[1].contains("the decoder failed")
                && [0, 2].iter().all(|at| reasons[*at].chars().count() == MAX_REASON),
            "{reasons:?}"
        );
    }
}
