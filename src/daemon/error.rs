//! Errors at the start and the stop of the daemon, and of the pipeline without zenoh ([`super::Offline`]).

use std::path::PathBuf;

use crate::{bus::BusError, store::StoreError, throw::counted};

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
    #[error("another pointsd works on {}: stop it first, or name another database in store.path", database.display())]
    Locked {
        /// The database.
        database: PathBuf,
    },
    /// The lock file of the database cannot be used.
    #[error("cannot use the lock file {} of the database: may this user write to its folder?", path.display())]
    LockFile {
        /// The lock file.
        path: PathBuf,
        /// Error of the system.
        source: std::io::Error,
    },
    /// The webhook cannot be used.
    #[error("[webhook]: {0}")]
    Webhook(String),
}

/// An error at the stop of the daemon.
#[derive(Debug, thiserror::Error)]
pub enum StopError {
    /// The database could not be closed cleanly; nothing acknowledged is lost.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Received messages could not be stored in time; the number of them.
    #[error(
        "{} could not be stored before the stop: LOST, unless the backlog of the logger still has the throw. Check the disk",
        counted(.0, "received message")
    )]
    Lost(u64),
}
