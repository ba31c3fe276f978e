//! When a drift alarm is raised, gets critical, and is cleared: on and off delays and the deadband, counted in throws.
//!
//! An alarm is raised when the diagnosis names its cause, above its limit, for `on_delay_throws` in a row. It is
//! cleared when one of these has lasted:
//! - plain health, `off_delay_throws`: the size with two standard deviations on top is below half of the limit;
//! - hovering, `hold_throws`: no drift is detected, or its size is below the limit by the deadband;
//! - another name, one longest window: the drift is there, and something else explains it.
//!
//! So an alarm at its limit does not toggle: without plain health it stays for `hold_throws` at least.

use serde::{Deserialize, Serialize};

use super::{Cause, Settings, event::Severity, threshold::WINDOWS};

/// Throws in a row by which `unattributed` waits longer than a named cause: the first throws after a step are few,
/// and what they leave open the next ones usually settle.
const PATIENCE: u32 = 6;

/// What one throw says about one cause.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reading {
    /// The diagnosis names the cause, and its size is this many times the warning limit; zero when it does not.
    pub(super) relevance: f64,
    /// The size, two standard deviations added, is below half of the limit.
    pub(super) plain_health: bool,
    /// No drift is detected, or its size is below the limit by the deadband.
    pub(super) below: bool,
    /// The drift has another name.
    pub(super) other_name: bool,
}

/// What has to happen to an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    Stay,
    Raise(Severity),
    Escalate,
    /// Back to normal.
    Clear,
    /// Something else explains the drift.
    Withdraw,
}

/// How long each condition of one cause has lasted \[throws\].
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Condition {
    on: u32,
    critical: u32,
    healthy: u32,
    below: u32,
    other: u32,
    /// Throws since the alarm was last raised.
    since_raised: Option<u32>,
    /// It was raised again soon after it had cleared: from now on it stays for `hold_throws`.
    restless: bool,
}

impl Condition {
    /// Takes in one throw, while the alarm has the severity `active`.
    pub(super) fn step(
        &mut self,
        cause: Cause,
        reading: Reading,
        active: Option<Severity>,
        settings: &Settings,
    ) -> Step {
        let count = |streak: &mut u32, holds: bool| *streak = if holds { streak.saturating_add(1) } else { 0 };
        count(&mut self.on, reading.relevance > 1.0);
        count(&mut self.critical, reading.relevance > settings.critical_factor);
        count(&mut self.healthy, reading.plain_health);
        count(&mut self.below, reading.below);
        count(&mut self.other, reading.other_name);
        self.since_raised = self.since_raised.map(|throws| throws.saturating_add(1));
        let delay = settings.on_delay_throws + if cause == Cause::Unattributed { PATIENCE } else { 0 };
        let is_critical = self.critical >= delay;
        match active {
            None if self.on >= delay => {
                self.restless = self.since_raised.is_some_and(|throws| throws < settings.hold_throws);
                self.since_raised = Some(0);
                Step::Raise(if is_critical { Severity::Critical } else { Severity::Warning })
            }
            Some(Severity::Warning) if is_critical => Step::Escalate,
            Some(_) => self.ending(settings),
            None => Step::Stay,
        }
    }

    fn ending(&self, settings: &Settings) -> Step {
        let at_least = |throws: u32| if self.restless { throws.max(settings.hold_throws) } else { throws };
        if self.healthy >= at_least(settings.off_delay_throws) || self.below >= settings.hold_throws {
            Step::Clear
        } else if self.other >= at_least(WINDOWS[3].try_into().unwrap_or(u32::MAX)) {
            Step::Withdraw
        } else {
            Step::Stay
        }
    }

    /// Forgets all streaks: the machine was in maintenance.
    pub(super) fn reset(&mut self) {
        *self = Self { since_raised: self.since_raised, restless: self.restless, ..Self::default() };
    }
}
