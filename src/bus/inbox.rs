//! Throws as they arrive, in a bounded queue, and what did not arrive, from the caches of those who published it.

use std::{
    collections::{HashMap, VecDeque},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering::Relaxed},
    },
    time::Duration,
};

use tokio::{
    sync::mpsc,
    task::{self, JoinError, JoinSet},
    time::{self, Instant},
};
use zenoh::{
    Session,
    pubsub::Subscriber,
    sample::{Sample, SampleKind},
};
use zenoh_ext::z_deserialize;

use super::{
    BusError,
    cache::{self, Answer, Cache},
    follow::{Ending, Follower, Origin, Outcome, Question},
    is_connected,
    room::{self, Room},
};

/// Payloads of one batch: what is decoded takes up to four times as much \[bytes\].
const BATCH_BYTES: usize = 8 << 20;
/// Besides one for each machine, publishers that come, go, or tell how far they are, and wait to be heard. More than that,
/// and all are asked anew.
const SIGNALS: usize = 4_096;
/// Besides those of the machines, keys whose publishers are remembered.
const KEYS: usize = 1_024;
/// Questions that are on their way, and answers that wait to be stored.
const QUESTIONS: usize = 16;
/// Keys with caches that cannot be asked by number, and wait to be asked for everything.
const UNNUMBERED: usize = 1_024;
/// How often such a cache is asked until its answer comes to its end.
const TRIES: u32 = 4;
/// From one question to all caches to the next; doubled after one that failed, up to [`LONGEST_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_secs(5);
const LONGEST_PAUSE: Duration = Duration::from_mins(1);
/// How often it is counted what is behind.
const LOOK: Duration = Duration::from_secs(1);

/// One message as it arrived.
#[derive(Debug)]
pub struct Message {
    /// The key it came on.
    pub key: String,
    /// Its content type; empty when the sender gave none.
    pub content_type: String,
    /// The payload; of one that is too large, only the beginning.
    pub payload: Vec<u8>,
    /// The size of the whole payload \[bytes\].
    pub bytes: usize,
}

impl Message {
    /// The room that it takes while it waits \[bytes\].
    pub(super) fn room(&self) -> usize {
        self.payload.len() + self.key.len() + self.content_type.len()
    }

    pub(super) fn of(sample: &Sample, limits: Limits) -> Self {
        let bytes = sample.payload().len();
        let kept = limits.kept(bytes);
        let mut payload = Vec::with_capacity(kept);
        for slice in sample.payload().slices() {
            let left = kept - payload.len();
            payload.extend_from_slice(&slice[..slice.len().min(left)]);
        }
        let key = sample.key_expr().as_str().to_owned();
        Self { key, content_type: sample.encoding().to_string(), payload, bytes }
    }
}

/// What bounds the inbox.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Machines that may be known.
    pub max_machines: usize,
    /// Largest payload that is taken whole \[bytes\].
    pub max_payload_bytes: usize,
    /// How much of a larger one is kept as a sample \[bytes\].
    pub kept_of_larger_bytes: usize,
}

impl Limits {
    fn kept(self, bytes: usize) -> usize {
        if bytes > self.max_payload_bytes { self.kept_of_larger_bytes } else { bytes }
    }
}

/// Counts that only grow, and what is behind.
#[derive(Debug, Default)]
pub struct InboxCounters {
    /// Messages that arrived, on their own or from a cache.
    pub received: AtomicU64,
    /// Messages without a number that were dropped because the queue was full.
    pub dropped: AtomicU64,
    /// Messages that were published and did not arrive, and that no cache has any more. While the queue overflows, some that
    /// wait in it are counted with them.
    pub missed: AtomicU64,
    /// Messages that were published and are not here yet: they are in the caches of their publishers, which are asked, or
    /// cannot be reached now. As of a second ago.
    pub behind: AtomicU64,
    room: Room,
}

impl InboxCounters {
    /// Room that the messages take that wait to be stored \[bytes\].
    #[must_use]
    pub fn queued_bytes(&self) -> usize {
        self.room.taken()
    }
}

/// What a publisher lets know, besides its samples.
enum Signal {
    /// It is so far.
    Reached(Origin, u32),
    /// This sample came and found no room.
    Refused(Origin, u32),
    /// It is there, or is there no longer.
    Presence(Origin, bool),
    /// On this key there is a cache without numbers.
    Unnumbered(String),
}

/// A message, and its number if its publisher numbers them.
type Arrived = (Message, Option<(Origin, u32)>);

