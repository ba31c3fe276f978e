//! Stopping: in the order of the throws, with a limit for each step.

use std::time::Duration;

use sd_notify::NotifyState;
use tokio::time;

use super::{
    running::{Daemon, JUDGE, PUBLISH, RECEIVE},
    watchdog::notify,
};
use crate::store::StoreError;

/// Receiving the messages that have arrived.
const RECEIVE_LIMIT: Duration = Duration::from_secs(3);
/// Judging pending throws; the rest is judged after the next start.
const JUDGE_LIMIT: Duration = Duration::from_millis(2_500);
/// Leaving the work when the time is up.
const LEAVE_LIMIT: Duration = Duration::from_millis(700);
/// Publishing pending messages; the rest is published after the next start.
const PUBLISH_LIMIT: Duration = Duration::from_secs(1);
/// Closing the session.
const SESSION_LIMIT: Duration = Duration::from_secs(1);
/// Closing the database, which may copy its whole log: a disk that hangs must not keep the process.
const CLOSE_LIMIT: Duration = Duration::from_secs(10);

impl Daemon {
    /// Stops in the order of the throws: receives what has arrived, judges and publishes what it can in a few seconds,
    /// closes the session and the database. Ends within 20 s, whatever hangs.
    ///
    /// # Errors
    /// When the database could not be closed in good order; nothing acknowledged is lost.
    pub async fn stop(self) -> Result<(), StoreError> {
        let Self { session, store, mut tasks, stops, outlet_end, alive, gauges, lock, .. } = self;
        notify(&[NotifyState::Stopping, NotifyState::Status("storing what has arrived")]);
        stops.receive.cancel();
        if !tasks.end_of(RECEIVE, RECEIVE_LIMIT).await {
            tracing::error!("messages that have arrived cannot be stored in time");
            stops.give_up.cancel();
            tasks.end_of(RECEIVE, LEAVE_LIMIT).await;
        }
        stops.judge.cancel();
        if !tasks.end_of(JUDGE, JUDGE_LIMIT).await {
            tracing::warn!("throws are still pending; the next start goes on with them");
            stops.give_up.cancel();
            tasks.end_of(JUDGE, LEAVE_LIMIT).await;
        }
        stops.publish.cancel();
        if !tasks.end_of(PUBLISH, PUBLISH_LIMIT).await {
            tracing::warn!("alarms still wait to be published; the next start goes on with them");
        }
        tracing::info!("{}", gauges.report().line());
        drop((alive, tasks));
        if time::timeout(LEAVE_LIMIT, outlet_end.reached()).await.is_err() {
            tracing::warn!("the publishing thread hangs in zenoh");
        }
        match time::timeout(SESSION_LIMIT, session.close()).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "the zenoh session was not closed in good order"),
            Err(_) => tracing::warn!("the zenoh session takes too long to close"),
        }
        // Committed rows are durable, closed or not: the next start checks the database.
        let closed = time::timeout(CLOSE_LIMIT, store.close()).await.unwrap_or(Err(StoreError::CloseTimeout));
        drop(lock);
        closed
    }
}
