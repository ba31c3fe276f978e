//! The condition of a drift alarm: when it is raised, escalated and cleared, with delays and a deadband counted in
//! throws.
//!
//! An alarm is raised if the diagnosis names its cause, with a size above the limit, for `on_delay_throws` consecutive
//! throws. If it names no single cause, or an uncertain one, it waits for more throws. The alarm is cleared after one
//! of these:
//! - plain health for `off_delay_throws`, at least a dozen: the size plus two standard deviations is below half of the
//!   limit; a size of the opposite sense counts as none, as after a repair that did more than restore the baseline;
//! - likely health for 24 throws, the longest window: the size is below half of the limit, and plus two standard
//!   deviations below the limit, as on a repaired machine whose estimates scatter;
//! - a size below the limit for `hold_throws`: no drift is detected, or its size is below the limit by the deadband;
//! - another name for 24 throws: another cause explains the drift.
//!
//! So an alarm near its limit does not alternate: it lasts at least `hold_throws`, unless the machine is healthy or the
//! drift gets another name. An alarm that is raised again within `hold_throws` lasts at least `hold_throws` in any case.

use serde::{Deserialize, Serialize};

use crate::diagnose::{
    Settings, Severity,
    statistics::{LONGEST_WINDOW, WINDOWS, streak},
};

/// Least number of throws of plain health before an alarm is cleared. Sizes are judged from means over up to this
/// number of throws of a direction; these follow a step with a delay, and still look healthy just after the raise.
pub(super) const LEVELS_FOLLOW: u32 = 12;
const _: () = assert!(LEVELS_FOLLOW as usize == WINDOWS[2], "the same length, in another type");

/// Evidence of a throw for an alarm about a cause, the weakest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub(crate) enum Claim {
    /// No evidence.
    #[default]
    None,
    /// Counts for the on delay, but does not raise the alarm.
    Counts,
    /// The diagnosis names the cause, above its limit.
    Named,
}

/// Size of a change as part of its limit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Left {
    /// In either sense.
    pub(crate) size: f64,
    /// In the sense of the alarm; 0 if the change has the opposite sense.
    pub(crate) in_sense: f64,
}

/// Evidence of a throw for and against an alarm about a cause.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[expect(clippy::struct_excessive_bools, reason = "independent findings about one throw")]
pub(crate) struct AlarmEvidence {
    /// Evidence for the alarm.
    pub(super) claim: Claim,
    /// Size relative to the warning limit for a critical alarm, which must not have a wrong name: 0 if there is doubt
    /// about the name. An alarm that is raised already becomes critical if the drift is so large under any name.
    pub(super) certain_size: f64,
    /// Number of throws to wait in addition to the on delay.
    pub(super) patience: u32,
    /// Whether the size, in the sense of the alarm, plus two standard deviations is below half of the limit.
    pub(super) plain_health: bool,
    /// Whether the size, in the sense of the alarm, is below half of the limit, and plus two standard deviations below
    /// the limit.
    pub(super) likely_health: bool,
    /// The present size.
    pub(super) left: Left,
    /// Whether no drift is detected, or its size is below the limit by the deadband.
    pub(crate) below: bool,
    /// Whether another cause explains the drift.
    pub(super) other_name: bool,
    /// Whether the drift has this cause and a size above the limit, but the opposite sign to the alarm.
    pub(super) turned: bool,
    /// Whether the alarm is from before a maintenance, and not confirmed since.
    pub(super) unchecked: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Transition {
    Stay,
    Raise(Severity),
    Escalate,
    /// The alarm continues with the opposite sign: a fall became a rise above the limit, or a rise a fall.
    Turn(Severity),
    /// The alarm ends.
    Clear(Left),
    /// Another cause explains the drift.
    Withdraw,
}

/// State of the alarm about a cause, with the counters \[throws\] of the state.
///
/// ```text
///          named for the on delay and the patience
///   Quiet -----------------------------------------> Raised --- critical for as long: escalates, stays Raised
///     ^                                                |    --- named with the opposite sign for as long: turns, stays
///     '--- healthy, below or otherwise explained ------'
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Condition {
    /// No alarm.
    Quiet {
        onset: Beginning,
        /// Throws since the alarm was last raised; `None` before the first time.
        since_raised: Option<u32>,
    },
    /// The alarm is active. Boxed, as few alarms are.
    Raised { onset: Beginning, since_raised: u32, ending: Box<Ending> },
}

/// Numbers of consecutive throws that speak for an alarm, and for a critical alarm.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Beginning {
    pub(crate) named: u32,
    pub(crate) critical: u32,
}

/// Numbers of consecutive throws that speak for the end of an active alarm.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Ending {
    pub(crate) healthy: u32,
    pub(super) likely_healthy: u32,
    pub(crate) below: u32,
    pub(crate) other: u32,
    pub(super) turned: u32,
    /// Whether the alarm was raised again soon after it cleared: then it lasts at least `hold_throws`.
    pub(super) restless: bool,
}

impl Default for Condition {
    fn default() -> Self {
        Self::Quiet { onset: Beginning::default(), since_raised: None }
    }
}

