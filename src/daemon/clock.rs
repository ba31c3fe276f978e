//! The clocks of the shell: the only calls of the clocks of `std` and `jiff`. Deadlines, pauses and
//! durations of store, daemon and web use the `Instant` of tokio as well. The core gets the time as a parameter.

use std::time::Instant;

use jiff::{SignedDuration, Timestamp, Unit};

/// Wall time, for records and texts only, as it may jump.
#[expect(clippy::disallowed_methods, reason = "this is the place")]
pub(crate) fn now() -> Timestamp {
    Timestamp::now()
}

/// The end of a window of this length that begins `now`, as a whole second, as people write times.
pub(crate) fn end_of_window(now: Timestamp, length: SignedDuration) -> Result<Timestamp, jiff::Error> {
    now.checked_add(length)?.round(Unit::Second)
}

/// Monotonic time, for waits and heartbeats.
#[expect(clippy::disallowed_methods, reason = "this is the place")]
pub(crate) fn monotonic() -> Instant {
    Instant::now()
}
