//! The caches of publishers, which answer for what did not arrive on its own: how they are found and asked.
//!
//! These are the keys and parameters of zenoh-ext's advanced publisher: it answers on
//! `KEY/@adv/pub/ZID/EID/…?_sn=FIRST..LAST;_max=COUNT`, tells there with a liveliness token that it is there and with a
//! small message how far it is, and numbers what it publishes. One that numbers by time has `uhlc` in place of `EID`.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    time::Duration,
};

use tokio::{sync::oneshot, task, time};
use zenoh::{
    Session, Wait,
    query::{ConsolidationMode, QueryTarget, Reply, ReplyKeyExpr},
    sample::{Sample, SampleKind},
};

use super::{
    follow::{Ending, Origin, PAGE, Question},
    inbox::{Limits, Message},
    room,
};

/// What comes of a page is kept up to here \[bytes\]; the rest is asked for again.
const PAGE_BYTES: usize = 4 << 20;
/// What comes of a cache that cannot be asked in pages is kept up to here \[bytes\].
const WHOLE_BYTES: usize = 64 << 20;
/// Longest key of the data: longer ones are of no machine. Zenoh's ids have up to 32 digits.
const KEY: usize = 256;
const ID: usize = 32;
/// Zenoh ends a question when the link of the one who is asked is given up, after 10 s; one that has not ended then never
/// will.
const ANSWERED: Duration = Duration::from_secs(15);
/// Between the key of the data and what zenoh-ext adds to it.
const ADDED: &str = "/@adv/pub/";
/// Stands for the number of a publisher that numbers by time.
const BY_TIME: &str = "uhlc";

/// Who speaks on one of the keys of zenoh-ext.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Cache {
    /// One that numbers its samples.
    Numbered(Origin),
    /// One that does not: its key.
    Unnumbered(String),
}

/// What a cache answered.
#[derive(Debug)]
pub(super) struct Answer {
    /// The samples and their numbers; of one that has none, 0.
    pub(super) samples: Vec<(u32, Message)>,
    /// Samples that came and were not kept.
    pub(super) left: u64,
    pub(super) ending: Ending,
}

impl Answer {
    /// To a question that could not be asked.
    pub(super) fn none() -> Self {
        Self { samples: Vec::new(), left: 0, ending: Ending::Unasked }
    }
}

/// The key expression on which all caches for a key expression are found, and those that are there tell about themselves.
pub(super) fn all(key_expression: &str) -> String {
    format!("{key_expression}{ADDED}**")
}

/// Reads a key of zenoh-ext.
pub(super) fn parse(key: &str) -> Option<Cache> {
    let (key, added) = key.split_once(ADDED)?;
    let mut chunks = added.split('/');
    let (zid, eid) = (chunks.next()?, chunks.next()?);
    if !is_concrete(key) || zid.len() > ID || !zid.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    if eid == BY_TIME {
        return Some(Cache::Unnumbered(key.to_owned()));
    }
    Some(Cache::Numbered(Origin { key: key.to_owned(), zid: zid.to_owned(), eid: eid.parse().ok()? }))
}

/// Whether it is one key, of a length that a machine's has.
pub(super) fn is_concrete(key: &str) -> bool {
    key.len() <= KEY && !key.contains(['*', '$', '?', '#'])
}

/// Who published a sample, and its number; nothing for one that has none.
pub(super) fn origin(sample: &Sample) -> Option<(Origin, u32)> {
    let source = sample.source_info().filter(|_| is_concrete(sample.key_expr().as_str()))?;
    let id = source.source_id();
    let origin = Origin { key: sample.key_expr().to_string(), zid: id.zid().to_string(), eid: id.eid() };
    Some((origin, source.source_sn()))
}

/// Asks all caches for their newest sample, and tells who answers. Whether all could be asked.
pub(super) async fn find(
    session: &Session,
    key_expression: &str,
    found: impl Fn(&Sample) + Send + Sync + 'static,
) -> bool {
    ask(session, format!("{}?_max=1", all(key_expression)), found).await == Ending::Complete
}

