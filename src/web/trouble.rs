//! The banner on every page: trouble that keeps the page from telling the truth about the machines.

use std::time::Duration;

use tokio::time;

use super::{
    overview::{Overview, Web},
    page,
};
use crate::{daemon::View, diagnose::AlarmState};

/// Pending throws from which the pages say that they are behind: half a minute's work.
const BACKLOG: u64 = 1_000;

/// Longest wait for the trouble that the database knows: a page is shown without it rather than not at all.
const LIMIT: Duration = Duration::from_secs(2);

impl Web {
    /// All known trouble, for a page that needs nothing else of the overview. Takes a turn of its own.
    pub(super) async fn trouble(&self) -> Vec<String> {
        if let Ok(Ok(overview)) = time::timeout(LIMIT, self.overview()).await {
            return all(&self.view, &overview);
        }
        let mut trouble = of_daemon(&self.view);
        trouble.push("The database answers late or not at all: there may be more trouble than this.".to_owned());
        trouble
    }
}

/// All known trouble.
pub(super) fn all(view: &View, overview: &Overview) -> Vec<String> {
    let mut trouble = of_daemon(view);
    trouble.extend(of_data(overview));
    trouble
}

/// The trouble that the daemon knows without its database.
pub(super) fn of_daemon(view: &View) -> Vec<String> {
    let report = view.report();
    let mut trouble = Vec::new();
    match report.disk.as_str() {
        "ok" => {}
        "low" => trouble
            .push("The disk is nearly full: the traces of judged throws are dropped. Free some space.".to_owned()),
        "full" => trouble.push(
            "The disk is full: nothing can be stored, and what you see is from before. Free some space now.".to_owned(),
        ),
        _ => trouble
            .push("Writing to the database fails: nothing can be stored, and what you see is from before.".to_owned()),
    }
    if !report.silent.is_empty() {
        trouble.push(format!("Parts of the daemon hang ({}): what you see may be old.", report.silent.join(", ")));
    }
    if report.loggers == 0 {
        trouble.push("No logger is connected: no throws arrive. Silence is not health.".to_owned());
    }
    if report.dropped + report.lost > 0 {
        let lost = page::count(report.dropped + report.lost);
        trouble.push(format!("{lost} messages that arrived since the start could not be kept."));
    }
    trouble
}

/// The trouble that the database knows.
fn of_data(overview: &Overview) -> Vec<String> {
    // Alarms that are shelved or over stand in the list of alarms alone.
    let is_active = |state| matches!(state, AlarmState::ActiveUnacknowledged | AlarmState::ActiveAcknowledged);
    let own = overview.own_alarms.iter().filter(|alarm| is_active(alarm.state));
    let mut trouble: Vec<String> = own.map(|alarm| format!("The daemon's own alarm: {}", alarm.text)).collect();
    if overview.unreadable > 0 {
        let unknown = overview.unreadable;
        trouble.push(format!(
            "{unknown} open alarms were raised by another version in words unknown here: pointsd sql shows them."
        ));
    }
    if overview.statistics.pending > BACKLOG {
        let waiting = page::count(overview.statistics.pending);
        trouble.push(format!("{waiting} throws are pending, stored and not judged yet: the page is behind."));
    }
    trouble
}
