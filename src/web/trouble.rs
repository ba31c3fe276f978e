//! The banner on every page: problems that make the page incomplete or old.

use std::time::Duration;

use tokio::time;

use super::{
    overview::{Overview, Web},
    page,
};
use crate::{daemon::View, store::DiskLevel, throw::counted};

/// Number of pending throws above which pages show a warning: half a minute of work.
const PENDING: u64 = 1_000;

/// Time limit to read the problems in the database. After it the page is shown without them.
const LIMIT: Duration = Duration::from_secs(2);

impl Web {
    /// All problems, for a page that needs nothing else from the overview. Takes a permit to read while it runs.
    pub(super) async fn trouble(&self) -> Vec<String> {
        if let Ok(Ok(overview)) = time::timeout(LIMIT, self.overview()).await {
            return all(&self.view, &overview);
        }
        let mut trouble = of_daemon(&self.view);
        trouble.push("The database does not answer: there may be more problems.".to_owned());
        trouble
    }
}

/// All problems, for a page that has read the overview.
pub(super) fn all(view: &View, overview: &Overview) -> Vec<String> {
    [of_daemon(view), of_data(overview)].concat()
}

/// Problems known without the database.
pub(super) fn of_daemon(view: &View) -> Vec<String> {
    let report = view.report();
    let mut trouble = report.problems();
    let can_store = matches!(report.disk, DiskLevel::Ample | DiskLevel::Low) && !report.copying;
    if !can_store || !report.silent.is_empty() {
        trouble.push("New throws wait: this page may be old.".to_owned());
    }
    if report.loggers == 0 {
        trouble.push("No logger has a liveliness token: none is connected, or those that are declare none. Silence is not health.".to_owned());
    }
    trouble
}

/// Problems known from the database.
fn of_data(overview: &Overview) -> Vec<String> {
    // Not the shelved and cleared alarms, which are in the list of alarms.
    let own = overview.own_alarms.iter().filter(|alarm| alarm.state.is_active());
    let mut trouble: Vec<String> = own.map(|alarm| format!("Alarm of the daemon itself: {}", alarm.text)).collect();
    let unknown = overview.faults.unreadable;
    if unknown > 0 {
        trouble.push(format!(
            "{} of another version cannot be read by this version: pointsd sql shows all.",
            counted(unknown, "open alarm")
        ));
    }
    if overview.statistics.pending > PENDING {
        let waiting = page::count(overview.statistics.pending);
        trouble.push(format!("{waiting} throws are pending (stored, not judged yet): this page is old."));
    }
    trouble
}
