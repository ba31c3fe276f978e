//! The interface of the daemon for the dashboard: status, reader of the database, configuration, operators' commands.

use std::sync::Arc;

use tokio::sync::watch;

use super::{config::Config, orders::Orders, status::Gauges};

/// A view of a running daemon. Cheap to clone.
#[derive(Clone)]
pub struct View {
    pub(crate) gauges: Gauges,
    pub(super) config: watch::Receiver<Arc<Config>>,
    pub(crate) orders: Orders,
}

impl View {
    /// The present configuration.
    #[must_use]
    pub fn config(&self) -> Arc<Config> {
        Arc::clone(&self.config.borrow())
    }
}
