//! Keeps the database within its bounds while the daemon runs.

use std::{path::Path, time::Duration};

use tokio::time::{self, MissedTickBehavior};

use super::clock;
use crate::store::{Housekeeping, Store, StoreError};

/// How often. Between two rounds a full cabinet stores a few megabytes, far less than the ballast.
const PACE: Duration = Duration::from_secs(30);
/// systemd-timesyncd makes this file when the clock was set from a time server. Without it age drops nothing; bytes and
/// rows still do.
const CLOCK_IS_SET: &str = "/run/systemd/timesync/synchronized";

pub(super) async fn run(store: Store) {
    let mut pace = time::interval(PACE);
    pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        pace.tick().await;
        let clock_trusted = Path::new(CLOCK_IS_SET).exists();
        match store.keep_house(clock::now(), clock_trusted).await {
            Ok(Housekeeping { traces: 0, throws: 0, alarms: 0, messages: 0 }) => {}
            Ok(Housekeeping { traces, throws, alarms, messages }) => {
                tracing::info!(
                    traces,
                    throws,
                    alarms,
                    messages,
                    "dropped the oldest to stay within the bounds of [store]"
                );
            }
            Err(StoreError::Closed) => return,
            Err(error) => tracing::warn!(%error, "the database cannot be kept within its bounds now"),
        }
    }
}
