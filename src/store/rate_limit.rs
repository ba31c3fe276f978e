//! A rate limit for log lines about a lasting problem, and counters of problems of the last hour.

use std::time::Duration;

use parking_lot::Mutex;
use tokio::time::Instant;

/// Least time between two log lines about the same problem: a full disk fails ten writes per second.
const LOG_INTERVAL: Duration = Duration::from_secs(30);
/// Time for which a problem is shown after its last occurrence.
pub(super) const SHOWN: Duration = Duration::from_hours(1);

/// Limits the rate of one log line: time of the last line, and number of lines omitted since.
pub(crate) struct LogRateLimit(Mutex<Option<(Instant, u64)>>);

impl LogRateLimit {
    pub(crate) const fn new() -> Self {
        Self(Mutex::new(None))
    }

    /// The number of omitted lines if a line is due; `None` to omit it.
    pub(crate) fn due(&self, now: Instant) -> Option<u64> {
        let mut last = self.0.lock();
        match &mut *last {
            Some((at, omitted)) if now.duration_since(*at) < LOG_INTERVAL => {
                *omitted += 1;
                None
            }
            before => Some(before.replace((now, 0)).map_or(0, |(_, omitted)| omitted)),
        }
    }
}

/// Writes a log line, with the number of omitted lines, unless the same place wrote one shortly before.
macro_rules! seldom {
    ($level:ident, $($said:tt)*) => {{
        static LINE: crate::store::LogRateLimit = crate::store::LogRateLimit::new();
        if let Some(omitted) = LINE.due(tokio::time::Instant::now()) {
            // `None` is not written.
            let omitted_lines = (omitted > 0).then_some(omitted);
            tracing::$level!(omitted_lines, $($said)*);
        }
    }};
}
pub(crate) use seldom;

/// A counter with the time of its last increase.
#[derive(Debug, Default)]
pub(crate) struct RecentCount(Mutex<(u64, Option<Instant>)>);

impl RecentCount {
    pub(crate) fn add(&self, more: u64) {
        let mut state = self.0.lock();
        *state = (state.0 + more, Some(Instant::now()));
    }

    /// The value since the start.
    pub(crate) fn count(&self) -> u64 {
        self.0.lock().0
    }

    /// The value, if it grew in the last hour.
    pub(crate) fn shown(&self) -> Option<u64> {
        let (count, at) = *self.0.lock();
        at.filter(|at| at.elapsed() < SHOWN).map(|_| count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_due_every_thirty_seconds_with_the_number_of_omitted_ones() {
        let (line, start) = (LogRateLimit::new(), Instant::now());
        assert_eq!([line.due(start), line.due(start), line.due(start)], [Some(0), None, None]);
        assert_eq!([line.due(start + LOG_INTERVAL), line.due(start + LOG_INTERVAL)], [Some(2), None]);
    }
}
