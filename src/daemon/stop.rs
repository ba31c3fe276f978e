//! The stop of the daemon, in the order of the pipeline and with a time limit for each step.

use std::time::Duration;

use sd_notify::NotifyState;
use tokio::time;

use super::{
    error::StopError,
    shared::Shared,
    start::{Daemon, JUDGE, PUBLISH, RECEIVE},
    supervision::watchdog::notify,
};
use crate::store::StoreError;

/// Time limit to store the received messages.
const RECEIVE_LIMIT: Duration = Duration::from_secs(3);
/// Time limit to judge pending throws; the rest is judged after the next start.
const JUDGE_LIMIT: Duration = Duration::from_millis(2_500);
/// Time limit for a loop to end after `give_up`, and for the publishing threads.
const LEAVE_LIMIT: Duration = Duration::from_millis(700);
/// Time limit to publish the outbox; the rest is published after the next start.
const PUBLISH_LIMIT: Duration = Duration::from_secs(1);
/// Time limit to close the session.
const SESSION_LIMIT: Duration = Duration::from_secs(1);
/// Time limit to close the database. The close may copy the whole write-ahead log, or hang with the disk.
const CLOSE_LIMIT: Duration = Duration::from_secs(10);

impl Daemon {
    /// Stops the daemon: stores the received messages, judges and publishes for a few seconds, then closes the session
    /// and the database. Returns within 20 s in any case.
    ///
    /// # Errors
    /// When received messages could not be stored, or the database could not be closed cleanly.
    pub async fn stop(self) -> Result<(), StopError> {
        let Self { shared, mut tasks, publishing, alive, lock, .. } = self;
        let Shared { session, store, status, stops, .. } = &*shared;
        notify(&[NotifyState::Stopping, NotifyState::Status("storing received messages")]);
        let lost_before = status.edit().lost;
        stops.receive.cancel();
        if !tasks.end_of(RECEIVE, RECEIVE_LIMIT).await {
            tracing::error!("received messages could not be stored in time");
            stops.give_up.cancel();
            tasks.end_of(RECEIVE, LEAVE_LIMIT).await;
        }
        stops.judge.cancel();
        if !tasks.end_of(JUDGE, JUDGE_LIMIT).await {
            tracing::warn!("throws are still pending: they will be judged after the next start");
            stops.give_up.cancel();
            tasks.end_of(JUDGE, LEAVE_LIMIT).await;
        }
        stops.publish.cancel();
        if !tasks.end_of(PUBLISH, PUBLISH_LIMIT).await {
            tracing::warn!("alarms are not published yet: they will be published after the next start");
        }
        tracing::info!("{}", status.report(store).line());
        drop((alive, tasks));
        let ended = async {
            for end in publishing {
                // An error means a panic, which is in the log already.
                let _ = end.await;
            }
        };
        if time::timeout(LEAVE_LIMIT, ended).await.is_err() {
            tracing::warn!("the publishing thread hangs in zenoh");
        }
        match time::timeout(SESSION_LIMIT, session.close()).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "closing the zenoh session failed"),
            Err(_) => tracing::warn!("closing the zenoh session takes too long"),
        }
        // Committed rows are durable without a clean close too; the next start then checks the database.
        let close = async {
            if let Err(error) = status.store_losses(store, false).await {
                tracing::warn!(%error, "counting the messages lost at the stop failed");
            }
            store.close().await
        };
        let closed = time::timeout(CLOSE_LIMIT, close).await.unwrap_or(Err(StoreError::CloseTimeout));
        drop(lock);
        closed?;
        match status.edit().lost - lost_before {
            0 => Ok(()),
            lost => Err(StopError::Lost(lost)),
        }
    }
}
