//! The only place that reads the clocks.

use std::time::Instant;

use jiff::Timestamp;

/// Wall time. It may jump; nothing but records and texts depends on it.
#[must_use]
#[expect(clippy::disallowed_methods, reason = "this is the place")]
pub fn now() -> Timestamp {
    Timestamp::now()
}

/// Monotonic time, for waits and heartbeats.
#[must_use]
#[expect(clippy::disallowed_methods, reason = "this is the place")]
pub fn monotonic() -> Instant {
    Instant::now()
}
