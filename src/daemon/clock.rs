//! The clocks of the shell: the only calls of the clocks of `std` and `jiff`. Deadlines, pauses and
//! durations of store, daemon and web use the `Instant` of tokio as well. The core gets the time as a parameter.

use std::time::Instant;

use jiff::Timestamp;

/// Wall time, for records and texts only, as it may jump.
#[expect(clippy::disallowed_methods, reason = "this is the place")]
pub(crate) fn now() -> Timestamp {
    Timestamp::now()
}

/// Monotonic time, for waits and heartbeats.
#[expect(clippy::disallowed_methods, reason = "this is the place")]
pub(crate) fn monotonic() -> Instant {
    Instant::now()
}
