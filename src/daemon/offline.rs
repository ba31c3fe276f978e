//! The pipeline without zenoh: recorded throws go through spool, identification and diagnosis into the database.

use std::sync::Arc;

use tokio::sync::watch;

use super::{
    clock,
    config::Config,
    judge::{Judge, Judged},
    lock::{DatabaseLock, LockError},
};
use crate::{
    bus::BusError,
    store::{Spooled, Store, StoreError},
    throw::{MachineId, Throw},
};

/// Why the daemon cannot start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The database cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Zenoh cannot be used.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The database is not ours.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// The system gives no thread.
    #[error("the system gives no thread to publish from: {0}")]
    Thread(#[from] std::io::Error),
}

/// Throws that are stored before they are judged: a few commits for many throws.
const GROUP: usize = 64;

/// The pipeline of one database, without a daemon.
pub struct Offline {
    store: Store,
    judge: Judge,
    waiting: usize,
    _lock: DatabaseLock,
}

impl Offline {
    /// Opens the database of a configuration.
    ///
    /// # Errors
    /// When it cannot be used, or a daemon works on it.
    pub async fn open(mut config: Config) -> Result<Self, StartError> {
        let lock = DatabaseLock::take(&config.store.path)?;
        let store = Store::open(&config.store, clock::now()).await?.store;
        // No logger is there to be waited for.
        config.subscribe.backlog_wait_s = 0.0;
        // The sender may go: the receiver keeps the last value.
        let (_, config) = watch::channel(Arc::new(config));
        let judge = Judge::restore(store.clone(), config).await?;
        Ok(Self { store, judge, waiting: 0, _lock: lock })
    }

    /// Takes a throw in; judges from time to time. Returns what was judged meanwhile, and what became of the throw.
    ///
    /// # Errors
    /// When the database cannot be written to.
    pub async fn take(&mut self, machine: &MachineId, throw: &Throw) -> Result<(Spooled, Vec<Judged>), StoreError> {
        let spooled = self.store.spool(machine, throw, clock::now()).await?;
        self.waiting += 1;
        let judged = if self.waiting >= GROUP { self.judge().await? } else { Vec::new() };
        Ok((spooled, judged))
    }

    /// Judges everything that waits.
    ///
    /// # Errors
    /// When the database cannot be written to.
    pub async fn judge(&mut self) -> Result<Vec<Judged>, StoreError> {
        self.waiting = 0;
        let mut all = Vec::new();
        loop {
            let judgements = self.judge.next().await?;
            if judgements.is_empty() {
                return Ok(all);
            }
            self.judge.commit(&judgements).await?;
            all.extend(judgements.iter().map(Judged::from));
        }
    }

    /// Closes the database.
    ///
    /// # Errors
    /// When it could not be closed in good order; nothing is lost.
    pub async fn close(self) -> Result<(), StoreError> {
        self.store.close().await
    }
}
