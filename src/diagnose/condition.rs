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

use super::{event::Severity, settings::Settings, threshold::WINDOWS};

/// A size from this part of the alarm's level on is still at that level: closer than scatter moves a few throws.
const NEAR_LEVEL: f64 = 0.75;
/// A size below this part of the level has left it: more than half of the drift went away.
const LEFT_LEVEL: f64 = 0.5;
/// Throws within which a repair shows: the last few throws of each direction.
const REPAIR_SHOWS_WITHIN: u32 = 8;
/// Least level, in multiples of the warning limit, from which a fall is taken for a repair: closer to the limit, a fall is
/// nothing but scatter.
const REPAIRABLE_LEVEL: f64 = 1.5;
/// Throws of both directions that fill a longest window of each.
const LONGEST_WINDOW: u32 = 24;
const _: () = assert!(LONGEST_WINDOW as usize == WINDOWS[3], "the same length, in another type");

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
pub(super) enum Transition {
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

/// Where the alarm about one cause stands, with the counters \[throws\] that matter there.
///
/// ```text
///          named for the on delay, and its patience
///   Quiet -----------------------------------------> Raised --- critical for as long: escalates, stays Raised
///     ^                                                |
///     '--- healthy, below or otherwise explained ------'
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Condition {
    /// No alarm.
    Quiet {
        onset: Onset,
        /// Throws since the alarm was last raised; `None` before the first time.
        since_raised: Option<u32>,
    },
    /// The alarm is active.
    Raised { onset: Onset, since_raised: u32, ending: Ending },
}

/// Streaks of throws that speak for an alarm, or for a critical one.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Onset {
    pub(super) named: u32,
    pub(super) critical: u32,
}

/// Streaks of throws that speak for the end of an active alarm.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Ending {
    pub(super) healthy: u32,
    pub(super) below: u32,
    pub(super) other: u32,
    /// Largest recent size over the warning limit.
    pub(super) level: f64,
    /// Throws since the size was near that level.
    pub(super) since_level: u32,
    /// Throws that the size took from the level to less than half of it.
    pub(super) fell_within: Option<u32>,
    /// A new baseline was proposed.
    pub(super) proposed: bool,
    /// The alarm was raised again soon after it had cleared: from now on it stays for `hold_throws`.
    pub(super) restless: bool,
}

impl Default for Condition {
    fn default() -> Self {
        Self::Quiet { onset: Onset::default(), since_raised: None }
    }
}

fn count(streak: &mut u32, holds: bool) {
    *streak = if holds { streak.saturating_add(1) } else { 0 };
}

impl Condition {
    /// Takes in one throw, while the alarm has the severity `active`.
    pub(super) fn step(&mut self, reading: Reading, active: Option<Severity>, settings: &Settings) -> Transition {
        let (onset, since_raised) = match *self {
            Self::Quiet { onset, since_raised } => (onset, since_raised),
            Self::Raised { onset, since_raised, .. } => (onset, Some(since_raised)),
        };
        let onset = onset.after(reading, settings);
        let since_raised = since_raised.map(|throws| throws.saturating_add(1));
        let delay = settings.on_delay_throws + reading.patience;
        let is_critical = onset.critical >= delay;
        let Some(severity) = active else {
            if reading.claim == Claim::Named && onset.named >= delay {
                // Streaks from before the alarm do not end it: the levels lag behind a step by a few throws.
                let restless = since_raised.is_some_and(|throws| throws < settings.hold_throws);
                *self = Self::Raised { onset, since_raised: 0, ending: Ending { restless, ..Ending::default() } };
                return Transition::Raise(if is_critical { Severity::Critical } else { Severity::Warning });
            }
            *self = Self::Quiet { onset, since_raised };
            return Transition::Stay;
        };
        let before = if let Self::Raised { ending, .. } = *self { ending } else { Ending::default() };
        let mut ending = before.after(reading);
        let transition = if severity == Severity::Warning && is_critical {
            Transition::Escalate
        } else {
            ending.follow_level(reading.latest);
            ending.transition(settings)
        };
        let since_raised = since_raised.unwrap_or_default();
        *self = Self::Raised { onset, since_raised, ending };
        transition
    }

    /// Forgets all streaks: the machine was in maintenance.
    pub(super) fn reset(&mut self) {
        let onset = Onset::default();
        *self = match *self {
            Self::Quiet { since_raised, .. } => Self::Quiet { onset, since_raised },
            Self::Raised { since_raised, ending, .. } => {
                Self::Raised { onset, since_raised, ending: Ending { restless: ending.restless, ..Ending::default() } }
            }
        };
    }
}

impl Onset {
    fn after(mut self, reading: Reading, settings: &Settings) -> Self {
        count(&mut self.named, reading.claim != Claim::None);
        count(&mut self.critical, reading.undoubted > settings.critical_factor);
        self
    }
}

impl Ending {
    fn after(mut self, reading: Reading) -> Self {
        count(&mut self.healthy, reading.plain_health);
        count(&mut self.below, reading.below);
        count(&mut self.other, reading.other_name);
        self
    }

    /// Follows whether the size falls at once or slowly.
    fn follow_level(&mut self, latest: Option<f64>) {
        self.since_level = self.since_level.saturating_add(1);
        let Some(latest) = latest else { return };
        if latest >= NEAR_LEVEL * self.level {
            self.level = self.level.max(latest);
            (self.since_level, self.fell_within) = (0, None);
        } else if latest < LEFT_LEVEL * self.level && self.fell_within.is_none() {
            self.fell_within = Some(self.since_level);
        }
    }

    /// Whether the size fell as after a repair: by half within a few throws of each direction.
    fn fell_at_once(&self) -> bool {
        self.level >= REPAIRABLE_LEVEL && self.fell_within.is_some_and(|throws| throws <= REPAIR_SHOWS_WITHIN)
    }

    fn transition(&mut self, settings: &Settings) -> Transition {
        let at_least = |throws: u32| if self.restless { throws.max(settings.hold_throws) } else { throws };
        if self.healthy >= at_least(settings.off_delay_throws) || self.below >= settings.hold_throws {
            Transition::Clear { at_once: self.fell_at_once() }
        } else if self.other >= at_least(LONGEST_WINDOW) {
            Transition::Withdraw
        } else if self.fell_at_once() && !self.proposed && self.since_level >= 2 * LONGEST_WINDOW {
            self.proposed = true;
            Transition::ProposeRebaseline
        } else {
            Transition::Stay
        }
    }
}
