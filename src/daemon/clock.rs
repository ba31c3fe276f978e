//! The clocks of the shell. The dashboard, the commands and the loggers use it too; the core gets the time as a parameter.

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
