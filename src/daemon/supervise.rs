//! Supervision: no task ends unseen, systemd's watchdog is fed only while every loop beats, and stopping has an order
//! and limits.

use std::time::Duration;

use sd_notify::NotifyState;
use tokio::{
    sync::mpsc,
    task::{AbortHandle, JoinHandle},
    time,
};

use super::{Daemon, heartbeat::Organ, status::Gauges};
use crate::store::StoreError;

/// How often heartbeats are looked at when systemd does not say.
const LOOK: Duration = Duration::from_secs(5);
/// How often the status line is written to the log when all is well.
const ROUTINE: Duration = Duration::from_mins(10);

/// Taking in what has arrived.
const RECEIVE_LIMIT: Duration = Duration::from_secs(3);
/// Judging what waits; the rest is judged after the next start.
const JUDGE_LIMIT: Duration = Duration::from_millis(2_500);
/// Leaving the work when the time is up.
const LEAVE_LIMIT: Duration = Duration::from_millis(700);
/// Publishing what waits; the rest is published after the next start.
const PUBLISH_LIMIT: Duration = Duration::from_secs(1);
/// Closing the session.
const SESSION_LIMIT: Duration = Duration::from_secs(1);
/// Closing the database, which may copy its whole log: a disk that hangs must not keep the process.
const CLOSE_LIMIT: Duration = Duration::from_secs(10);

/// How often systemd is asked for more time while the daemon starts, for how long each time, and how often at most:
/// after an hour something hangs that a restart may mend.
const EXTEND_EVERY: Duration = Duration::from_secs(10);
const EXTEND_BY_USEC: u32 = 60_000_000;
const EXTENSIONS: u32 = 360;

/// A task that ended on its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ended(pub &'static str);

/// The daemon's tasks. Each reports its end, however it ends.
pub(super) struct Tasks {
    ends: mpsc::UnboundedSender<Ended>,
    ended: mpsc::UnboundedReceiver<Ended>,
    aborts: std::sync::Mutex<Vec<AbortHandle>>,
}

/// Reports when it is dropped: at the end of its task, or when that panics.
struct Report(mpsc::UnboundedSender<Ended>, &'static str);

impl Drop for Report {
    fn drop(&mut self) {
        // After the daemon is gone nobody listens.
        let _ = self.0.send(Ended(self.1));
    }
}

impl Tasks {
    pub(super) fn new() -> Self {
        // Unbounded, and yet bounded: one message a task.
        let (ends, ended) = mpsc::unbounded_channel();
        Self { ends, ended, aborts: std::sync::Mutex::default() }
    }

    pub(super) fn spawn<T>(
        &self,
        name: &'static str,
        task: impl Future<Output = T> + Send + 'static,
    ) -> JoinHandle<()> {
        let report = Report(self.ends.clone(), name);
        let handle = tokio::spawn(async move {
            let _report = report;
            task.await;
        });
        if let Ok(mut aborts) = self.aborts.lock() {
            aborts.push(handle.abort_handle());
        }
        handle
    }

    pub(super) async fn ended(&mut self) -> Ended {
        // `self` holds a sender, so this never is `None`.
        self.ended.recv().await.unwrap_or(Ended("a task"))
    }

    fn abort(&self) {
        if let Ok(aborts) = self.aborts.lock() {
            aborts.iter().for_each(AbortHandle::abort);
        }
    }
}

impl Daemon {
    /// Stops in the order of the throws: takes in what has arrived, judges and publishes what it can in a few
    /// seconds, closes the session and the database. Ends within 20 s, whatever hangs.
    ///
    /// # Errors
    /// When the database could not be closed in good order; nothing acknowledged is lost.
    pub async fn stop(self) -> Result<(), StoreError> {
        let Self { session, store, tasks, stops, receive, judge, publish, outlet_end, alive, gauges, lock, .. } = self;
        notify(&[NotifyState::Stopping, NotifyState::Status("storing what has arrived")]);
        stops.receive.cancel();
        let mut receive = receive;
        if time::timeout(RECEIVE_LIMIT, &mut receive).await.is_err() {
            tracing::error!("what has arrived cannot be stored in time");
            stops.give_up.cancel();
            let _ = time::timeout(LEAVE_LIMIT, receive).await;
        }
        stops.judge.cancel();
        let mut judge = judge;
        if time::timeout(JUDGE_LIMIT, &mut judge).await.is_err() {
            tracing::warn!("throws still wait to be judged; the next start goes on with them");
            stops.give_up.cancel();
            let _ = time::timeout(LEAVE_LIMIT, judge).await;
        }
        stops.publish.cancel();
        if time::timeout(PUBLISH_LIMIT, publish).await.is_err() {
            tracing::warn!("alarms still wait to be published; the next start goes on with them");
        }
        tracing::info!("{}", gauges.report().line());
        drop(alive);
        tasks.abort();
        if time::timeout(LEAVE_LIMIT, outlet_end.reached()).await.is_err() {
            tracing::warn!("the publishing thread hangs in zenoh");
        }
        match time::timeout(SESSION_LIMIT, session.close()).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "the zenoh session was not closed in good order"),
            Err(_) => tracing::warn!("the zenoh session takes too long to close"),
        }
        // What is committed is durable, closed or not: the next start checks it.
        let closed = time::timeout(CLOSE_LIMIT, store.close()).await.unwrap_or(Err(StoreError::CloseTimeout));
        drop(lock);
        closed
    }
}

