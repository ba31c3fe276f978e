//! When a drift alarm is raised, gets critical, and is cleared: on and off delays and the deadband, counted in throws.
//!
//! An alarm is raised when the diagnosis names its cause, above its limit, for `on_delay_throws` in a row; without a single
//! name, when the drift has waited longer for one. It is cleared when one of these has lasted:
//! - plain health, `off_delay_throws`: the size with two standard deviations on top is below half of the limit;
//! - hovering, `hold_throws`: no drift is detected, or its size is below the limit by the deadband;
//! - another name, one longest window: the drift is there, and something else explains it.
//!
//! So an alarm at its limit does not toggle: without plain health it stays for `hold_throws` at least.

use serde::{Deserialize, Serialize};

use super::{Settings, event::Severity, threshold::WINDOWS};

/// What one throw says for an alarm about one cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Claim {
    /// Nothing.
    None,
    /// It counts as a throw of the on delay, but raises nothing.
    Counts,
    /// The diagnosis names the cause, above its limit.
    Named,
}

/// What one throw says about one cause.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reading {
    /// What it says for an alarm.
    pub(super) claim: Claim,
    /// The size over the warning limit where the name is beyond doubt, zero where it is not: a critical alarm must not
    /// have the wrong name.
    pub(super) undoubted: f64,
    /// Throws by which the alarm waits longer than the on delay.
    pub(super) patience: u32,
    /// The size, two standard deviations added, is below half of the limit.
    pub(super) plain_health: bool,
    /// No drift is detected, or its size is below the limit by the deadband.
    pub(super) below: bool,
    /// The drift has another name.
    pub(super) other_name: bool,
    /// Size in the last few throws over the limit; `None` when they are of a direction that the alarm is not about.
    pub(super) latest: Option<f64>,
}

/// What has to happen to an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    Stay,
    Raise(Severity),
    Escalate,
    /// Back to normal; `at_once`: within a few throws.
    Clear {
        at_once: bool,
    },
    /// Most of the drift went away within a few throws, as after a repair, but the machine is not as it was.
    ProposeRebaseline,
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
    /// Largest recent size over the limit while the alarm is active.
    level: f64,
    /// Throws since the size was near that level.
    below_level: u32,
    /// How many throws it took from there to less than half.
    fell_within: Option<u32>,
    proposed: bool,
    /// It was raised again soon after it had cleared: from now on it stays for `hold_throws`.
    restless: bool,
}

impl Condition {
    /// Takes in one throw, while the alarm has the severity `active`.
    pub(super) fn step(&mut self, reading: Reading, active: Option<Severity>, settings: &Settings) -> Step {
        let count = |streak: &mut u32, holds: bool| *streak = if holds { streak.saturating_add(1) } else { 0 };
        count(&mut self.on, reading.claim != Claim::None);
        count(&mut self.critical, reading.undoubted > settings.critical_factor);
        count(&mut self.healthy, reading.plain_health);
        count(&mut self.below, reading.below);
        count(&mut self.other, reading.other_name);
        self.since_raised = self.since_raised.map(|throws| throws.saturating_add(1));
        let delay = settings.on_delay_throws + reading.patience;
        let is_critical = self.critical >= delay;
        match active {
            None if reading.claim == Claim::Named && self.on >= delay => {
                self.restless = self.since_raised.is_some_and(|throws| throws < settings.hold_throws);
                self.since_raised = Some(0);
                // What held before the alarm does not end it: the levels lag behind a step by a few throws.
                (self.healthy, self.below, self.other) = (0, 0, 0);
                (self.level, self.below_level, self.fell_within, self.proposed) = (0.0, 0, None, false);
                Step::Raise(if is_critical { Severity::Critical } else { Severity::Warning })
            }
            Some(Severity::Warning) if is_critical => Step::Escalate,
            Some(_) => {
                self.follow_level(reading.latest);
                self.ending(settings)
            }
            None => Step::Stay,
        }
    }

    /// Follows whether the size falls at once or slowly.
    fn follow_level(&mut self, latest: Option<f64>) {
        const NEAR: f64 = 0.75;
        const LOW: f64 = 0.5;
        self.below_level = self.below_level.saturating_add(1);
        let Some(latest) = latest else { return };
        if latest >= NEAR * self.level {
            self.level = self.level.max(latest);
            (self.below_level, self.fell_within) = (0, None);
        } else if latest < LOW * self.level && self.fell_within.is_none() {
            self.fell_within = Some(self.below_level);
        }
    }

    /// Whether the size fell as after a repair: by half within a few throws of each direction.
    fn fell_at_once(&self) -> bool {
        const AT_ONCE: u32 = 8;
        /// Times the limit: from closer to it, a fall is nothing but scatter.
        const WELL_ABOVE: f64 = 1.5;
        self.level >= WELL_ABOVE && self.fell_within.is_some_and(|throws| throws <= AT_ONCE)
    }

    fn ending(&mut self, settings: &Settings) -> Step {
        let longest = WINDOWS[3].try_into().unwrap_or(u32::MAX);
        let restless = self.restless;
        let at_least = |throws: u32| if restless { throws.max(settings.hold_throws) } else { throws };
        if self.healthy >= at_least(settings.off_delay_throws) || self.below >= settings.hold_throws {
            Step::Clear { at_once: self.fell_at_once() }
        } else if self.other >= at_least(longest) {
            Step::Withdraw
        } else if self.fell_at_once() && !self.proposed && self.below_level >= 2 * longest {
            self.proposed = true;
            Step::ProposeRebaseline
        } else {
            Step::Stay
        }
    }

    /// Forgets all streaks: the machine was in maintenance.
    pub(super) fn reset(&mut self) {
        *self = Self { since_raised: self.since_raised, restless: self.restless, ..Self::default() };
    }
}
