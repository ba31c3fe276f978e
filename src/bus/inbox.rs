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
    follow::{Follower, Origin, Outcome, Question},
    is_connected,
    room::{self, Room},
};

/// Payloads of one batch: what is decoded takes up to four times as much \[bytes\].
const BATCH_BYTES: usize = 8 << 20;
/// Publishers that come, go, or tell how far they are, and wait to be heard. More than that, and all are asked anew.
const SIGNALS: usize = 4_096;
/// Pages that are on their way or wait to be stored.
const PAGES: usize = 4;
/// Keys with caches that cannot be asked by number, and wait to be asked for everything.
const UNNUMBERED: usize = 1_024;
/// Least time from one question to all caches to the next.
const ALL_AGAIN: Duration = Duration::from_secs(5);
/// For so long a question waits for a router.
const ROUTER_LIMIT: Duration = Duration::from_secs(15);
/// How often a client looks whether its router is there.
const LOOK: Duration = Duration::from_millis(200);

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

/// Counts that only grow.
#[derive(Debug, Default)]
pub struct InboxCounters {
    /// Messages that arrived, on their own or from a cache.
    pub received: AtomicU64,
    /// Messages that were dropped because the queue was full, and that no cache can be asked for.
    pub dropped: AtomicU64,
    /// Messages that were published and did not arrive, and that no cache has any more.
    pub missed: AtomicU64,
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
    unnumbered: VecDeque<String>,
    asked: HashMap<task::Id, Question>,
    answers: JoinSet<Answer>,
    all_asked_at: Option<Instant>,
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
        let (signal_sender, signals) = mpsc::channel(SIGNALS);
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
            follower: Follower::new(),
            unnumbered: VecDeque::new(),
            asked: HashMap::new(),
            answers: JoinSet::new(),
            all_asked_at: None,
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
        while batch.len() == before {
            self.ask();
            let wakes_at = self.wakes_at();
            tokio::select! {
                message = self.messages.recv() => match message {
                    Some(message) => self.take(message, batch),
                    None => {
                        batch.extend(self.follower.finish());
                        break;
                    }
                },
                Some(signal) = self.signals.recv() => self.heed(signal, batch),
                Some(answer) = self.answers.join_next_with_id() => self.hear(answer, batch),
                () = time::sleep_until(wakes_at.unwrap_or_else(Instant::now)), if wakes_at.is_some() => {}
            }
            let (mut counted, mut bytes) = (before, 0);
            loop {
                bytes += batch[counted..].iter().map(|message| message.payload.len()).sum::<usize>();
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
        self.answers.abort_all();
        self.messages.close();
        self.signals.close();
    }

    /// When something is to be asked, if nothing happens before.
    fn wakes_at(&self) -> Option<Instant> {
        let all_again = self.all_asked_at.filter(|_| self.callbacks.lost_track.load(Relaxed)).map(|at| at + ALL_AGAIN);
        self.follower.rests_until().map(Instant::from_std).into_iter().chain(all_again).min()
    }

    /// Asks what is to be asked, as long as the answers are taken.
    fn ask(&mut self) {
        let is_closed = self.subscriptions.is_empty();
        while !is_closed && self.answers.len() < PAGES {
            let (session, limits, is_client) = (self.session.clone(), self.callbacks.limits, self.is_client);
            if let Some(question) = self.follower.question(Instant::now().into_std()) {
                let asked = question.clone();
                let task = self.answers.spawn(async move {
                    if !is_reachable(&session, is_client).await {
                        return Answer::default();
                    }
                    cache::page(&session, &asked, limits).await
                });
                self.asked.insert(task.id(), question);
            } else if let Some(key) = self.unnumbered.pop_front() {
                self.answers.spawn(async move { cache::everything(&session, &key, limits).await });
            } else {
                break;
            }
        }
        let is_time = self.all_asked_at.is_none_or(|at| at.elapsed() >= ALL_AGAIN);
        if !is_closed && is_time && self.callbacks.lost_track.swap(false, Relaxed) {
            self.all_asked_at = Some(Instant::now());
            self.ask_all();
        }
    }

    /// Asks all publishers how far they are, also those whose comings and goings are not seen.
    fn ask_all(&self) {
        let (session, callbacks, key_expression) =
            (self.session.clone(), self.callbacks.clone(), self.key_expression.clone());
        task::spawn(async move {
            let finder = callbacks.clone();
            if !cache::find(&session, &key_expression, move |sample| finder.found(sample)).await {
                callbacks.lost_track.store(true, Relaxed);
            }
        });
    }

    fn take(&mut self, (message, number): Arrived, batch: &mut Vec<Message>) {
        self.callbacks.counters.room.give_back(&message.key, message.payload.len());
        match number {
            Some((origin, number)) => {
                let bytes = message.payload.len();
                let outcome = self.follower.live(&origin, number, bytes, message);
                self.hand_on(outcome, batch);
            }
            None => batch.push(message),
        }
    }

    fn heed(&mut self, signal: Signal, batch: &mut Vec<Message>) {
        let outcome = match signal {
            Signal::Reached(origin, number) => self.follower.reached(&origin, number),
            Signal::Presence(origin, true) => self.follower.appeared(&origin),
            Signal::Presence(origin, false) => self.follower.gone(&origin),
            Signal::Unnumbered(key) => {
                if !self.unnumbered.contains(&key) && self.unnumbered.len() < UNNUMBERED {
                    self.unnumbered.push_back(key);
                }
                return;
            }
        };
        self.hand_on(outcome, batch);
    }

    fn hear(&mut self, answer: Result<(task::Id, Answer), JoinError>, batch: &mut Vec<Message>) {
        let (id, answer) = match answer {
            Ok(answered) => answered,
            Err(error) => {
                tracing::error!(%error, "asking a logger's cache failed");
                (error.id(), Answer::default())
            }
        };
        match self.asked.remove(&id) {
            Some(question) => {
                let now = Instant::now().into_std();
                let came = if question.newest { 0 } else { answer.samples.len() as u64 };
                self.callbacks.counters.received.fetch_add(came, Relaxed);
                let outcome = self.follower.answered(&question, answer.samples, answer.complete, now);
                self.hand_on(outcome, batch);
            }
            None => {
                self.callbacks.counters.received.fetch_add(answer.samples.len() as u64, Relaxed);
                batch.extend(answer.samples.into_iter().map(|(_, message)| message));
            }
        }
    }

    fn hand_on(&self, outcome: Outcome<Message>, batch: &mut Vec<Message>) {
        batch.extend(outcome.samples);
        self.callbacks.counters.missed.fetch_add(outcome.missed, Relaxed);
    }
}

/// Waits for the router of a client: without it, nobody answers at once, as if nobody had anything.
async fn is_reachable(session: &Session, is_client: bool) -> bool {
    let router = async {
        while !is_connected(session).await {
            time::sleep(LOOK).await;
        }
    };
    !is_client || time::timeout(ROUTER_LIMIT, router).await.is_ok()
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
        let (key, kept) = (sample.key_expr().as_str(), self.limits.kept(sample.payload().len()));
        let number = cache::origin(sample);
        if !self.counters.room.take(key, kept) {
            return self.refuse(number);
        }
        if let Err(error) = self.messages.try_send((Message::of(sample, self.limits), number)) {
            self.counters.room.give_back(key, kept);
            return self.refuse(error.into_inner().1);
        }
        self.counters.received.fetch_add(1, Relaxed);
    }

    /// There is no room: what has a number is asked for later.
    fn refuse(&self, number: Option<(Origin, u32)>) {
        if let Some((origin, number)) = number {
            self.signal(Signal::Reached(origin, number));
        } else {
            self.counters.received.fetch_add(1, Relaxed);
            self.counters.dropped.fetch_add(1, Relaxed);
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
        self.signal(match cache::origin(sample) {
            Some((origin, number)) => Signal::Reached(origin, number),
            None => Signal::Unnumbered(sample.key_expr().as_str().to_owned()),
        });
    }

    fn signal(&self, signal: Signal) {
        if self.signals.try_send(signal).is_err() {
            self.lost_track.store(true, Relaxed);
        }
    }
}
