//! Errors at the start of the daemon, and of the pipeline without zenoh ([`super::Offline`]).

use super::supervision::lock::LockError;
use crate::{bus::BusError, store::StoreError};

/// An error at the start of the daemon.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The database cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Zenoh cannot be used.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Another process uses the database.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// The webhook cannot be used.
    #[error("[webhook]: {0}")]
    Webhook(String),
}
