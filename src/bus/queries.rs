//! Queries on health, alarms and commands, through a bounded queue.

use tokio::{sync::mpsc, task};
use zenoh::{
    Session, Wait,
    bytes::Encoding,
    query::{Query, Queryable},
};

use super::{error::BusError, session::intersect};

/// Capacity of the queue: a dashboard asks a few times a second. A query above it gets no answer; its sender asks again.
const QUEUE: usize = 64;
/// Bytes of a payload that are read: commands are a few hundred bytes.
const MAX_PAYLOAD: usize = 64 << 10;

/// One question.
pub struct Question {
    query: Query,
}

impl Question {
    /// The key expression asked about.
    #[must_use]
    pub fn key(&self) -> &str {
        self.query.key_expr().as_str()
    }

    /// The parameters, the part of the selector after `?`.
    #[must_use]
    pub fn parameters(&self) -> &str {
        self.query.parameters().as_str()
    }

    /// A value among the parameters, as `?name=value`.
    #[must_use]
    pub fn parameter(&self, name: &str) -> Option<&str> {
        self.query.parameters().get(name)
    }

    /// The payload, cut to what a command can hold.
    #[must_use]
    pub fn payload(&self) -> Vec<u8> {
        let Some(payload) = self.query.payload() else { return Vec::new() };
        let mut bytes = Vec::new();
        for slice in payload.slices() {
            let left = MAX_PAYLOAD - bytes.len();
            bytes.extend_from_slice(&slice[..slice.len().min(left)]);
        }
        bytes
    }

    /// Whether a key is among those asked about.
    #[must_use]
    pub fn asks_about(&self, key: &str) -> bool {
        intersect(self.key(), key)
    }
}

/// A queryable and its queue.
pub struct Questions {
    waiting: mpsc::Receiver<Question>,
    _queryable: Queryable<()>,
}

impl Questions {
    /// Declares the queryable.
    ///
    /// # Errors
    /// When zenoh refuses the key expression.
    pub async fn declare(session: &Session, key_expression: &str) -> Result<Self, BusError> {
        let (sender, waiting) = mpsc::channel(QUEUE);
        let queryable = session
            .declare_queryable(key_expression.to_owned())
            .callback(move |query| {
                if sender.try_send(Question { query }).is_err() {
                    tracing::warn!("too many questions at once: one was not answered");
                }
            })
            .await
            .map_err(BusError::new(format!("answer queries on {key_expression}")))?;
        Ok(Self { waiting, _queryable: queryable })
    }

    /// The next question; `None` when the session is closed.
    pub async fn next(&mut self) -> Option<Question> {
        self.waiting.recv().await
    }
}

/// Answers a question with JSON messages, each under its key, or with one error in plain words. On a thread that may
/// wait, because a reply waits for a slow link.
pub async fn answer(question: Question, replies: Result<Vec<(String, Vec<u8>)>, String>) {
    let sent = task::spawn_blocking(move || {
        let query = question.query;
        match replies {
            Ok(messages) => {
                for (key, payload) in messages {
                    if let Err(error) = query.reply(key, payload).encoding(Encoding::APPLICATION_JSON).wait() {
                        tracing::debug!(%error, "a reply was not taken");
                    }
                }
            }
            Err(problem) => {
                if let Err(error) = query.reply_err(problem).encoding(Encoding::TEXT_PLAIN).wait() {
                    tracing::debug!(%error, "an error reply was not taken");
                }
            }
        }
    });
    if let Err(error) = sent.await {
        tracing::error!(%error, "answering a question failed");
    }
}