impl Condition {
    /// Applies the evidence of a throw; `active` is the severity of the active alarm.
    pub(crate) fn step(
        &mut self,
        evidence: AlarmEvidence,
        active: Option<Severity>,
        settings: &Settings,
    ) -> Transition {
        let (onset, since_raised) = match *self {
            Self::Quiet { onset, since_raised } => (onset, since_raised),
            Self::Raised { onset, since_raised, .. } => (onset, Some(since_raised)),
        };
        let onset = onset.after(evidence, settings);
        let since_raised = since_raised.map(|throws| throws.saturating_add(1));
        let delay = settings.on_delay_throws + evidence.patience;
        let is_named = evidence.claim == Claim::Named && onset.named >= delay;
        let severity = if onset.critical >= delay { Severity::Critical } else { Severity::Warning };
        let Some(active) = active else {
            if is_named {
                // Counters from before the raise must not clear the alarm: the sizes in them follow a step with a
                // delay.
                let restless = since_raised.is_some_and(|throws| throws < settings.hold_throws);
                *self = Self::Raised { onset, since_raised: 0, ending: Box::new(Ending::new(restless)) };
                return Transition::Raise(severity);
            }
            *self = Self::Quiet { onset, since_raised };
            return Transition::Stay;
        };
        let mut ending = if let Self::Raised { ending, .. } = self { ending.clone() } else { Box::default() };
        ending.follow(evidence);
        let transition = if ending.turned >= delay {
            *ending = Ending::new(ending.restless);
            Transition::Turn(severity)
        } else if evidence.unchecked && is_named {
            Transition::Raise(severity)
        } else if severity > active {
            Transition::Escalate
        } else {
            ending.transition(evidence.left, settings)
        };
        *self = Self::Raised { onset, since_raised: since_raised.unwrap_or_default(), ending };
        transition
    }

    /// Throws since the raise of the active alarm; `None` without one.
    pub(crate) fn since_raised(&self) -> Option<u32> {
        if let Self::Raised { since_raised, .. } = self { Some(*since_raised) } else { None }
    }

    /// Resets all counters after maintenance.
    pub(crate) fn reset(&mut self) {
        let onset = Beginning::default();
        *self = match *self {
            Self::Quiet { since_raised, .. } => Self::Quiet { onset, since_raised },
            Self::Raised { since_raised, .. } => Self::Raised { onset, since_raised, ending: Box::default() },
        };
    }
}

impl Beginning {
    fn after(mut self, evidence: AlarmEvidence, settings: &Settings) -> Self {
        streak(&mut self.named, evidence.claim != Claim::None);
        streak(&mut self.critical, evidence.certain_size > settings.critical_factor);
        self
    }
}

impl Ending {
    fn new(restless: bool) -> Self {
        Self { restless, ..Self::default() }
    }

    fn follow(&mut self, evidence: AlarmEvidence) {
        streak(&mut self.healthy, evidence.plain_health);
        streak(&mut self.likely_healthy, evidence.likely_health);
        streak(&mut self.below, evidence.below);
        streak(&mut self.other, evidence.other_name);
        streak(&mut self.turned, evidence.turned);
    }

    fn transition(&self, left: Left, settings: &Settings) -> Transition {
        let at_least = |throws: u32| if self.restless { throws.max(settings.hold_throws) } else { throws };
        if self.healthy >= at_least(settings.off_delay_throws.max(LEVELS_FOLLOW))
            || self.likely_healthy >= at_least(settings.off_delay_throws.max(LONGEST_WINDOW))
            || self.below >= settings.hold_throws
        {
            Transition::Clear(left)
        } else if self.other >= at_least(LONGEST_WINDOW) {
            Transition::Withdraw
        } else {
            Transition::Stay
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Number of throws until an alarm clears, if every throw has this evidence.
    fn cleared_after(evidence: AlarmEvidence) -> Option<u32> {
        let settings = Settings::default();
        let mut condition = Condition::Raised { onset: Beginning::default(), since_raised: 0, ending: Box::default() };
        let mut step = || condition.step(evidence, Some(Severity::Warning), &settings);
        (1..=300).find(|_| matches!(step(), Transition::Clear(_)))
    }

    #[test]
    fn an_alarm_that_came_back_soon_ends_after_a_maintenance_like_any_other() {
        let (settings, onset) = (Settings::default(), Beginning::default());
        let plain = AlarmEvidence { plain_health: true, ..AlarmEvidence::default() };
        for is_reset in [false, true] {
            let mut condition = Condition::Raised { onset, since_raised: 0, ending: Box::new(Ending::new(true)) };
            if is_reset {
                condition.reset();
            }
            let mut step = || condition.step(plain, Some(Severity::Warning), &settings);
            let ended = (1..=300).find(|_| matches!(step(), Transition::Clear(_)));
            assert_eq!(ended, Some(if is_reset { LEVELS_FOLLOW } else { settings.hold_throws }));
        }
    }

    #[test]
    fn an_alarm_ends_the_sooner_the_plainer_its_machine_is_healthy() {
        let below = AlarmEvidence { below: true, ..AlarmEvidence::default() };
        let likely = AlarmEvidence { likely_health: true, ..below };
        let plain = AlarmEvidence { plain_health: true, ..likely };
        assert_eq!([plain, likely, below].map(cleared_after), [Some(LEVELS_FOLLOW), Some(LONGEST_WINDOW), Some(200)]);
        assert_eq!(cleared_after(AlarmEvidence { below: false, ..below }), None);
    }
}
