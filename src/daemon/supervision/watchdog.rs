//! Notifications to systemd: the watchdog, fed only while all heartbeats are fresh, and the status line.

use std::{sync::Arc, time::Duration};

use sd_notify::NotifyState;

use super::heartbeat::TaskName;
use crate::{
    daemon::{clock, shared::Shared},
    store::{DiskLevel, StoreError},
};

/// Longest time between two checks of the heartbeats; a third of the watchdog limit of systemd, if that is shorter.
/// Also the time between two probes of the writer.
const CHECK_EVERY: Duration = Duration::from_secs(5);
/// Number of checks from one probe that changes a row to the next, unless the last write failed: a minute. Each such
/// probe is a commit, which wears a flash disk.
const PROBE_EVERY: u32 = 12;
/// Time between two routine status lines in the log.
const STATUS_EVERY: Duration = Duration::from_mins(10);

/// Time between two extensions of the start timeout of systemd.
const EXTEND_EVERY: Duration = Duration::from_secs(10);
/// Time of each extension \[µs\].
const EXTEND_BY_USEC: u32 = 60_000_000;
/// Largest number of extensions, one hour in total. A longer start counts as hanging: systemd then ends the daemon, and
/// a restart may help.
const EXTENSIONS: u32 = 360;

/// Sends states to systemd.
pub(crate) fn notify(states: &[NotifyState<'_>]) {
    // Without systemd this fails or does nothing.
    if let Err(error) = sd_notify::notify(states) {
        tracing::debug!(%error, "notifying systemd failed");
    }
}

/// Extends the start timeout of systemd during work that may take minutes: a check of a large database, a migration.
pub(crate) async fn with_start_extension<T>(what: &str, work: impl Future<Output = T>) -> T {
    let ask = async {
        let mut pace = clock::every(EXTEND_EVERY);
        for _ in 0..EXTENSIONS {
            pace.tick().await;
            notify(&[NotifyState::ExtendTimeoutUsec(EXTEND_BY_USEC), NotifyState::Status(what)]);
        }
        std::future::pending().await
    };
    tokio::select! {
        done = work => done,
        never = ask => never,
    }
}

/// Feeds the watchdog while all heartbeats are fresh, updates the status line, and probes the writer of the database.
pub(crate) async fn watch(shared: Arc<Shared>) {
    let Shared { status, store, .. } = &*shared;
    let period = sd_notify::watchdog_enabled()
        .map_or(CHECK_EVERY, |limit| (limit / 3).min(CHECK_EVERY))
        .max(Duration::from_millis(100));
    let mut check = clock::every(period);
    let mut routine = clock::every(STATUS_EVERY);
    routine.tick().await;
    // Level of the disk, and silent tasks.
    let mut before = None;
    let mut probe = std::pin::pin!(probe_writer(&shared));
    loop {
        tokio::select! {
            _ = check.tick() => {}
            _ = routine.tick() => tracing::info!("{}", status.report(store).line()),
            () = &mut probe => return,
        }
        let report = status.report(store);
        let line = report.line();
        if report.silent.is_empty() {
            notify(&[NotifyState::Watchdog, NotifyState::Status(&line)]);
        } else {
            notify(&[NotifyState::Status(&line)]);
        }
        let is_trouble = report.disk != DiskLevel::Ample || !report.silent.is_empty();
        let now = Some((report.disk, report.silent));
        if now != before {
            if is_trouble {
                tracing::error!("{line}");
            } else if before.is_some() {
                tracing::info!("{line}");
            }
            before = now;
        }
    }
}

/// Probes the writer with a transaction, which stores the numbers of dropped and lost messages. An error counts as an
/// answer: a full disk is a status, not a hang.
async fn probe_writer(Shared { status, store, .. }: &Shared) {
    let mut pace = clock::every(CHECK_EVERY);
    for number in (0..PROBE_EVERY).cycle() {
        pace.tick().await;
        // A transaction without a change succeeds on a full or failing disk too, so it must not end such a state.
        let failed = matches!(store.disk_level(), DiskLevel::Full | DiskLevel::Failing);
        if matches!(status.store_losses(store, failed || number == 0).await, Err(StoreError::Closed)) {
            return;
        }
        status.heartbeats.beat(TaskName::Write);
    }
}