/// The subscriptions and their queues.
pub struct Inbox {
    session: Session,
    key_expression: String,
    /// Whether the session reaches others through a router only.
    is_client: bool,
    subscriptions: Vec<Subscriber<()>>,
    callbacks: Callbacks,
    messages: mpsc::Receiver<Arrived>,
    signals: mpsc::Receiver<Signal>,
    follower: Follower<Message>,
    /// Keys whose caches are to be asked for everything, and how often they were.
    unnumbered: VecDeque<(String, u32)>,
    asked: HashMap<task::Id, Asked>,
    answers: JoinSet<Answer>,
    /// The question to all caches how far they are: whether it came to its end.
    all: JoinSet<bool>,
    all_from: Instant,
    all_pause: Duration,
    looked_at: Instant,
}

/// What an answer is about.
enum Asked {
    Numbers(Question),
    Everything(String, u32),
}

impl Inbox {
    /// Subscribes to a key expression.
    ///
    /// # Errors
    /// When zenoh refuses the subscription.
    pub async fn subscribe(
        session: &Session,
        key_expression: &str,
        limits: Limits,
        is_client: bool,
    ) -> Result<Self, BusError> {
        let (message_sender, messages) = mpsc::channel(room::MESSAGES);
        let (signal_sender, signals) = mpsc::channel(limits.max_machines + SIGNALS);
        let callbacks = Callbacks {
            messages: message_sender,
            signals: signal_sender,
            counters: Arc::default(),
            // Nothing is known yet.
            lost_track: Arc::new(AtomicBool::new(true)),
            limits,
        };
        let mut inbox = Self {
            session: session.clone(),
            key_expression: key_expression.to_owned(),
            is_client,
            subscriptions: Vec::new(),
            callbacks,
            messages,
            signals,
            follower: Follower::new(limits.max_machines + KEYS, Message::room),
            unnumbered: VecDeque::new(),
            asked: HashMap::new(),
            answers: JoinSet::new(),
            all: JoinSet::new(),
            all_from: Instant::now(),
            all_pause: FIRST_PAUSE,
            looked_at: Instant::now(),
        };
        inbox.listen().await.map_err(BusError::new(format!("subscribe to {key_expression}")))?;
        Ok(inbox)
    }

    async fn listen(&mut self) -> zenoh::Result<()> {
        let [arrived, reached, presence] = [(); 3].map(|()| self.callbacks.clone());
        let caches = cache::all(&self.key_expression);
        let samples = self.session.declare_subscriber(self.key_expression.clone());
        let pulses = self.session.declare_subscriber(caches.clone());
        let tokens = self.session.liveliness().declare_subscriber(caches).history(true);
        self.subscriptions = vec![
            samples.callback(move |sample| arrived.arrived(&sample)).await?,
            pulses.callback(move |sample| reached.reached(&sample)).await?,
            tokens.callback(move |sample| presence.presence(&sample)).await?,
        ];
        Ok(())
    }

    /// The counts.
    #[must_use]
    pub fn counters(&self) -> Arc<InboxCounters> {
        Arc::clone(&self.callbacks.counters)
    }

    /// Waits for messages and moves about `limit` of them into `batch`, fewer when they are large; returns how many. 0
    /// after [`Self::close`], once the queue is empty. When it is dropped while it waits, nothing is lost.
    pub async fn receive(&mut self, batch: &mut Vec<Message>, limit: usize) -> usize {
        let before = batch.len();
        if self.looked_at.elapsed() >= LOOK {
            self.looked_at = Instant::now();
            self.callbacks.counters.behind.store(self.follower.behind(), Relaxed);
        }
        while batch.len() == before {
            self.ask();
            let wakes_at = self.wakes_at();
            tokio::select! {
                message = self.messages.recv() => {
                    let Some(message) = message else {
                        batch.extend(self.follower.finish());
                        break;
                    };
                    self.take(message, batch);
                }
                Some(signal) = self.signals.recv() => self.heed(signal, batch),
                Some(answer) = self.answers.join_next_with_id() => {
                    // That its publisher has gone may be why an answer is empty.
                    for _ in 0..self.signals.len() {
                        let Ok(signal) = self.signals.try_recv() else { break };
                        self.heed(signal, batch);
                    }
                    self.hear(answer, batch);
                }
                Some(answer) = self.all.join_next() => self.hear_all(answer.is_ok_and(|is_whole| is_whole)),
                () = time::sleep_until(wakes_at.unwrap_or_else(Instant::now)), if wakes_at.is_some() => {}
            }
            let mut counted = before;
            let mut bytes = 0;
            for _ in 1..limit {
                bytes += batch[counted..].iter().map(Message::room).sum::<usize>();
                counted = batch.len();
                if counted - before >= limit || bytes >= BATCH_BYTES {
                    break;
                }
                let Ok(message) = self.messages.try_recv() else { break };
                self.take(message, batch);
            }
        }
        batch.len() - before
    }

