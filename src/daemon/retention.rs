//! The loop that keeps the database within its bounds.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use jiff::{SignedDuration, Timestamp};

use super::clock;
use crate::store::{Store, StoreError, seldom};

/// Time between two rounds. The fastest flood stores 40 MiB in this time; the database may exceed its bound by that.
const PACE: Duration = Duration::from_secs(1);
/// systemd-timesyncd creates this file after setting the clock from a time server. Other time services are not
/// detected, as the kernel state needs a system call that the unit forbids.
const CLOCK_IS_SET: &str = "/run/systemd/timesync/synchronized";
/// Without that file, the clock is trusted if the daemon starts at most this long after the newest throw in the
/// database, until the clock jumps ahead by more than this. Otherwise the clock may be wrong, and only the bounds of
/// bytes and rows are applied, not that of age.
const CONTINUES: SignedDuration = SignedDuration::from_hours(31 * 24);
/// Time for which wall and monotonic clock must agree before the bound of age is applied: a wall clock that jumps ten
/// years ahead must not remove all traces.
const STEADY: Duration = Duration::from_hours(24);
/// Difference of the clocks between two rounds that counts as a jump; a time server corrects a running clock by
/// milliseconds.
const JUMP: SignedDuration = SignedDuration::from_secs(1);

/// Runs until the store is closed. `last_received` is the newest time of reception in the database.
pub(super) async fn run(store: Store, last_received: Option<Timestamp>) {
    let mut pace = clock::every(PACE);
    let mut clocks = Clocks::new(clock::now(), clock::monotonic(), last_received);
    loop {
        pace.tick().await;
        let now = clock::now();
        clocks.advance(now, clock::monotonic());
        let is_trusted = clocks.is_trusted(Path::new(CLOCK_IS_SET).exists());
        match store.keep_bounds(is_trusted.then_some(now)).await {
            Ok(done) if done.is_empty() => {}
            Ok(done) => tracing::info!(?done, "dropped the oldest rows to stay within the bounds of [store]"),
            Err(StoreError::Closed) => return,
            Err(error) => seldom!(warn, %error, "keeping the database within its bounds failed"),
        }
    }
}

/// Compares wall and monotonic time.
struct Clocks {
    wall: Timestamp,
    monotonic: Instant,
    /// The clocks have agreed since this time.
    since: Instant,
    /// Whether the wall clock continues the times in the database, by at most [`CONTINUES`].
    continue_time: bool,
}

impl Clocks {
    fn new(wall: Timestamp, monotonic: Instant, last_received: Option<Timestamp>) -> Self {
        let continue_time = last_received.is_none_or(|last| wall.duration_since(last) <= CONTINUES);
        Self { wall, monotonic, since: monotonic, continue_time }
    }

    /// Notes the times of the clocks now.
    fn advance(&mut self, wall: Timestamp, monotonic: Instant) {
        let passed = SignedDuration::try_from(monotonic.duration_since(self.monotonic)).unwrap_or(SignedDuration::MAX);
        let jump = wall.duration_since(self.wall).saturating_sub(passed);
        if jump.abs() > JUMP {
            self.since = monotonic;
            self.continue_time &= jump <= CONTINUES;
        }
        (self.wall, self.monotonic) = (wall, monotonic);
    }

    /// Whether the wall clock is trusted. `is_set`: a time server has set it.
    fn is_trusted(&self, is_set: bool) -> bool {
        self.monotonic.duration_since(self.since) >= STEADY && (self.continue_time || is_set)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROUND: Duration = Duration::from_secs(10);

    /// Whether a clock that a time server has set is trusted, after each round of a day. `wall(round)` is the time of
    /// the wall clock \[s\].
    fn a_day(wall: impl Fn(i64) -> i64) -> Vec<bool> {
        let start = clock::monotonic();
        let at = |seconds| Timestamp::UNIX_EPOCH + SignedDuration::from_secs(seconds);
        let mut clocks = Clocks::new(at(wall(0)), start, None);
        let mut is_trusted = |round: u32| {
            clocks.advance(at(wall(round.into())), start + round * ROUND);
            clocks.is_trusted(true)
        };
        (0..=8641).map(&mut is_trusted).collect()
    }

    #[test]
    fn age_counts_after_a_day_without_a_jump() {
        let steady = a_day(|round| 10 * round);
        assert_eq!(steady.iter().position(|steady| *steady), Some(8640));
        for jump in [-86_400, 10, 315_360_000] {
            let jumped = a_day(|round| 10 * round + if round > 4000 { jump } else { 0 });
            assert!(!jumped.contains(&true), "a jump by {jump} s was not seen");
        }
        // A clock that a time server slews by 500 ppm does not jump.
        assert!(a_day(|round| 10 * round + round / 200).contains(&true));
    }

    #[test]
    fn a_clock_that_does_not_continue_from_the_newest_throw_is_not_trusted() {
        let (start, now) = (clock::monotonic(), Timestamp::UNIX_EPOCH + SignedDuration::from_hours(24 * 20_000));
        let days = |days: i64| SignedDuration::from_hours(24 * days);
        let continues = |last_received| Clocks::new(now, start, last_received).continue_time;
        assert!(continues(None) && continues(Some(now - days(30))) && continues(Some(now + days(3650))));
        assert!(!continues(Some(now - days(32))) && !continues(Some(now - days(3650))));

        for (jump, believed) in [(-3650, true), (1, true), (32, false), (3650, false)] {
            let mut clocks = Clocks::new(now, start, Some(now));
            clocks.advance(now + days(jump), start);
            assert_eq!(clocks.continue_time, believed, "after a jump of {jump} days");
        }
    }
}
