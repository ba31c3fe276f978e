//! The part of the whole that every page and the metrics need: read together, at most once a second for all readers.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use tokio::sync::{Mutex, Semaphore, SemaphorePermit};

use crate::{
    daemon::{View, clock},
    diagnose::MachineState,
    store::{CommonAlarm, Fault, FleetQuery, Selector, Statistics, StoreError},
    throw::MachineId,
    wire::Alarm,
};

/// Requests that read the database at the same time: the other connections for questions are left to those on zenoh.
const READING: usize = 1;
/// Oldest overview that a page shows.
const FRESH: Duration = Duration::from_secs(1);
/// Alarms about machines' own condition on the fleet page, the worst ones where there are more: two screens.
pub(super) const FAULTS: u32 = 50;
/// Sites to choose from.
const SITES: u32 = 200;

/// The whole at one moment.
#[derive(Debug)]
pub(super) struct Overview {
    /// Machines in each state that occurs.
    pub(super) tally: Vec<(MachineState, u64)>,
    pub(super) machines: u64,
    /// Open alarms about machines' own condition, the worst first, up to [`FAULTS`].
    pub(super) faults: Vec<Fault>,
    pub(super) fault_count: u64,
    /// Open alarms with a common cause, by cause and site.
    pub(super) common: Vec<CommonAlarm>,
    pub(super) sites: Vec<String>,
    /// The daemon's own open alarms.
    pub(super) own_alarms: Vec<Alarm>,
    /// Open alarms that another version wrote in words unknown here.
    pub(super) unreadable: usize,
    /// Open alarms by cause and severity.
    pub(super) alarms_by_kind: Vec<(String, String, u64)>,
    pub(super) statistics: Statistics,
}

/// The context of every request: the daemon, and what the requests share.
pub(super) struct Web {
    pub(super) view: View,
    /// The last overview. A reader who finds it too old reads a new one while the others wait for that.
    cache: Mutex<Option<(Instant, Arc<Overview>)>>,
    reading: Semaphore,
}

impl Web {
    pub(super) fn new(view: View) -> Self {
        Self { view, cache: Mutex::default(), reading: Semaphore::new(READING) }
    }

    /// The right to read the database, held while reading and drawing.
    pub(super) async fn turn(&self) -> Result<SemaphorePermit<'_>, StoreError> {
        self.reading.acquire().await.map_err(|_| StoreError::Closed)
    }

    pub(super) async fn overview(&self) -> Result<Arc<Overview>, StoreError> {
        let mut last = self.cache.lock().await;
        if let Some((read_at, overview)) = &*last
            && read_at.elapsed() < FRESH
        {
            return Ok(Arc::clone(overview));
        }
        let _turn = self.turn().await?;
        let reader = self.view.reader();
        let itself = self.view.config().monitor.as_machine();
        let tally = reader.tally(&FleetQuery::default(), &itself).await?;
        let (faults, unreadable) = reader.faults(FAULTS, &itself).await?;
        let overview = Arc::new(Overview {
            machines: tally.iter().map(|(_, count)| count).sum(),
            tally,
            faults,
            fault_count: reader.fault_count(&itself).await?,
            common: reader.common_alarms(&itself).await?,
            sites: reader.sites(SITES).await?,
            own_alarms: reader.open_alarms(&selector(&itself)).await?,
            unreadable,
            alarms_by_kind: reader.open_alarms_by_kind().await?,
            statistics: self.view.statistics().await?,
        });
        *last = Some((clock::monotonic(), Arc::clone(&overview)));
        Ok(overview)
    }

    /// Has the next request read the overview anew: a command has just changed it.
    pub(super) async fn forget(&self) {
        *self.cache.lock().await = None;
    }
}

/// One machine alone.
pub(super) fn selector(machine: &MachineId) -> Selector {
    Selector { site: Some(machine.site.clone()), machine: Some(machine.machine.clone()) }
}
