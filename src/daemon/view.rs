//! What other rooms of the same process may look at: how the daemon stands, its database, its limits. Nothing in it can
//! write.

use std::{collections::BTreeMap, sync::Arc};

use tokio::sync::watch;

use super::{
    config::Config,
    status::{Gauges, StatusReport},
};
use crate::store::{Reader, Statistics, StoreError};

/// A look at a running daemon. Cheap to clone.
#[derive(Clone)]
pub struct View {
    pub(super) gauges: Gauges,
    pub(super) config: watch::Receiver<Arc<Config>>,
}

impl View {
    /// How the daemon stands.
    #[must_use]
    pub fn report(&self) -> StatusReport {
        self.gauges.report()
    }

    /// Throws since the start that gave no estimate, by the code of the reason.
    #[must_use]
    pub fn refused(&self) -> BTreeMap<String, u64> {
        self.gauges.status.refused()
    }

    /// Bytes of messages that arrived and wait to be stored.
    #[must_use]
    pub fn queued_bytes(&self) -> usize {
        self.gauges.inbox.queued_bytes()
    }

    /// The reading side of the database.
    #[must_use]
    pub fn reader(&self) -> &Reader {
        self.gauges.store.reader()
    }

    /// The database's figures. Counts rows: not for every request.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn statistics(&self) -> Result<Statistics, StoreError> {
        self.gauges.store.statistics().await
    }

    /// The configuration in force.
    #[must_use]
    pub fn config(&self) -> Arc<Config> {
        Arc::clone(&self.config.borrow())
    }
}
