//! The daemon as other rooms of the same process see it: its status, its database for reading, its limits, and operators'
//! commands.

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

    /// Has an operator's command carried out and committed.
    ///
    /// # Errors
    /// A sentence, when the daemon does not answer in time.
    pub async fn carry_out(&self, machine: MachineId, command: Command) -> Result<Reply, String> {
        self.orders.carry_out(machine, command).await
    }

    /// The configuration in force.
    #[must_use]
    pub fn config(&self) -> Arc<Config> {
        Arc::clone(&self.config.borrow())
    }
}
