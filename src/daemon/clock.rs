//! The only reads of the clocks of `std` and `jiff`, for the whole shell. Beside them, the shell measures deadlines,
//! pauses and durations with the `Instant` of tokio. The core gets the time as a parameter.

use std::time::{Duration, Instant};

use jiff::{SignedDuration, Timestamp};
use tokio::time::{Interval, MissedTickBehavior, interval};

/// Wall time, for records and texts only, as it may jump.
#[expect(clippy::disallowed_methods, reason = "the only read of the wall clock")]
pub(crate) fn now() -> Timestamp {
    Timestamp::now()
}

/// The end of a window of this `length` that begins `now`, at a whole second for people. The window is not longer than
/// `length`, which may be the longest that a command allows.
pub(crate) fn end_of_window(now: Timestamp, length: SignedDuration) -> Result<Timestamp, jiff::Error> {
    Timestamp::from_second(now.checked_add(length)?.as_second())
}

/// Ticks with this period, the first at once. Ticks that were missed are left out: after an hour in which a loop waited
/// for the database, an hour of ticks at once would be a second load.
#[expect(clippy::disallowed_methods, reason = "the only periodic ticks")]
pub(crate) fn every(period: Duration) -> Interval {
    let mut ticks = interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}

/// Monotonic time, for waits and heartbeats.
#[expect(clippy::disallowed_methods, reason = "the only read of the monotonic clock")]
pub(crate) fn monotonic() -> Instant {
    Instant::now()
}

#[cfg(test)]
mod tests {
    use futures_util::FutureExt;

    use super::*;

    #[test]
    fn a_window_is_not_longer_than_its_length() {
        let now: Timestamp = "2026-05-04T10:11:12.7Z".parse().unwrap();
        let end = end_of_window(now, SignedDuration::from_hours(744)).unwrap();
        assert_eq!(end.to_string(), "2026-06-04T10:11:12Z");
    }

    #[tokio::test]
    async fn missed_ticks_are_left_out() {
        const PERIOD: Duration = Duration::from_millis(500);
        let mut ticks = every(PERIOD);
        tokio::time::sleep(2 * PERIOD).await;
        assert!(ticks.tick().now_or_never().is_some(), "the first");
        assert!(ticks.tick().now_or_never().is_none(), "a missed one");
    }
}
