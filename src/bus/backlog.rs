//! A page of a logger's backlog, from the queryable on its throw key.

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
    query::{ConsolidationMode, QueryTarget, Reply},
    sample::SampleKind,
};

use super::message::{Limits, Message};
use crate::wire::BacklogQuery;

/// Replies of one page are kept up to here \[bytes\], and the first in any case; the rest is asked for again.
const PAGE_BYTES: usize = 4 << 20;
/// A page must come within this time. Zenoh gives up a link after 10 s of silence.
const ANSWERED: Duration = Duration::from_secs(15);

/// How a page ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// All replies have come.
    Complete,
    /// The time was up first, or something failed: more may be there.
    Broken,
}

/// What a logger answered.
#[derive(Debug)]
pub struct Page {
    /// The replies in the order of arrival.
    pub messages: Vec<Message>,
    /// Replies that were ignored: on another key, or more than were asked for.
    pub ignored: u64,
    /// How it ended.
    pub ending: Ending,
}

struct Collected {
    page: Page,
    bytes: usize,
}

/// Asks for a page on the throw key of a machine. A logger that is not there answers with an empty page.
pub async fn page(session: &Session, key: &str, query: &BacklogQuery, limits: Limits) -> Page {
    let empty = Page { messages: Vec::new(), ignored: 0, ending: Ending::Complete };
    let collected = Arc::new(Mutex::new(Collected { page: empty, bytes: 0 }));
    let failed = Arc::new(AtomicBool::new(false));
    // Zenoh drops the callback, and the sender with it, after the last reply.
    let (open, ended) = oneshot::channel::<()>();
    let (collecting, failing) = (Arc::clone(&collected), Arc::clone(&failed));
    let (asked_key, limit) = (key.to_owned(), query.limit);
    let on_reply = move |reply: Reply| {
        let _open = &open;
        let Ok(sample) = reply.into_result() else { return failing.store(true, Relaxed) };
        let mut collecting = collecting.lock().unwrap_or_else(PoisonError::into_inner);
        let Collected { page, bytes } = &mut *collecting;
        let is_wanted = sample.kind() == SampleKind::Put && sample.key_expr().as_str() == asked_key;
        if !is_wanted || page.messages.len() >= limit {
            page.ignored += 1;
        } else if page.messages.is_empty() || *bytes + sample.payload().len() <= PAGE_BYTES {
            let message = Message::of(&sample, limits);
            *bytes += message.memory();
            page.messages.push(message);
        } else {
            // What follows a reply that was left out would look like a gap.
            *bytes = PAGE_BYTES;
        }
    };
    let (session, selector) = (session.clone(), format!("{key}?{}", query.parameters()));
    // Sending waits for a slow link.
    let sent = task::spawn_blocking(move || {
        let get = session.get(selector).target(QueryTarget::All).consolidation(ConsolidationMode::None);
        get.timeout(ANSWERED).callback(on_reply).wait()
    });
    let is_sent = matches!(sent.await, Ok(Ok(())));
    let has_ended = is_sent && time::timeout(2 * ANSWERED, ended).await.is_ok();
    let mut collected = collected.lock().unwrap_or_else(PoisonError::into_inner);
    let ending = if has_ended && !failed.load(Relaxed) { Ending::Complete } else { Ending::Broken };
    Page { messages: std::mem::take(&mut collected.page.messages), ignored: collected.page.ignored, ending }
}
