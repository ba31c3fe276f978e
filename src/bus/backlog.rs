//! Queries a logger for a page of its backlog, on the queryable of its throw key, and finds out whether it has one.

use std::{sync::Arc, time::Duration};

use parking_lot::Mutex;
use tokio::{sync::oneshot, task, time};
use zenoh::{
    Session, Wait,
    query::{ConsolidationMode, QueryTarget, Reply},
    sample::SampleKind,
};

use super::message::{Message, kept};
use crate::wire::BacklogQuery;

/// Largest page \[bytes\]. Replies beyond the limit are dropped and queried again with the next page. A reply above the
/// largest payload counts with its kept bytes only.
const PAGE_BYTES: usize = 4 << 20;
/// Time until a query for a page fails. Longer than the 10 s of silence after which zenoh closes a link.
const PAGE_TIMEOUT: Duration = Duration::from_secs(15);
/// Time for which a client waits for the reply of its router about queryables; the reply takes some milliseconds.
const ROUTER_TIMEOUT: Duration = Duration::from_millis(200);
/// Longest kept text of an error reply \[characters\].
const MAX_ERROR: usize = 200;

/// The replies of a logger to a query for a page.
#[derive(Debug, Default)]
pub(crate) struct ReplyPage {
    pub messages: Vec<Message>,
    /// Number of ignored replies: on another key, or beyond the limit of the query.
    pub ignored: u64,
    /// Whether the first reply was dropped because it is larger than a page.
    pub is_too_large: bool,
    /// Whether the query ended without an error; otherwise the logger may have more throws. Also true if the logger is
    /// not connected, or if its link closed before its last reply: zenoh then ends the query as if it were complete.
    pub is_complete: bool,
    /// The last error reply, from the logger or from zenoh at the time limit; or why the query was not sent.
    pub error: Option<String>,
}

/// Queries the throw key of a machine for a page, whose first throw may be larger than a page if `may_be_large`. Without
/// a logger the page is empty and complete.
pub(crate) async fn page(
    session: &Session,
    key: &str,
    query: &BacklogQuery,
    max_payload_bytes: usize,
    may_be_large: bool,
) -> ReplyPage {
    // The page so far, and its size \[bytes\].
    let collected = Arc::new(Mutex::new((ReplyPage::default(), 0)));
    // Zenoh drops the callback, and the sender with it, after the last reply.
    let (open, ended) = oneshot::channel::<()>();
    let collecting = Arc::clone(&collected);
    let (asked_key, limit) = (key.to_owned(), query.limit);
    let on_reply = move |reply: Reply| {
        let _open = &open;
        let mut collecting = collecting.lock();
        let (page, bytes) = &mut *collecting;
        let sample = match reply.into_result() {
            Ok(sample) => sample,
            Err(reply) => {
                let text = reply.payload().to_bytes();
                page.error = Some(String::from_utf8_lossy(&text).chars().take(MAX_ERROR).collect());
                return;
            }
        };
        let size = kept(sample.payload().len(), max_payload_bytes);
        let is_wanted = sample.kind() == SampleKind::Put && sample.key_expr().as_str() == asked_key;
        if !is_wanted || page.messages.len() >= limit {
            page.ignored += 1;
        } else if *bytes + size <= PAGE_BYTES || may_be_large && page.messages.is_empty() {
            let message = Message::of(&sample, max_payload_bytes);
            *bytes += message.memory();
            page.messages.push(message);
        } else {
            // All later replies are dropped too: the missing reply between them would look like a gap.
            *bytes = PAGE_BYTES + 1;
            page.is_too_large = page.messages.is_empty();
        }
    };
    let (session, selector) = (session.clone(), format!("{key}?{}", query.parameters()));
    // On a blocking thread, as sending blocks on a slow link.
    let sent = task::spawn_blocking(move || {
        let get = session.get(selector).target(QueryTarget::All).consolidation(ConsolidationMode::None);
        get.timeout(PAGE_TIMEOUT).callback(on_reply).wait()
    });
    let failed = match sent.await {
        Ok(Ok(())) => None,
        Ok(Err(error)) => Some(error.to_string()),
        Err(error) => Some(error.to_string()),
    };
    let has_ended = failed.is_none() && time::timeout(2 * PAGE_TIMEOUT, ended).await.is_ok();
    let (mut page, _) = std::mem::take(&mut *collected.lock());
    page.error = page.error.or(failed);
    ReplyPage { is_complete: has_ended && page.error.is_none(), ..page }
}

/// Whether a logger with a queryable on its throw key is connected; false if zenoh does not tell.
pub(crate) async fn has_queryable(session: &Session, key: String) -> bool {
    let session = session.clone();
    let find = move || {
        let querier = session.declare_querier(key).wait()?;
        let changes = querier.matching_listener().wait()?;
        let has_one = querier.matching_status().wait()?.matching()
            || changes.recv_timeout(ROUTER_TIMEOUT)?.is_some_and(|status| status.matching());
        zenoh::Result::Ok(has_one)
    };
    // On a blocking thread, as sending blocks on a slow link.
    task::spawn_blocking(find).await.is_ok_and(|found| found.unwrap_or(false))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::config_without_links;

    async fn open(mode: &str, endpoints: &str, endpoint: &str) -> Session {
        let mut config = config_without_links();
        config.insert_json5("mode", &format!("{mode:?}")).unwrap();
        config.insert_json5(endpoints, &format!("[{endpoint:?}]")).unwrap();
        zenoh::open(config).await.unwrap()
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_reply_larger_than_a_page_is_kept_only_on_request_and_alone() {
        const KEY: &str = "points/v1/north/21B/throw";
        let session = zenoh::open(config_without_links()).await.unwrap();
        let reply = |query: zenoh::query::Query| {
            for bytes in [PAGE_BYTES + 1, 1] {
                query.reply(KEY, vec![0; bytes]).wait().unwrap();
            }
        };
        session.declare_queryable(KEY).callback(reply).background().await.unwrap();
        let query = BacklogQuery { after: None, limit: 2 };
        for (max_payload_bytes, may_be_large, expected) in
            [(2 * PAGE_BYTES, false, 0), (2 * PAGE_BYTES, true, 1), (PAGE_BYTES, false, 2)]
        {
            let page = page(&session, KEY, &query, max_payload_bytes, may_be_large).await;
            assert_eq!((page.messages.len(), page.is_too_large), (expected, expected == 0), "{:?}", page.error);
            assert!(page.is_complete);
        }
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_router_and_its_client_know_whether_a_logger_has_a_queryable() {
        const KEY: &str = "points/v1/north/21B/throw";
        let router = open("router", "listen/endpoints", "tcp/127.0.0.1:0").await;
        let address = router.info().locators().await[0].to_string();
        let client = open("client", "connect/endpoints", &address).await;
        for has_one in [false, true, false] {
            let logger = open("client", "connect/endpoints", &address).await;
            if has_one {
                logger.declare_queryable(KEY).callback(drop).background().await.unwrap();
            }
            for session in [&router, &client] {
                let known = async {
                    while has_queryable(session, KEY.to_owned()).await != has_one {
                        time::sleep(Duration::from_millis(20)).await;
                    }
                };
                time::timeout(Duration::from_secs(20), known).await.unwrap();
            }
            logger.close().await.unwrap();
        }
    }
}