/// Asks the question of a follower. Of the newest sample only its number is brought.
pub(super) async fn page(session: &Session, question: &Question, limits: Limits) -> Answer {
    let Origin { key, zid, eid } = &question.origin;
    // Zenoh-ext compares numbers as those of a circle: a range over more than half of it would be empty.
    let (first, last) = question.numbers.clone().into_inner();
    let last = if last == u32::MAX { String::new() } else { last.to_string() };
    let newest = if question.newest { ";_max=1" } else { "" };
    let selector = format!("{key}{ADDED}{zid}/{eid}/**?_sn={first}..{last}{newest}");
    let (asked, newest) = (question.origin.clone(), question.newest);
    collect(session, selector, PAGE as usize, PAGE_BYTES, move |sample| {
        let (_, number) = origin(sample).filter(|(origin, _)| *origin == asked)?;
        let limits = if newest { Limits { max_payload_bytes: 0, kept_of_larger_bytes: 0, ..limits } } else { limits };
        Some((number, Message::of(sample, limits)))
    })
    .await
}

/// Asks the caches of a key that do not number their samples for all they have.
pub(super) async fn everything(session: &Session, key: &str, limits: Limits) -> Answer {
    let (selector, asked) = (format!("{key}{ADDED}*/{BY_TIME}/**"), key.to_owned());
    let read = move |sample: &Sample| (sample.key_expr().as_str() == asked).then(|| (0, Message::of(sample, limits)));
    collect(session, selector, usize::MAX, WHOLE_BYTES, read).await
}

/// Collects what is answered, up to some samples and bytes.
async fn collect(
    session: &Session,
    selector: String,
    most: usize,
    most_bytes: usize,
    read: impl Fn(&Sample) -> Option<(u32, Message)> + Send + Sync + 'static,
) -> Answer {
    let collected = Arc::new(Mutex::new((Vec::new(), 0, 0)));
    let collecting = Arc::clone(&collected);
    let ending = ask(session, selector, move |sample| {
        let mut collecting = collecting.lock().unwrap_or_else(PoisonError::into_inner);
        let (samples, bytes, left) = &mut *collecting;
        if samples.len() >= most || *bytes >= most_bytes {
            *left += 1;
        } else if let Some((number, message)) = read(sample) {
            *bytes += message.room().max(room::LEAST);
            samples.push((number, message));
        }
    });
    let ending = ending.await;
    let mut collected = collected.lock().unwrap_or_else(PoisonError::into_inner);
    Answer { samples: std::mem::take(&mut collected.0), left: collected.2, ending }
}

/// Asks, and hands what is answered to `take`.
async fn ask(session: &Session, selector: String, take: impl Fn(&Sample) + Send + Sync + 'static) -> Ending {
    let failed = Arc::new(AtomicBool::new(false));
    // Zenoh drops the callback, and the sender with it, when nothing more will come.
    let (open, ended) = oneshot::channel::<()>();
    let failing = Arc::clone(&failed);
    let session = session.clone();
    let on_reply = move |reply: Reply| {
        let _still = &open;
        match reply.into_result() {
            Ok(sample) if sample.kind() == SampleKind::Put => take(&sample),
            Ok(_) => {}
            Err(_) => failing.store(true, Relaxed),
        }
    };
    // Sending waits for a slow link.
    let asked = task::spawn_blocking(move || {
        session
            .get(selector)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .accept_replies(ReplyKeyExpr::Any)
            .timeout(ANSWERED)
            .callback(on_reply)
            .wait()
    });
    if !matches!(asked.await, Ok(Ok(()))) {
        return Ending::Unasked;
    }
    let has_ended = time::timeout(2 * ANSWERED, ended).await.is_ok();
    if has_ended && !failed.load(Relaxed) { Ending::Complete } else { Ending::Broken }
}
