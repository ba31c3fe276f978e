//! Checks whether the published sizes and forecasts of a drift are true.

use super::{
    scenario::Growth,
    timeline::{LifeFault, Timeline},
};
use crate::diagnose::{AlarmEvent, AlarmState, Cause, Settings, Verdict};

/// Half-width of a 95 % interval in standard deviations.
const SD_95: f64 = 1.96;
/// Throws of the fault between two checks of an active alarm: consecutive sizes come from nearly the same throws.
const CHECKED_EVERY: usize = 10;
/// Rounding tolerance, for a fault that reaches the limit exactly with its last throw.
const ROUNDING: f64 = 1e-9;

/// Statements of one kind, counted: all, and those that were true.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Share {
    said: usize,
    held: usize,
}

/// Statements about sizes and forecasts of the judged faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Coverage {
    /// 95 % intervals of the size, at the raise of an alarm and at every tenth throw while it is active.
    pub(super) sizes: Share,
    /// Forecasts of the throws to the critical limit, at every tenth throw before a growing fault reaches it.
    pub(super) forecasts: Share,
}

impl Share {
    fn add(&mut self, is_true: bool) {
        self.said += 1;
        self.held += usize::from(is_true);
    }

    fn merge(&mut self, other: Self) {
        self.said += other.said;
        self.held += other.held;
    }

    /// The share of true statements; `None` without statements.
    pub(super) fn value(self) -> Option<f64> {
        (self.said > 0).then(|| self.held as f64 / self.said as f64)
    }
}

impl Coverage {
    /// Adds the statements of another life.
    pub(super) fn merge(&mut self, other: Self) {
        self.sizes.merge(other.sizes);
        self.forecasts.merge(other.forecasts);
    }

    /// Checks the `verdict` on throw `at` of a life.
    pub(super) fn add(&mut self, at: usize, verdict: &Verdict, life: &Timeline, settings: &Settings) {
        if at < life.onset || life.fault_is_in_baseline() {
            return;
        }
        for fault in life.faults.iter().filter(|fault| fault.onset == life.onset && has_one_size(fault)) {
            let holds = |size: f64, sd: f64| (size - 100.0 * fault.size_at(at)).abs() <= SD_95 * sd;
            for (size, sd) in verdict.events.iter().filter_map(|event| raised(event, fault.part)) {
                self.sizes.add(holds(size, sd));
            }
            let drift = verdict.present.drifts.iter().find(|drift| drift.cause == fault.part);
            let Some(drift) = drift.filter(|_| (at - fault.onset + 1).is_multiple_of(CHECKED_EVERY)) else { continue };
            self.sizes.add(holds(drift.change_pct, drift.change_pct_sd));
            if let (Some(forecast), Some(left)) = (drift.limit_in_throws, throws_left(fault, at, settings)) {
                self.forecasts.add(forecast.low <= left && left <= forecast.high);
            }
        }
    }
}

/// Whether the fault has one true size at each throw. An intermittent fault has two. For wear from the first throw, the
/// size depends on the throws that became the baseline.
fn has_one_size(fault: &LifeFault) -> bool {
    fault.part.is_part() && matches!(fault.shape, Growth::Step | Growth::Ramp | Growth::Accelerating)
}

/// The published size and its standard deviation \[%\], if the event raises an alarm about `part`.
fn raised(event: &AlarmEvent, part: Cause) -> Option<(f64, f64)> {
    let raises = event.cause == part && event.event_no == 1 && event.state == AlarmState::ActiveUnacknowledged;
    event.change_pct.zip(event.change_pct_sd).filter(|_| raises)
}

/// Throws from throw `at` until a growing fault reaches its critical limit. `None` for a step, for a fault beyond the
/// limit, and for a fault that never reaches it.
fn throws_left(fault: &LifeFault, at: usize, settings: &Settings) -> Option<f64> {
    let critical = settings.critical_factor * settings.limit_pct(fault.part)? / 100.0 - ROUNDING;
    let beyond = |throw: usize| fault.size_at(throw).abs() >= critical;
    if fault.shape == Growth::Step || beyond(at) {
        return None;
    }
    (at..fault.onset + fault.shape.throws()).find(|&throw| beyond(throw)).map(|throw| (throw - at) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::{Drifting, LimitForecast, Present};

    const ONSET: usize = 200;

    /// The coverage of one drift, published at throw `at`, with a standard deviation of 1 %. The true fault is a ramp
    /// of friction to 90 % over 100 throws.
    fn checked(at: usize, change_pct: f64, ahead: (f64, f64)) -> Coverage {
        let part = Cause::Friction;
        let fault = LifeFault { part, size: 0.9, onset: ONSET, repaired: None, shape: Growth::Ramp };
        let mut life = Timeline::healthy(400);
        (life.faults, life.onset) = (vec![fault], ONSET);
        let limit_in_throws = Some(LimitForecast { low: ahead.0, mid: ahead.0, high: ahead.1 });
        let drift = Drifting { cause: part, change_pct, change_pct_sd: 1.0, direction: None, limit_in_throws };
        let present = Present { drifts: vec![drift], ..Present::default() };
        let verdict = Verdict { present, ..Verdict::default() };
        let mut coverage = Coverage::default();
        coverage.add(at, &verdict, &life, &Settings::default());
        coverage
    }

    #[test]
    fn every_tenth_size_and_the_forecast_before_the_limit_count() {
        // The true size is 18 % after 20 throws; the critical limit of 45 % is reached at throw 50.
        let at = ONSET + 19;
        let [held, not] = [1, 0].map(|held| Share { said: 1, held });
        assert_eq!(checked(at, 19.9, (29.0, 31.0)), Coverage { sizes: held, forecasts: held });
        assert_eq!(checked(at, 20.1, (31.0, 40.0)), Coverage { sizes: not, forecasts: not });
        assert_eq!(checked(at + 1, 19.9, (29.0, 31.0)), Coverage::default());
        assert_eq!(checked(ONSET + 59, 54.0, (0.0, 5.0)), Coverage { sizes: held, forecasts: Share::default() });
    }
}
