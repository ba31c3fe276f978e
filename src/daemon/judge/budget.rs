//! Rate limit of operators' commands. Each command is stored with name, time and reason, in a table of limited size. A
//! flood of commands must not displace the record of the others.

use std::time::{Duration, Instant};

/// Number of commands accepted at once: a script may put a whole site into maintenance.
const BURST: f64 = 200.0;
/// Time for each further command. At this rate the stored commands ([`COMMANDS_KEPT`](crate::store::COMMANDS_KEPT))
/// cover at least 34 days.
const EVERY: Duration = Duration::from_secs(6);

/// A token bucket of commands.
#[derive(Debug)]
pub(crate) struct Budget {
    left: f64,
    at: Instant,
}

impl Budget {
    pub(crate) fn new(now: Instant) -> Self {
        Self { left: BURST, at: now }
    }

    /// Takes one command from the budget, or returns the time until one is available.
    pub(crate) fn take(&mut self, now: Instant) -> Result<(), Duration> {
        let earned = now.duration_since(self.at).as_secs_f64() / EVERY.as_secs_f64();
        (self.left, self.at) = ((self.left + earned).min(BURST), now);
        if self.left < 1.0 {
            return Err(EVERY.mul_f64(1.0 - self.left));
        }
        self.left -= 1.0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{daemon::clock, store::COMMANDS_KEPT};

    #[test]
    fn a_flood_is_slowed_down_and_a_site_in_maintenance_is_not() {
        let start = clock::monotonic();
        let mut budget = Budget::new(start);
        let carried_out = (0..100_000).filter(|ms| budget.take(start + Duration::from_millis(*ms)).is_ok()).count();
        assert_eq!(carried_out, 216, "200 at once, and one in 6 s for 100 s");
        assert!(budget.take(start + Duration::from_secs(100)).is_err_and(|wait| wait <= EVERY));
        assert!(budget.take(start + Duration::from_secs(107)).is_ok());
        assert!(EVERY * COMMANDS_KEPT > Duration::from_hours(34 * 24), "the record covers 34 days of such a flood");
    }
}