    /// Ends the subscription. What waits in the queue can still be received.
    pub async fn close(&mut self) {
        for subscription in self.subscriptions.drain(..) {
            if let Err(error) = subscription.undeclare().await {
                tracing::warn!(%error, "the subscription could not be ended in good order");
            }
        }
        self.answers.shutdown().await;
        self.all.shutdown().await;
        self.messages.close();
        self.signals.close();
    }

    /// When something is to be asked, if nothing happens before.
    fn wakes_at(&self) -> Option<Instant> {
        let rests_until = self.follower.rests_until().filter(|_| self.answers.len() < QUESTIONS).map(Instant::from_std);
        let has_lost_track = self.callbacks.lost_track.load(Relaxed) && self.all.is_empty();
        rests_until.into_iter().chain(has_lost_track.then_some(self.all_from)).min()
    }

    /// Asks what is to be asked, as long as the answers are taken.
    fn ask(&mut self) {
        if self.subscriptions.is_empty() {
            return;
        }
        let now = Instant::now();
        while self.answers.len() < QUESTIONS {
            let (session, limits, is_client) = (self.session.clone(), self.callbacks.limits, self.is_client);
            if let Some(question) = self.follower.question(now.into_std()) {
                let asked = question.clone();
                let answer = async move {
                    if is_reachable(&session, is_client).await {
                        cache::page(&session, &asked, limits).await
                    } else {
                        Answer::none()
                    }
                };
                self.asked.insert(self.answers.spawn(answer).id(), Asked::Numbers(question));
            } else if let Some((key, tries)) = self.unnumbered.pop_front() {
                let asked = key.clone();
                let answer = async move { cache::everything(&session, &asked, limits).await };
                self.asked.insert(self.answers.spawn(answer).id(), Asked::Everything(key, tries + 1));
            } else {
                break;
            }
        }
        if self.all.is_empty() && now >= self.all_from && self.callbacks.lost_track.swap(false, Relaxed) {
            self.ask_all();
        }
    }

    /// Asks all publishers how far they are, also those whose comings and goings are not seen.
    fn ask_all(&mut self) {
        let (session, callbacks, is_client) = (self.session.clone(), self.callbacks.clone(), self.is_client);
        let key_expression = self.key_expression.clone();
        self.all.spawn(async move {
            let found = move |sample: &Sample| callbacks.found(sample);
            is_reachable(&session, is_client).await && cache::find(&session, &key_expression, found).await
        });
    }

    fn hear_all(&mut self, is_whole: bool) {
        self.all_from = Instant::now() + self.all_pause;
        if is_whole {
            self.all_pause = FIRST_PAUSE;
        } else {
            self.all_pause = (2 * self.all_pause).min(LONGEST_PAUSE);
            self.callbacks.lost_track.store(true, Relaxed);
        }
    }

    fn take(&mut self, (message, number): Arrived, batch: &mut Vec<Message>) {
        self.callbacks.counters.room.give_back(&message.key, message.room());
        match number {
            Some((origin, number)) => {
                let outcome = self.follower.live(&origin, number, message);
                self.hand_on(outcome, batch);
            }
            None => batch.push(message),
        }
    }

    fn heed(&mut self, signal: Signal, batch: &mut Vec<Message>) {
        let outcome = match signal {
            Signal::Reached(origin, number) => self.follower.reached(&origin, number),
            Signal::Refused(origin, number) => self.follower.refused(&origin, number),
            Signal::Presence(origin, true) => self.follower.appeared(&origin),
            Signal::Presence(origin, false) => self.follower.gone(&origin),
            Signal::Unnumbered(key) => {
                self.ask_for_everything(key, 0);
                return;
            }
        };
        self.hand_on(outcome, batch);
    }

    fn ask_for_everything(&mut self, key: String, tries: u32) {
        if self.unnumbered.iter().any(|(other, _)| *other == key) {
            return;
        }
        if self.unnumbered.len() < UNNUMBERED {
            self.unnumbered.push_back((key, tries));
        } else {
            self.callbacks.lost_track.store(true, Relaxed);
        }
    }

