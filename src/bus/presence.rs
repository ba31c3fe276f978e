//! Liveliness tokens of loggers, and the presence of subscribers.

use tokio::sync::mpsc;
use zenoh::{
    Session,
    pubsub::{Publisher, Subscriber},
    sample::{Sample, SampleKind},
};

use super::error::BusError;

/// Capacity of the queue of changes: a cut link removes all tokens of a region at once.
const QUEUE: usize = 16_384;

/// A change of a liveliness token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Presence {
    /// Key of the token.
    pub key: String,
    /// Whether the token appeared; false if it went.
    pub alive: bool,
}

/// A subscription to liveliness tokens.
pub struct PresenceWatch {
    changes: mpsc::Receiver<Presence>,
    _subscriber: Subscriber<()>,
}

impl PresenceWatch {
    /// Watches a key expression; the present tokens come first.
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
                    tracing::warn!(key = %sample.key_expr(), "queue of liveliness changes full: change dropped");
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

/// The subscribers to a key expression, as seen by a publisher that publishes nothing.
pub struct Audience(Publisher<'static>);

impl Audience {
    /// Watches the subscribers to any key in the key expression.
    ///
    /// # Errors
    /// When zenoh refuses the publisher.
    pub async fn of(session: &Session, key_expression: &str) -> Result<Self, BusError> {
        let publisher = session.declare_publisher(key_expression.to_owned()).await;
        publisher.map(Self).map_err(BusError::new(format!("see the subscribers to {key_expression}")))
    }

    /// Whether any subscriber is connected now.
    pub async fn is_connected(&self) -> bool {
        self.0.matching_status().await.is_ok_and(|status| status.matching())
    }
}
