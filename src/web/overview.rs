//! The data that every page and the metrics need. They are read together, at most once a second.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use tokio::sync::{Mutex, OwnedSemaphorePermit, Semaphore, SemaphorePermit};

use crate::{
    daemon::{View, clock},
    store::{AlarmCount, CommonAlarm, Faults, FleetQuery, Reader, StateCounts, Statistics, StoreError},
    wire::Alarm,
};

/// Number of requests that may read the database at the same time. The other read connections are for queries over
/// zenoh.
const READING: usize = 1;
/// Number of large responses that may be in memory at the same time: traces of up to 16 MB.
const LARGE: usize = 4;
/// Largest age of the overview on a page.
const FRESH: Duration = Duration::from_secs(1);
/// Largest number of fault alarms on the fleet page: two screens.
pub(super) const FAULTS: u32 = 50;
/// Largest number of sites offered in the filter.
const SITES: u32 = 200;

/// State of the fleet and of the daemon at one moment.
#[derive(Debug)]
pub(super) struct Overview {
    /// Number of machines in each state; states without machines are left out.
    pub(super) tally: StateCounts,
    /// Open alarms about the condition of machines, up to [`FAULTS`].
    pub(super) faults: Faults,
    /// Numbers of open alarms about machines not monitored and lost data, by cause and site.
    pub(super) common: Vec<CommonAlarm>,
    pub(super) sites: Vec<String>,
    /// Open alarms about the daemon itself.
    pub(super) own_alarms: Vec<Alarm>,
    pub(super) alarms_by_kind: Vec<AlarmCount>,
    pub(super) statistics: Statistics,
}

/// The state that all requests share.
pub(super) struct Web {
    pub(super) view: View,
    /// The last overview, and when it was read. The first request that finds it too old reads a new one; other requests
    /// wait for that.
    cache: Mutex<Option<(Instant, Arc<Overview>)>>,
    reading: Semaphore,
    large: Arc<Semaphore>,
}

impl Web {
    pub(super) fn new(view: View) -> Self {
        Self { view, cache: Mutex::default(), reading: Semaphore::new(READING), large: Arc::new(Semaphore::new(LARGE)) }
    }

    pub(super) fn reader(&self) -> &Reader {
        self.view.store.reader()
    }

    /// Waits for the permit to read the database. The request holds it until its page is complete.
    pub(super) async fn read_permit(&self) -> Result<SemaphorePermit<'_>, StoreError> {
        self.reading.acquire().await.map_err(|_| StoreError::Closed)
    }

    /// A permit to keep a large response in memory; `None` if there are enough already.
    pub(super) fn large_permit(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.large).try_acquire_owned().ok()
    }

    /// The overview, at most [`FRESH`] old. Takes a permit to read while it runs, so the caller must not hold one.
    pub(super) async fn overview(&self) -> Result<Arc<Overview>, StoreError> {
        let mut last = self.cache.lock().await;
        if let Some((read_at, overview)) = &*last
            && read_at.elapsed() < FRESH
        {
            return Ok(Arc::clone(overview));
        }
        let _permit = self.read_permit().await?;
        let reader = self.reader();
        let itself = self.view.config().monitor.as_machine();
        let tally = reader.tally(&FleetQuery::default(), &itself).await?;
        let overview = Arc::new(Overview {
            tally,
            faults: reader.faults(FAULTS, &itself).await?,
            common: reader.common_alarms(&itself).await?,
            sites: reader.sites(SITES).await?,
            own_alarms: reader.open_alarms(&(&itself).into()).await?,
            alarms_by_kind: reader.open_alarms_by_kind().await?,
            statistics: self.view.store.statistics().await?,
        });
        *last = Some((clock::monotonic(), Arc::clone(&overview)));
        Ok(overview)
    }

    /// Discards the overview, after a command has changed the state of the fleet.
    pub(super) async fn discard_overview(&self) {
        *self.cache.lock().await = None;
    }
}
