//! Who is there: loggers, whose liveliness tokens come and go, and those who listen to what is published.

use tokio::sync::mpsc;
use zenoh::{
    Session,
    pubsub::{Publisher, Subscriber},
    sample::{Sample, SampleKind},
};

use super::BusError;

/// Changes that may wait: a cut link takes all tokens of a region away at once.
const QUEUE: usize = 16_384;

/// A logger came or went.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Presence {
    /// The key of its token.
    pub key: String,
    /// Whether it is there.
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
                    tracing::warn!(key = %sample.key_expr(), "too many loggers come and go: one change was not seen");
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

/// Those who listen on a key expression.
pub struct Audience(Publisher<'static>);

impl Audience {
    /// Whoever subscribes to something in the key expression.
    ///
    /// # Errors
    /// When zenoh refuses it.
    pub async fn of(session: &Session, key_expression: &str) -> Result<Self, BusError> {
        let publisher = session.declare_publisher(key_expression.to_owned()).await;
        publisher.map(Self).map_err(BusError::new(format!("see who listens on {key_expression}")))
    }

    /// Whether anybody listens now.
    pub async fn is_there(&self) -> bool {
        self.0.matching_status().await.is_ok_and(|status| status.matching())
    }
}
