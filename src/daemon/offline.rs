//! The pipeline without zenoh, for recorded throws.

use std::sync::Arc;

use jiff::Timestamp;
use tokio::sync::watch;

use super::{
    clock,
    config::Config,
    error::StartError,
    judge::{Batch, Judge},
    supervision::lock::DatabaseLock,
};
use crate::{
    store::{Judgement, Spooled, Store, StoreError},
    throw::{MachineId, Throw, ThrowRef},
};

/// Number of throws that are judged together, to save commits.
const GROUP: usize = 64;

/// The pipeline on a database without a daemon. Its methods fail when the database cannot be read or written.
pub struct Offline {
    store: Store,
    judge: Judge,
    waiting: usize,
    _lock: DatabaseLock,
}

#[expect(clippy::missing_errors_doc, reason = "the documentation of `Offline` says when its methods fail")]
impl Offline {
    /// Opens the database of a configuration, which no daemon may use.
    pub async fn open(mut config: Config) -> Result<Self, StartError> {
        let lock = DatabaseLock::take(&config.store.path)?;
        let store = Store::open(&config.store, clock::now()).await?.store;
        // No logger has a backlog for which the judge could wait.
        config.subscribe.backlog_wait_s = 0.0;
        // The receiver keeps the value after the sender is dropped.
        let (_, config) = watch::channel(Arc::new(config));
        let judge = Judge::restore(store.clone(), config).await?;
        Ok(Self { store, judge, waiting: 0, _lock: lock })
    }

    /// Stores a throw that was received at this time. After every 64 throws it judges them. Returns the result of
    /// storing the throw, and the throws judged in this call.
    pub async fn take(
        &mut self,
        machine: &MachineId,
        throw: &Throw,
        received_at: Timestamp,
    ) -> Result<(Spooled, Vec<Arc<[Judgement]>>), StoreError> {
        let spooled = self.store.spool(machine, throw, received_at).await?;
        self.waiting += 1;
        let judged = if self.waiting >= GROUP { self.judge().await? } else { Vec::new() };
        Ok((spooled, judged))
    }

    /// Whether the database has a throw with this number of a machine.
    pub async fn has(&self, machine: &MachineId, throw: &ThrowRef) -> Result<bool, StoreError> {
        Ok(self.store.reader().throw_of(machine, throw).await?.is_some())
    }

    /// Start of the last throw of a machine that was judged.
    pub async fn last_start(&self, machine: &MachineId) -> Result<Option<Timestamp>, StoreError> {
        let latest = self.store.reader().latest_health(&machine.into()).await?;
        Ok(latest.iter().map(|health| health.started_at).max())
    }

    /// Judges all pending throws.
    pub async fn judge(&mut self) -> Result<Vec<Arc<[Judgement]>>, StoreError> {
        self.waiting = 0;
        let mut all = Vec::new();
        loop {
            let Batch { throws, .. } = self.judge.pending().await?;
            if throws.is_empty() {
                return Ok(all);
            }
            let judgements = self.judge.judge(&throws).await;
            self.store.judge_all(Arc::clone(&judgements)).await?;
            all.push(judgements);
        }
    }

    /// Closes the database. An error means that it could not be closed cleanly; no data is lost.
    pub async fn close(self) -> Result<(), StoreError> {
        self.store.close().await
    }
}
