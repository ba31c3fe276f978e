//! Detects a wrong clock of a logger: one that dates a throw long after its reception, long before the previous throw,
//! or before 2001.
//!
//! Throws of a backlog or a recording may be old, and the clock of simulated machines runs faster than real time. So
//! only a jump of the clock is wrong, and every throw after it until the clock agrees again with the time of reception.
//! A jump back counts only within a boot, as a boot with older dates may be an earlier one from the backlog. Other
//! loggers show whether the clock of a restarted logger is behind.
//!
//! A throw can arrive after a repair and be made before it. Its time shows this if the logger published throws at once
//! before: their age at reception is then the difference of the two clocks.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use crate::{
    diagnose::{
        Cause, SensorChannel,
        alarm::{Rule, Step},
        text,
    },
    throw::ThrowRef,
};

/// Earliest plausible date: a clock without a battery starts in 1970, 1980 or 2000.
const FIRST: Timestamp = Timestamp::constant(978_307_200, 0);
/// Largest difference that is no jump: a wrong time zone makes half a day.
const DAY: SignedDuration = SignedDuration::from_hours(24);
/// Consecutive throws with a wrong clock that raise the alarm: most clocks are set soon after a start.
const IN_A_ROW: u32 = 3;

/// Least time between two receptions whose ages are compared.
const APART: SignedDuration = SignedDuration::from_secs(1);

/// Whether a clock may show this time: not before 2001, and not a day ahead of `now`.
pub(crate) fn is_possible_date(at: Timestamp, now: Timestamp) -> bool {
    at >= FIRST && at.duration_since(now) <= DAY
}

/// State of the clock of a logger.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct LoggerClock {
    /// The last throw with a right clock.
    last: Option<Box<Stamp>>,
    /// Consecutive throws with a wrong clock.
    wrong: u32,
    /// Consecutive throws with a right clock.
    right: u32,
    /// The age of a throw that is published at once; `None` if no throw was shown to be.
    at_once: Option<SignedDuration>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Stamp {
    throw: ThrowRef,
    started_at: Timestamp,
    received_at: Timestamp,
}

impl Stamp {
    fn age(&self) -> SignedDuration {
        self.received_at.duration_since(self.started_at)
    }

    /// The larger age of this throw and the one before, if their ages show that each was published at once.
    fn published_at_once(&self, before: &Self) -> Option<SignedDuration> {
        let apart = self.received_at.duration_since(before.received_at);
        (apart >= APART && are_steady([before.age(), self.age()], apart)).then(|| self.age().max(before.age()))
    }
}

/// Whether the ages of two throws show that each was published at once. Their receptions are `apart`. The ages of
/// throws of a backlog, and of a simulation in fast motion, change by more than a tenth of this time.
pub(crate) fn are_steady([before, after]: [SignedDuration; 2], apart: SignedDuration) -> bool {
    (after - before).abs() * 10 <= apart
}

impl LoggerClock {
    /// Compares the time of a throw with its reception; returns whether the logger's clock is wrong. `received_at` is
    /// `None` if the clock of this computer is not trusted; it then shows nothing about the logger's clock.
    /// `is_behind`: the throws of other loggers show that this clock is behind.
    pub(crate) fn is_wrong(
        &mut self,
        throw: &ThrowRef,
        started_at: Timestamp,
        received_at: Option<Timestamp>,
        is_behind: bool,
    ) -> bool {
        let received_at = received_at.filter(|at| *at >= FIRST);
        let is_wrong = match received_at {
            _ if started_at < FIRST => true,
            None => return false,
            Some(_) if is_behind => true,
            Some(received_at) if self.wrong > 0 => !self.agrees_again(received_at.duration_since(started_at)),
            Some(received_at) => self.jumps(throw, started_at, received_at),
        };
        (self.wrong, self.right) =
            if is_wrong { (self.wrong.saturating_add(1), 0) } else { (0, self.right.saturating_add(1)) };
        if let Some(received_at) = received_at.filter(|_| !is_wrong) {
            let new = Stamp { throw: throw.clone(), started_at, received_at };
            self.at_once = self.last.as_ref().and_then(|last| new.published_at_once(last)).or(self.at_once);
            self.last = Some(Box::new(new));
        }
        is_wrong
    }

    /// Whether it can be known when the throws of a backlog were made.
    pub(crate) fn dates_a_backlog(&self) -> bool {
        self.at_once.is_some()
    }

    /// Whether a throw was certainly made before a time of this computer. Call it after [`Self::is_wrong`].
    pub(crate) fn is_before(&self, time: Timestamp, started_at: Timestamp, received_at: Option<Timestamp>) -> bool {
        let was_late = |age: SignedDuration| self.wrong == 0 && time.duration_since(started_at) > age;
        received_at.is_some_and(|received_at| received_at < time || self.at_once.is_some_and(was_late))
    }

    /// Whether the clock jumped by more than a day since the last throw, away from the time of reception.
    fn jumps(&self, throw: &ThrowRef, started_at: Timestamp, received_at: Timestamp) -> bool {
        let ahead = started_at.duration_since(received_at);
        let Some(last) = &self.last else { return ahead > DAY };
        let made = started_at.duration_since(last.started_at);
        let received = received_at.duration_since(last.received_at);
        let before = last.started_at.duration_since(last.received_at);
        let is_later = last.throw.boot_id == throw.boot_id && last.throw.throw_no < throw.throw_no;
        ahead > DAY && made > DAY + received.max(SignedDuration::ZERO)
            || is_later && made < -DAY && ahead.abs() > before.abs()
    }

    /// Whether a throw received `age` after its time is about as old as the last one with a right clock.
    fn agrees_again(&self, age: SignedDuration) -> bool {
        let before = self.last.as_ref().map(|last| last.age());
        age >= -DAY && before.is_none_or(|before| age <= DAY + before.max(SignedDuration::ZERO))
    }

    /// Raises and clears the alarm about the clock, after [`Self::is_wrong`].
    pub(crate) fn judge(&self, started_at: Timestamp, step: &mut Step) {
        if self.wrong >= IN_A_ROW {
            let event = step.sensor(SensorChannel::Clock, text::wrong_clock(step.name, started_at, step.at));
            step.alarms.raise_another(Rule::Dates, event, self.wrong == IN_A_ROW);
        } else if self.right >= step.settings.off_delay_throws && step.alarms.owned_by(Rule::Dates).is_some() {
            step.clear(Cause::Sensor, |name| text::machine(name, text::RIGHT_CLOCK));
        }
    }
}
