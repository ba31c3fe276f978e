//! State that the loops of the daemon share.

use std::sync::Arc;

use tokio::sync::{Notify, watch};
use tokio_util::sync::CancellationToken;
use zenoh::Session;

use super::{
    config::Config,
    supervision::{presence::Tokens, status::Status},
};
use crate::{bus, store::Store};

/// Stop signals of the loops. They are cancelled one after the other, so that each loop can finish the work that the
/// previous loop left for it.
#[derive(Default)]
pub(crate) struct Stops {
    /// Stops the receiving loop and the queries for backlogs.
    pub(crate) receive: CancellationToken,
    pub(crate) judge: CancellationToken,
    pub(crate) publish: CancellationToken,
    /// Cancelled when a loop has not ended in time: it then leaves its unfinished work. Throws that are not stored are
    /// then lost, and are logged and counted as lost.
    pub(crate) give_up: CancellationToken,
}

/// State that the loops share.
pub(crate) struct Shared {
    /// The configuration at the start. A reload changes only its sections `diagnosis` and `machines`, of which the judge
    /// has the present values.
    pub(crate) config: Arc<Config>,
    pub(crate) session: Session,
    /// Whether the session reaches other sessions through a router only.
    pub(crate) is_client: bool,
    pub(crate) store: Store,
    pub(crate) status: Arc<Status>,
    pub(crate) loggers: watch::Receiver<Tokens>,
    pub(crate) stops: Stops,
    /// Notified when a throw is stored.
    pub(crate) stored: Notify,
    /// Notified when a throw number may be missing.
    pub(crate) missing: Notify,
    /// Notified when the outbox has a new message.
    pub(crate) outbox: Notify,
    /// Notified when the webhook has a new alarm event to send.
    pub(crate) webhook: Notify,
}

impl Shared {
    pub(super) fn new(config: Arc<Config>, session: Session, store: Store, loggers: watch::Receiver<Tokens>) -> Self {
        Self {
            is_client: bus::is_client(&config.zenoh),
            config,
            session,
            store,
            status: Arc::default(),
            loggers,
            stops: Stops::default(),
            stored: Notify::default(),
            missing: Notify::default(),
            outbox: Notify::default(),
            webhook: Notify::default(),
        }
    }
}