    fn hear(&mut self, answer: Result<(task::Id, Answer), JoinError>, batch: &mut Vec<Message>) {
        let (id, answer) = answer.unwrap_or_else(|error| {
            tracing::error!(%error, "asking a logger's cache failed");
            (error.id(), Answer::none())
        });
        let counters = &self.callbacks.counters;
        match self.asked.remove(&id) {
            Some(Asked::Numbers(question)) => {
                let came = if question.newest { 0 } else { answer.samples.len() as u64 };
                counters.received.fetch_add(came, Relaxed);
                let now = Instant::now().into_std();
                let outcome = self.follower.answered(&question, answer.samples, answer.ending, now);
                self.hand_on(outcome, batch);
            }
            Some(Asked::Everything(key, tries)) => {
                counters.received.fetch_add(answer.samples.len() as u64 + answer.left, Relaxed);
                counters.dropped.fetch_add(answer.left, Relaxed);
                batch.extend(answer.samples.into_iter().map(|(_, message)| message));
                if answer.ending != Ending::Complete && tries < TRIES {
                    self.ask_for_everything(key, tries);
                }
            }
            None => {}
        }
    }

    fn hand_on(&self, outcome: Outcome<Message>, batch: &mut Vec<Message>) {
        batch.extend(outcome.samples);
        self.callbacks.counters.missed.fetch_add(outcome.missed, Relaxed);
    }
}

/// Whether there is somebody to ask. To a client without its router, the answer is as empty as of those who have nothing.
async fn is_reachable(session: &Session, is_client: bool) -> bool {
    !is_client || is_connected(session).await
}

/// Runs in zenoh's threads: counts, copies, hands over, returns.
#[derive(Clone)]
struct Callbacks {
    messages: mpsc::Sender<Arrived>,
    signals: mpsc::Sender<Signal>,
    counters: Arc<InboxCounters>,
    /// Something of a publisher was not heard: all are to be asked how far they are.
    lost_track: Arc<AtomicBool>,
    limits: Limits,
}

impl Callbacks {
    fn arrived(&self, sample: &Sample) {
        if sample.kind() != SampleKind::Put {
            return;
        }
        let (key, content_type) = (sample.key_expr().as_str(), sample.encoding().to_string());
        let room = self.limits.kept(sample.payload().len()) + key.len() + content_type.len();
        let number = cache::origin(sample);
        if !self.counters.room.take(key, room) {
            return self.refuse(sample, number);
        }
        if let Err(error) = self.messages.try_send((Message::of(sample, self.limits), number)) {
            self.counters.room.give_back(key, room);
            return self.refuse(sample, error.into_inner().1);
        }
        self.counters.received.fetch_add(1, Relaxed);
    }

    /// There is no room. What has a number is asked for later, and missed when it is not there; of the others some may be
    /// in a cache.
    fn refuse(&self, sample: &Sample, number: Option<(Origin, u32)>) {
        if let Some((origin, number)) = number {
            return self.signal(Signal::Refused(origin, number));
        }
        self.counters.received.fetch_add(1, Relaxed);
        self.counters.dropped.fetch_add(1, Relaxed);
        if sample.timestamp().is_some() {
            self.lost_track.store(true, Relaxed);
        }
    }

    fn reached(&self, sample: &Sample) {
        if let Some(Cache::Numbered(origin)) = cache::parse(sample.key_expr().as_str())
            && sample.kind() == SampleKind::Put
            && let Ok(number) = z_deserialize::<u32>(sample.payload())
        {
            self.signal(Signal::Reached(origin, number));
        }
    }

    fn presence(&self, sample: &Sample) {
        let is_there = sample.kind() == SampleKind::Put;
        match cache::parse(sample.key_expr().as_str()) {
            Some(Cache::Numbered(origin)) => self.signal(Signal::Presence(origin, is_there)),
            Some(Cache::Unnumbered(key)) if is_there => self.signal(Signal::Unnumbered(key)),
            _ => {}
        }
    }

    fn found(&self, sample: &Sample) {
        let key = sample.key_expr().as_str();
        match cache::origin(sample) {
            Some((origin, number)) => self.signal(Signal::Reached(origin, number)),
            None if cache::is_concrete(key) => self.signal(Signal::Unnumbered(key.to_owned())),
            None => {}
        }
    }

    fn signal(&self, signal: Signal) {
        if self.signals.try_send(signal).is_err() {
            self.lost_track.store(true, Relaxed);
        }
    }
}
