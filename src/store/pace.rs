//! Trouble that goes on: said now and then, and shown for a while after it is over.

use std::{
    sync::{Mutex, PoisonError},
    time::Duration,
};

use tokio::time::Instant;

/// Shortest time between two lines of the log about the same trouble: a disk that stays full refuses ten writes a second.
const SAID: Duration = Duration::from_secs(30);
/// How long trouble that is over is shown: long enough to be seen.
const SHOWN: Duration = Duration::from_hours(1);

/// Bounds the lines of the log that one place in the program writes.
pub(crate) struct Seldom(Mutex<Option<(Instant, u64)>>);

impl Seldom {
    pub(crate) const fn new() -> Self {
        Self(Mutex::new(None))
    }

    /// Whether a line is due, and how many were left out since the last one.
    pub(crate) fn due(&self, now: Instant) -> Option<u64> {
        let mut said = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match &mut *said {
            Some((at, left_out)) if now.duration_since(*at) < SAID => {
                *left_out += 1;
                None
            }
            before => Some(before.replace((now, 0)).map_or(0, |(_, left_out)| left_out)),
        }
    }
}

/// A line of the log, unless the same place wrote one shortly before. The line says how many were left out.
macro_rules! seldom {
    ($level:ident, $($said:tt)*) => {{
        static LINE: crate::store::Seldom = crate::store::Seldom::new();
        if let Some(left_out) = LINE.due(tokio::time::Instant::now()) {
            tracing::$level!(left_out, $($said)*);
        }
    }};
}
pub(crate) use seldom;

/// A count, and when it last grew.
#[derive(Debug, Default)]
pub(crate) struct Recent(Mutex<(u64, Option<Instant>)>);

impl Recent {
    pub(crate) fn add(&self, more: u64) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *state = (state.0 + more, Some(Instant::now()));
    }

    /// The count since the start.
    pub(crate) fn count(&self) -> u64 {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).0
    }

    /// The count, when it grew in the last hour.
    pub(crate) fn shown(&self) -> Option<u64> {
        let (count, at) = *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        at.filter(|at| at.elapsed() < SHOWN).map(|_| count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_due_every_thirty_seconds_and_says_what_was_left_out() {
        let (line, start) = (Seldom::new(), Instant::now());
        assert_eq!([line.due(start), line.due(start), line.due(start)], [Some(0), None, None]);
        assert_eq!([line.due(start + SAID), line.due(start + SAID)], [Some(2), None]);
    }
}
