//! The interface of the daemon for the dashboard: status, reader of the database, configuration, operators' commands.

use std::{collections::BTreeMap, sync::Arc};

use tokio::sync::watch;

use super::{
    config::Config,
    orders::Orders,
    status::{Gauges, StatusReport},
};
use crate::{
    diagnose::Command,
    store::{Reader, Statistics, StoreError},
    throw::MachineId,
    wire::Reply,
};

/// A view of a running daemon. Cheap to clone.
#[derive(Clone)]
pub struct View {
    pub(super) gauges: Gauges,
    pub(super) config: watch::Receiver<Arc<Config>>,
    pub(super) orders: Orders,
}

impl View {
    /// The status of the daemon.
    #[must_use]
    pub fn report(&self) -> StatusReport {
        self.gauges.report()
    }

    /// Throws without an estimate since the start, by the code of the reason.
    #[must_use]
    pub fn refused(&self) -> BTreeMap<String, u64> {
        self.gauges.status.refused()
    }

    /// Memory of received messages not stored yet \[bytes\].
    #[must_use]
    pub fn queued_bytes(&self) -> usize {
        self.gauges.inbox.queued_bytes()
    }

    /// The reader of the database.
    #[must_use]
    pub fn reader(&self) -> &Reader {
        self.gauges.store.reader()
    }

    /// Figures of the database. Counts rows, so it is too slow for every request.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn statistics(&self) -> Result<Statistics, StoreError> {
        self.gauges.store.statistics().await
    }

    /// Applies and commits an operator's command.
    ///
    /// # Errors
    /// A sentence, if the daemon does not answer in time.
    pub async fn carry_out(&self, machine: MachineId, command: Command) -> Result<Reply, String> {
        self.orders.carry_out(machine, command).await
    }

    /// The present configuration.
    #[must_use]
    pub fn config(&self) -> Arc<Config> {
        Arc::clone(&self.config.borrow())
    }
}
