//! The judge: identifies pending throws, diagnoses them in order, and commits the judgements.

mod answer;
pub(super) mod budget;
pub(super) mod commands;
mod daemon_alarms;
pub(super) mod health;
pub(super) mod identify;
pub(super) mod judge_loop;
pub(super) mod logger_clocks;
pub(super) mod monitors;

use std::{collections::HashMap, sync::Arc, time::Duration};

use tokio::sync::watch;

use self::monitors::{JudgementContext, Monitors};
use super::{clock, config::Config};
use crate::{
    diagnose::Parameters,
    store::{Judgement, Outcome, Selector, Store, StoreError, StoredThrow, ThrowRow},
    throw::MachineId,
};

/// Largest number of throws that are identified and committed together. The store returns fewer if their traces are
/// long. A commit waits for the commits of received throws: with smaller batches the judge fell behind at 1,500
/// throws/s.
const BATCH: u32 = 256;
/// Number of monitors read in one query at the start; each has up to 20 kB of text.
const PAGE: u32 = 256;

/// The judge with database, monitors, estimators and settings.
pub(super) struct Judge {
    pub(super) store: Store,
    pub(super) monitors: Monitors,
    /// Number of threads for the estimator.
    threads: usize,
    pub(super) config: watch::Receiver<Arc<Config>>,
    /// The machine of the last throw in the last batch, if that batch was full. The next batch begins with the other
    /// machines.
    last: Option<MachineId>,
}

/// Throws to judge together.
pub(super) struct Batch {
    /// Empty if no throw is pending.
    pub(super) throws: Vec<StoredThrow>,
    /// Whether further throws may be pending.
    pub(super) may_be_followed: bool,
}

impl Judge {
    /// Restores the judge from the database.
    pub(super) async fn restore(store: Store, config: watch::Receiver<Arc<Config>>) -> Result<Self, StoreError> {
        // Page by page, as the text of a snapshot needs more memory than its monitor.
        let (mut monitors, mut last) = (Monitors::default(), None);
        loop {
            let page = store.reader().monitors(last.as_ref(), PAGE).await?;
            let Some(end) = page.last() else { break };
            last = Some(end.machine.clone());
            monitors.restore(page, |machine| config.borrow().monitor.reserves(machine).is_some());
        }
        let threads = identify::threads(config.borrow().identify.threads);
        Ok(Self { store, monitors, threads, config, last: None })
    }

    /// Adopts the open alarms that no monitor has, and retires former names of the daemon; returns the outcomes to store.
    pub(super) async fn adopt(&mut self, own_machine: &MachineId) -> Result<Vec<Outcome>, StoreError> {
        let reader = self.store.reader();
        let mut former = Vec::new();
        for machine in self.monitors.without_logger(own_machine) {
            // Otherwise the monitor of a machine was lost, and has no throw yet.
            if reader.latest_health(&(&machine).into()).await?.is_empty() {
                former.push(machine);
            }
        }
        let open = reader.open_alarms(&Selector::default()).await?;
        Ok(self.monitors.adopt(open, &former, own_machine, clock::now(), &self.config().diagnosis))
    }

    /// The present configuration.
    pub(super) fn config(&self) -> Arc<Config> {
        Arc::clone(&self.config.borrow())
    }

    /// The next batch to judge.
    pub(super) async fn pending(&mut self) -> Result<Batch, StoreError> {
        let wait = self.backlog_wait();
        let (throws, is_full) = self.store.reader().to_judge(self.last.as_ref(), BATCH, clock::now(), wait).await?;
        let may_be_followed = is_full || self.last.is_some();
        self.last = throws.last().filter(|_| is_full).map(|stored| stored.machine.clone());
        Ok(Batch { throws, may_be_followed })
    }

    /// Judges a batch. The monitors include these throws afterwards, so the result must be committed before the next
    /// call.
    pub(super) async fn judge(&mut self, throws: &[StoredThrow]) -> Arc<[Judgement]> {
        let config = self.config();
        let readable = throws.iter().filter_map(|stored| {
            Some((stored.throw.as_ref().ok()?.clone(), config.machines.of(&stored.machine).clone()))
        });
        let mut found = identify::identify(self.threads, readable.collect()).await.into_iter();
        // One transaction stores the batch, so the monitor after the last throw of each machine is enough.
        let last: HashMap<&MachineId, ThrowRow> = throws.iter().map(|stored| (&stored.machine, stored.row)).collect();
        let judgements = throws.iter().map(|stored| {
            let identification = if stored.throw.is_ok() { found.next().flatten() } else { None };
            let context = JudgementContext {
                is_last: last.get(&stored.machine) == Some(&stored.row),
                settings: &config.diagnosis,
                parameters: Parameters::of(config.machines.of(&stored.machine)),
                at: clock::now(),
            };
            self.monitors.judge(stored, identification, context)
        });
        judgements.collect()
    }

    /// Time that the throws after a gap wait for the missing throws.
    pub(super) fn backlog_wait(&self) -> Duration {
        Duration::from_secs_f64(self.config.borrow().subscribe.backlog_wait_s)
    }
}