/// Tells systemd that the daemon is ready.
pub(super) fn notify(states: &[NotifyState<'_>]) {
    // Without systemd there is nobody to tell.
    if let Err(error) = sd_notify::notify(states) {
        tracing::debug!(%error, "systemd was not told");
    }
}

/// Asks systemd for more time while something runs that may take minutes: a check of a large database, a migration.
pub(super) async fn patiently<T>(what: &str, work: impl Future<Output = T>) -> T {
    let ask = async {
        let mut pace = time::interval(EXTEND_EVERY);
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

impl Daemon {
    /// Tells systemd that everything works.
    pub fn announce_ready(&self) {
        notify(&[NotifyState::Ready, NotifyState::Status(&self.report().line())]);
    }
}

/// Feeds the watchdog while every loop beats, keeps the status line up to date, and probes the database's writer.
pub(super) async fn watch(gauges: Gauges) {
    let period =
        sd_notify::watchdog_enabled().map_or(LOOK, |limit| (limit / 3).min(LOOK)).max(Duration::from_millis(100));
    let mut look = time::interval(period);
    let mut routine = time::interval(ROUTINE);
    routine.tick().await;
    let mut trouble = String::new();
    let (probe_sender, mut probes) = mpsc::channel::<()>(1);
    let probe = tokio::spawn(probe_writer(gauges.clone(), probe_sender));
    loop {
        tokio::select! {
            _ = look.tick() => {}
            _ = routine.tick() => tracing::info!("{}", gauges.report().line()),
            _ = probes.recv() => {
                probe.abort();
                return;
            }
        }
        let report = gauges.report();
        let line = report.line();
        if report.silent.is_empty() {
            notify(&[NotifyState::Watchdog, NotifyState::Status(&line)]);
        } else {
            notify(&[NotifyState::Status(&line)]);
        }
        let now = format!("{} {:?}", report.disk, report.silent);
        if now != trouble {
            if report.disk != "ok" || !report.silent.is_empty() {
                tracing::error!("{line}");
            } else if !trouble.is_empty() {
                tracing::info!("{line}");
            }
            trouble = now;
        }
    }
}

/// An empty write shows that the writer answers. Any answer will do: a full disk is a status, no hanging.
async fn probe_writer(gauges: Gauges, gone: mpsc::Sender<()>) {
    let mut pace = time::interval(LOOK);
    loop {
        pace.tick().await;
        if matches!(gauges.store.outbox_sent(&[]).await, Err(StoreError::Closed)) {
            let _ = gone.send(()).await;
            return;
        }
        gauges.status.heartbeats.beat(Organ::Write);
    }
}
