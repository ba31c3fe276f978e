//! The pipeline without zenoh: recorded throws go through spool, identification and diagnosis into the database.

use std::{
    collections::{HashSet, VecDeque},
    sync::Arc,
};

use tokio::sync::{Notify, broadcast, watch};
use tokio_util::sync::CancellationToken;

use super::{Fleet, Judged, Pool, StartError, Status, clock, config::Config, judge::Judge, lock::DatabaseLock};
use crate::{
    store::{Spooled, Store, StoreError},
    throw::{MachineId, Throw},
};

/// Throws that are judged together; watchers never lag behind a group.
const GROUP: usize = 64;

/// The pipeline of one database, without a daemon.
pub struct Offline {
    store: Store,
    judge: Judge,
    judged: broadcast::Receiver<Judged>,
    waiting: usize,
    _lock: DatabaseLock,
}

impl Offline {
    /// Opens the database of a configuration.
    ///
    /// # Errors
    /// When it cannot be used, or a daemon works on it.
    pub async fn open(config: Config) -> Result<Self, StartError> {
        let lock = DatabaseLock::take(&config.store.path)?;
        let store = Store::open(&config.store, clock::now()).await?.store;
        let fleet = Fleet::restore(store.reader().monitors().await?);
        let (watchers, judged) = broadcast::channel(16 * GROUP);
        let pool = Pool::new(config.identify.threads);
        let itself = config.monitor.as_machine();
        // The sender may go: the receiver keeps the last value.
        let (_, config) = watch::channel(Arc::new(config));
        let judge = Judge {
            store: store.clone(),
            fleet,
            pool,
            config,
            status: Arc::new(Status::new()),
            outlet: None,
            spooled: Arc::new(Notify::new()),
            outbox: Arc::new(Notify::new()),
            watchers,
            give_up: CancellationToken::new(),
            loggers: watch::channel(HashSet::new()).1,
            itself,
            own: VecDeque::new(),
            ticks: 0,
        };
        Ok(Self { store, judge, judged, waiting: 0, _lock: lock })
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
        self.judge.drain().await?;
        let mut all = Vec::new();
        while let Ok(judged) = self.judged.try_recv() {
            all.push(judged);
        }
        Ok(all)
    }

    /// Closes the database.
    ///
    /// # Errors
    /// When it could not be closed in good order; nothing is lost.
    pub async fn close(self) -> Result<(), StoreError> {
        self.store.close().await
    }
}
