//! The only reads of the clocks of `std` and `jiff`, for the whole shell. Beside them, the shell measures deadlines,
//! pauses and durations with the `Instant` of tokio. The core gets the time as a parameter.

use std::time::Instant;

use jiff::{SignedDuration, Timestamp, Unit};

/// Wall time, for records and texts only, as it may jump.
#[expect(clippy::disallowed_methods, reason = "the only read of the wall clock")]
pub(crate) fn now() -> Timestamp {
    Timestamp::now()
}

/// The end of a window of this `length` that begins `now`, rounded to a whole second for people.
pub(crate) fn end_of_window(now: Timestamp, length: SignedDuration) -> Result<Timestamp, jiff::Error> {
    now.checked_add(length)?.round(Unit::Second)
}

/// Monotonic time, for waits and heartbeats.
#[expect(clippy::disallowed_methods, reason = "the only read of the monotonic clock")]
pub(crate) fn monotonic() -> Instant {
    Instant::now()
}
