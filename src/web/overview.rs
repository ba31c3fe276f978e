//! What every page and the metrics show of the whole: read together, at most once a second, whoever asks.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use tokio::sync::Mutex;

use super::Web;
use crate::{
    daemon::clock,
    store::{AlarmRow, HealthRow, Selector, Statistics, StoreError},
    throw::MachineId,
    wire::Alarm,
};

/// How old it may be.
const FRESH: Duration = Duration::from_secs(1);
/// Machines on the fleet's page, the worst ones where there are more.
pub(super) const MACHINES: u32 = 200;

/// The whole at one moment.
#[derive(Debug)]
pub(super) struct Overview {
    /// The latest throw of each direction of the machines shown, in their order.
    pub(super) health: Vec<HealthRow>,
    pub(super) machines: u64,
    /// Every open alarm of the machines shown, the worst first.
    pub(super) alarms: Vec<Alarm>,
    /// The daemon's own open alarms, also where there are more machines than are shown.
    pub(super) own_alarms: Vec<Alarm>,
    /// Those that another version wrote in words unknown here.
    pub(super) unreadable: usize,
    /// Open alarms by cause and severity.
    pub(super) alarms_by_kind: Vec<(String, String, u64)>,
    pub(super) statistics: Statistics,
}

/// The last overview. Who finds it old reads it anew while the others wait for that.
#[derive(Debug, Default)]
pub(super) struct Cache(Mutex<Option<(Instant, Arc<Overview>)>>);

impl Web {
    pub(super) async fn overview(&self) -> Result<Arc<Overview>, StoreError> {
        let mut last = self.cache.0.lock().await;
        if let Some((read_at, overview)) = &*last
            && read_at.elapsed() < FRESH
        {
            return Ok(Arc::clone(overview));
        }
        let _turn = self.turn().await?;
        let reader = self.view.reader();
        let alarms = reader.fleet_alarms(MACHINES).await?;
        let found = alarms.len();
        let alarms = readable(&alarms);
        let MachineId { site, machine } = self.view.config().monitor.as_machine();
        let itself = Selector { site: Some(site), machine: Some(machine) };
        let overview = Arc::new(Overview {
            health: reader.fleet_health(MACHINES).await?,
            machines: reader.machine_count().await?,
            unreadable: found - alarms.len(),
            alarms,
            own_alarms: readable(&reader.open_alarms(&itself).await?),
            alarms_by_kind: reader.open_alarms_by_kind().await?,
            statistics: self.view.statistics().await?,
        });
        *last = Some((clock::monotonic(), Arc::clone(&overview)));
        Ok(overview)
    }
}

/// Those alarms whose words are known.
pub(super) fn readable(rows: &[AlarmRow]) -> Vec<Alarm> {
    rows.iter().filter_map(|row| serde_json::from_str(&row.payload).ok()).collect()
}
