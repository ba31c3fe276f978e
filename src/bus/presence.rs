//! Liveliness tokens of loggers, and whether a subscriber matches what is published.

use tokio::sync::mpsc;
use zenoh::{
    Session,
    pubsub::{Publisher, Subscriber},
    sample::{Sample, SampleKind},
};

use super::error::BusError;

/// Capacity of the queue of changes: a cut link takes all tokens of a region away at once.
const QUEUE: usize = 16_384;

/// A liveliness token appeared or went.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Presence {
    /// The key of its token.
    pub key: String,
    /// Whether the token is there.
    pub alive: bool,
}

/// The subscription to tokens.
pub struct PresenceWatch {
    changes: mpsc::Receiver<Presence>,
    _subscriber: Subscriber<()>,
}

impl PresenceWatch {
    /// Watches a key expression, beginning with the tokens that are there now.
    ///
    /// # Errors
    /// When zenoh refuses the subscription.
    pub async fn subscribe(session: &Session, key_expression: &str) -> Result<Self, BusError> {
        let (sender, changes) = mpsc::channel(QUEUE);
        let subscriber = session
            .liveliness()
            .declare_subscriber(key_expression.to_owned())
            .history(true)
            .callback(move |sample: Sample| {
                let presence = Presence { key: sample.key_expr().to_string(), alive: sample.kind() == SampleKind::Put };
                if sender.try_send(presence).is_err() {
                    tracing::warn!(key = %sample.key_expr(), "too many changes of liveliness at once: one is lost");
                }
            })
            .await
            .map_err(BusError::new(format!("watch the liveliness of {key_expression}")))?;
        Ok(Self { changes, _subscriber: subscriber })
    }

    /// The next change; `None` when the session is closed.
    pub async fn next(&mut self) -> Option<Presence> {
        self.changes.recv().await
    }
}

/// Subscribers to a key expression.
pub struct Audience(Publisher<'static>);

impl Audience {
    /// Watches the subscribers to any key in the key expression.
    ///
    /// # Errors
    /// When zenoh refuses it.
    pub async fn of(session: &Session, key_expression: &str) -> Result<Self, BusError> {
        let publisher = session.declare_publisher(key_expression.to_owned()).await;
        publisher.map(Self).map_err(BusError::new(format!("see the subscribers to {key_expression}")))
    }

    /// Whether a subscriber is connected now.
    pub async fn is_there(&self) -> bool {
        self.0.matching_status().await.is_ok_and(|status| status.matching())
    }
}
