//! Keeps the database within its bounds while the daemon runs.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use jiff::{SignedDuration, Timestamp};
use tokio::time::{self, MissedTickBehavior};

use super::clock;
use crate::store::{Housekeeping, Store, StoreError};

/// How often. Between two rounds a full cabinet stores a megabyte, far less than the ballast.
const PACE: Duration = Duration::from_secs(10);
/// systemd-timesyncd makes this file when the clock was set from a time server. Without it age drops nothing; bytes and
/// rows still do.
const CLOCK_IS_SET: &str = "/run/systemd/timesync/synchronized";
/// The wall clock must have kept in step with the monotonic one for so long, or age drops nothing either: a clock that
/// jumps ten years ahead must not take all traces with it.
const STEADY: Duration = Duration::from_hours(24);
/// More than this between two rounds is a jump; a time server moves a running clock by milliseconds.
const JUMP: SignedDuration = SignedDuration::from_secs(1);

pub(super) async fn run(store: Store) {
    let mut pace = time::interval(PACE);
    pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut clocks = Clocks::new(clock::now(), clock::monotonic());
    loop {
        pace.tick().await;
        let now = clock::now();
        let clock_trusted = clocks.are_steady(now, clock::monotonic()) && Path::new(CLOCK_IS_SET).exists();
        match store.keep_house(now, clock_trusted).await {
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

/// Wall and monotonic time side by side.
struct Clocks {
    wall: Timestamp,
    monotonic: Instant,
    /// Since when they have kept in step.
    since: Instant,
}

impl Clocks {
    fn new(wall: Timestamp, monotonic: Instant) -> Self {
        Self { wall, monotonic, since: monotonic }
    }

    /// Whether they have kept in step for long enough, up to now.
    fn are_steady(&mut self, wall: Timestamp, monotonic: Instant) -> bool {
        let passed = SignedDuration::try_from(monotonic.duration_since(self.monotonic)).unwrap_or(SignedDuration::MAX);
        if wall.duration_since(self.wall).saturating_sub(passed).abs() > JUMP {
            self.since = monotonic;
        }
        (self.wall, self.monotonic) = (wall, monotonic);
        monotonic.duration_since(self.since) >= STEADY
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A day in rounds, and what is said of the clocks after each: `wall(round)` is where the wall clock stands.
    fn a_day(wall: impl Fn(i64) -> i64) -> Vec<bool> {
        let start = clock::monotonic();
        let at = |seconds| Timestamp::UNIX_EPOCH + SignedDuration::from_secs(seconds);
        let mut clocks = Clocks::new(at(wall(0)), start);
        (0..=8641u32).map(|round| clocks.are_steady(at(wall(round.into())), start + round * PACE)).collect()
    }

    #[test]
    fn age_counts_after_a_day_without_a_jump() {
        let steady = a_day(|round| 10 * round);
        assert_eq!(steady.iter().position(|steady| *steady), Some(8640));
        for jump in [-86_400, 10, 315_360_000] {
            let jumped = a_day(|round| 10 * round + if round > 4000 { jump } else { 0 });
            assert!(!jumped.contains(&true), "a jump by {jump} s was not seen");
        }
        // A clock that is slewed by 500 ppm is not one that jumps.
        assert!(a_day(|round| 10 * round + round / 200).contains(&true));
    }
}
