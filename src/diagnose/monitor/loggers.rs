//! Effects of the logger on the monitor of its machine: liveliness, clock, boots, lost or irregular throws.

use jiff::Timestamp;

use super::{MachineMonitor, to_micros};
use crate::{
    diagnose::{
        AlarmEvent, Cause, Irregularity, Missing, Settings,
        alarm::{Actor, Command, Rule, Step},
        operation::{Boots, boots, not_monitored},
        text,
    },
    throw::{Direction, ThrowRef},
};

/// The time of a throw.
#[derive(Debug, Clone, PartialEq)]
pub struct Dated {
    /// Time of the throw for the diagnosis: the time of reception while the logger's clock is wrong.
    pub at: Timestamp,
    /// Whether the throw is one for [`MachineMonitor::observe_outdated`].
    pub is_outdated: bool,
}

/// The effect of the boot of a throw.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BootCheck {
    /// A sentence about two loggers that publish as this machine: the throw is no evidence about the machine. `None`
    /// for one logger.
    pub two_loggers: Option<String>,
    /// The command of a new baseline, if one was started.
    pub command: Option<Command>,
}

impl MachineMonitor {
    /// Applies the liveliness of the logger, `there`: whether its token exists. A logger that never declared a token
    /// raises no alarm. Call it before each [`Self::tick`].
    pub fn logger(&mut self, there: bool, now: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        self.step(now, None, settings, |operation, step| operation.on_liveliness(there, step))
    }

    /// Whether the logger has declared a token, even if the token is gone now.
    pub fn is_announced(&self) -> bool {
        self.operation.is_announced()
    }

    /// Whether nothing of a logger was ever received, as for the monitor of a daemon: no throw, no token, and no
    /// message that shows a gap before it.
    pub fn has_no_logger(&self) -> bool {
        self.order == 0 && self.unread.is_none() && !self.is_announced() && !self.operation.has_gap()
    }

    /// Applies a gap: throws that never arrived.
    pub fn gap(&mut self, missing: Missing, at: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        self.step(at, None, settings, |operation, step| operation.on_gap(missing, step))
    }

    /// Checks the clock of the logger at a throw, before its observation, whose verdict has the events.
    ///
    /// Without `received_at` the clock of this computer is not trusted, and the logger's clock is wrong only if its
    /// time is impossible. `is_behind`: a comparison with other loggers shows that this clock is behind.
    pub fn date(
        &mut self,
        throw: &ThrowRef,
        started_at: Timestamp,
        received_at: Option<Timestamp>,
        is_behind: bool,
        settings: &Settings,
    ) -> Dated {
        let is_wrong = self.clock.is_wrong(throw, started_at, received_at, is_behind);
        let at = received_at.filter(|_| is_wrong).unwrap_or(started_at);
        if self.maintenance.is_none() {
            let Self { alarms, name, clock, .. } = self;
            clock.judge(started_at, &mut Step { alarms, name, at: to_micros(at), throw: Some(throw), settings });
        }
        let is_outdated = |since| self.clock.is_before(since, started_at, received_at);
        let is_outdated = self.in_service_since.is_some_and(is_outdated);
        Dated { at, is_outdated }
    }

    /// Whether throws that the logger makes before a new baseline, and sends after it, will be recognised.
    pub fn dates_a_backlog(&self) -> bool {
        self.clock.dates_a_backlog()
    }

    /// Applies an irregularity of the logger; `throw` is the throw that shows it, `None` if no throw does.
    pub fn irregular(
        &mut self,
        irregularity: Irregularity,
        throw: Option<&ThrowRef>,
        at: Timestamp,
        settings: &Settings,
    ) -> Vec<AlarmEvent> {
        if self.maintenance.is_some() {
            return Vec::new();
        }
        self.step(at, throw, settings, |operation, step| operation.on_irregularity(irregularity, step))
    }

    /// Applies the boot of a throw, dated `at` by [`Self::date`], before its observation, whose verdict has the events:
    /// shows whether two loggers publish as this machine.
    ///
    /// Without `received_at` the clock of this computer is not trusted, and two loggers cannot be detected.
    pub fn boot(
        &mut self,
        throw: &ThrowRef,
        started_at: Timestamp,
        received_at: Option<Timestamp>,
        at: Timestamp,
        settings: &Settings,
    ) -> BootCheck {
        let had_two = self.boots.two().is_some();
        if let Some(received_at) = received_at {
            self.boots.follow(throw, started_at, received_at);
        }
        let at = to_micros(at);
        let Some(since) = self.boots.two().map(|two| two.since) else {
            if had_two {
                self.end_two_loggers(text::ONE_LOGGER, at);
            }
            return BootCheck::default();
        };
        let command = if had_two { None } else { self.forget_since(since, at, settings) };
        let two_loggers = self.two_loggers();
        if let Some(text) = two_loggers.clone().filter(|_| self.maintenance.is_none()) {
            let Self { alarms, name, .. } = self;
            not_monitored(Rule::TwoLoggers, None, text, &mut Step { alarms, name, at, throw: Some(throw), settings });
        }
        BootCheck { two_loggers, command }
    }

    /// Forgets the boots before a new baseline.
    pub(super) fn forget_boots(&mut self, now: Timestamp) {
        if self.boots.two().is_some() {
            self.end_two_loggers(text::CHECKED_ANEW, now);
        }
        self.boots = Boots::default();
    }

    /// Ends the alarm about two loggers with this text: from now on the throws show whether the machine is monitored.
    fn end_two_loggers(&mut self, text: &str, now: Timestamp) {
        self.operation.reset();
        if self.alarms.owned_by(Rule::TwoLoggers).is_some() {
            self.alarms.clear(Cause::NotMonitored, text::machine(&self.name, text), now);
        }
    }

    /// The sentence about two loggers that publish as this machine; `None` for one logger.
    pub(super) fn two_loggers(&self) -> Option<String> {
        let two = self.boots.two()?;
        Some(text::two_loggers(&self.name, &two.boots, boots::ALONE.as_hours()))
    }

    /// Forgets the throws of two loggers `since` a time: the last throws, the alarms that they raised, and an
    /// incomplete baseline. Returns the command of the new baseline.
    fn forget_since(&mut self, since: Timestamp, now: Timestamp, settings: &Settings) -> Option<Command> {
        let is_begun = |direction| {
            let (throws, needed) = self.instruments.gauges.progress(direction);
            (1..needed).contains(&throws)
        };
        let learns_features = !self.tracks.any_baseline() && Direction::BOTH.into_iter().any(is_begun);
        if learns_features || self.tracks.is_learning(settings) {
            let (by, why) = ("pointsd", "two loggers published as this machine while its baseline was learned");
            self.rebaseline(by, why, Actor::default(), now);
            return Some(Command::Rebaseline { by: by.to_owned(), why: why.to_owned() });
        }
        self.forget_recent(now);
        let is_of_two = |event: &AlarmEvent| {
            event.raised_at >= since && (event.cause.is_drift() || event.cause == Cause::SlowThrow)
        };
        self.clear_all(is_of_two, &text::machine(&self.name, text::CHECKED_ANEW), now);
        None
    }
}
