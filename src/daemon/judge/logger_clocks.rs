//! Comparison of this computer's clock with the clocks of the loggers.
//!
//! The logger dates a throw, and this computer notes when it received it. A throw that is received before its date
//! shows that one of the two clocks is wrong. An old throw shows nothing by itself, as it may come from a backlog or a
//! recording. But if the throws of a logger are all equally old, and are received minutes apart, then the logger
//! publishes each at once. Then its clock is behind, or that of this computer is ahead. If most loggers are behind by
//! the same time, this computer is ahead.

use std::collections::VecDeque;

use jiff::{SignedDuration, Timestamp};

use crate::{diagnose::are_steady, throw::MachineId};

/// Largest number of compared loggers.
const LOGGERS: usize = 32;
/// Least difference that counts: a smaller one may be a wrong time zone.
const DAY: SignedDuration = SignedDuration::from_hours(24);
/// Least time between two receptions whose ages are compared: throws of a backlog arrive faster.
const APART: SignedDuration = SignedDuration::from_mins(1);
/// Largest difference of the ages of loggers that count as behind by the same time.
const SAME: SignedDuration = SignedDuration::from_hours(1);

/// The machines whose throws were judged last, the newest first, with the clocks of their loggers.
#[derive(Debug, Default)]
pub(crate) struct LoggerClocks(VecDeque<Logger>);

/// The clock of this computer, compared with the date of a throw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OwnClock {
    /// The throw is dated at most a day ahead, or most of the other loggers do not date ahead.
    Plausible,
    /// The throw is dated more than a day ahead, as are the throws of at least half of the other loggers.
    Behind,
    /// The throw is dated more than a day ahead, and no other logger is known.
    Unconfirmed,
}

#[derive(Debug)]
struct Logger {
    machine: MachineId,
    /// Whether the last throw is dated more than a day after its reception.
    is_ahead: bool,
    /// Time of reception of an earlier throw, to compare with the next one.
    received_at: Timestamp,
    /// Age of that throw at its reception.
    age: SignedDuration,
    /// Age of the throws, if they are published at once and a day old or more.
    behind: Option<SignedDuration>,
}

impl LoggerClocks {
    /// Notes the date and the reception of a throw, and compares the clock of this computer with them.
    pub(crate) fn note(&mut self, machine: &MachineId, started_at: Timestamp, received_at: Timestamp) -> OwnClock {
        let before = self.0.iter().position(|logger| logger.machine == *machine).and_then(|at| self.0.remove(at));
        let (others, others_ahead) = (self.0.len(), self.0.iter().filter(|logger| logger.is_ahead).count());
        let age = received_at.duration_since(started_at);
        let is_ahead = age < -DAY;
        let new = Logger { machine: machine.clone(), is_ahead, received_at, age, behind: None };
        self.0.push_front(match before {
            Some(before) => {
                let apart = received_at.duration_since(before.received_at);
                if apart.abs() < APART {
                    Logger { is_ahead, ..before }
                } else {
                    let is_steady = are_steady([before.age, age], apart);
                    Logger { behind: (is_steady && age >= DAY).then_some(age), ..new }
                }
            }
            None => new,
        });
        self.0.truncate(LOGGERS);
        if !is_ahead {
            OwnClock::Plausible
        } else if others == 0 {
            OwnClock::Unconfirmed
        } else if 2 * others_ahead < others {
            OwnClock::Plausible
        } else {
            OwnClock::Behind
        }
    }

    /// Number of loggers that date their throws a day or more after this computer; 0 if they are not the majority, or a
    /// single logger, whose own clock may be wrong.
    pub(crate) fn ahead(&self) -> usize {
        self.if_most(self.0.iter().filter(|logger| logger.is_ahead).count())
    }

    /// Number of loggers that date their throws a day or more before this computer, all by the same time; 0 as for
    /// [`Self::ahead`].
    pub(crate) fn behind(&self) -> usize {
        let mut behind: Vec<SignedDuration> = self.0.iter().filter_map(|logger| logger.behind).collect();
        behind.sort_unstable();
        let Some(median) = behind.get(behind.len() / 2).copied() else { return 0 };
        let same = behind.iter().filter(|age| (**age - median).abs() <= SAME).count();
        self.if_most(same)
    }

    /// Whether the clock of the logger that was noted last is a day or more behind. Its throws must be published at
    /// once, and another logger must be right. Loggers that count in [`Self::behind`] show that this computer is ahead
    /// instead.
    pub(crate) fn is_last_behind(&self) -> bool {
        let Some(last) = self.0.front().filter(|last| last.behind.is_some()) else { return false };
        let is_right = |other: &Logger| {
            // Not an old reception: the clock of this computer may have jumped since.
            other.age.abs() < DAY && last.received_at.duration_since(other.received_at) < DAY
        };
        self.behind() == 0 && self.0.iter().skip(1).any(is_right)
    }

    fn if_most(&self, count: usize) -> usize {
        if count > 1 && 2 * count > self.0.len() { count } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers of loggers ahead and behind after some throws of three loggers. Each throw has its start and its
    /// reception \[s\].
    fn loggers(throws: impl IntoIterator<Item = [(i64, i64); 3]>) -> (usize, usize) {
        let mut clocks = LoggerClocks::default();
        let at = |seconds: i64| Timestamp::from_second(1_800_000_000 + seconds).unwrap();
        for throws in throws {
            for (name, (started, received)) in ["a", "b", "c"].into_iter().zip(throws) {
                clocks.note(&MachineId::new("north", name).unwrap(), at(started), at(received));
            }
        }
        (clocks.ahead(), clocks.behind())
    }

    #[test]
    fn a_computer_that_is_ahead_is_found_from_live_throws() {
        const AHEAD: i64 = 3 * 86_400;
        let throw = |at: i64| [at, at + 40, at + 900].map(|at| (at, at + AHEAD + 7));
        assert_eq!(loggers([throw(0)]), (0, 0), "one old throw of each may be from a backlog");
        assert_eq!(loggers([throw(0), throw(600)]), (0, 3));
        assert_eq!(loggers([throw(0), throw(20), throw(600)]), (0, 3), "there and back");
        let correct = |at: i64| [at; 3].map(|at| (at, at + 7));
        assert_eq!(loggers([throw(0), throw(600), correct(1_200), correct(1_800)]), (0, 0), "the clock was corrected");
        let behind = |at: i64| [at; 3].map(|at| (at, at - AHEAD));
        assert_eq!(loggers([behind(0), behind(600)]), (3, 0));
    }

    #[test]
    fn a_logger_that_is_behind_alone_is_wrong_itself() {
        let mut clocks = LoggerClocks::default();
        let at = |seconds: i64| Timestamp::from_second(1_800_000_000 + seconds).unwrap();
        let mut is_behind = |name: &str, age: i64, received: i64| {
            clocks.note(&MachineId::new("north", name).unwrap(), at(received - age), at(received));
            clocks.is_last_behind()
        };
        assert!(!is_behind("a", 3 * 86_400, 0) && !is_behind("a", 3 * 86_400, 600), "no other logger is known");
        assert!(!is_behind("b", 5, 700));
        assert!(is_behind("a", 3 * 86_400, 1_200));
        assert!(!is_behind("a", 5, 1_800), "its clock was corrected");
        assert!(!is_behind("a", 3 * 86_400, 2_400) && !is_behind("a", 3 * 86_400 - 600, 2_410), "a backlog");
        assert!(
            !is_behind("a", 3 * 86_400, 200_000) && !is_behind("a", 3 * 86_400, 200_600),
            "the other was right long ago"
        );
    }

    #[test]
    fn old_throws_and_loggers_that_are_wrong_themselves_show_nothing() {
        const OLD: i64 = 100 * 86_400;
        let backlog = |at: i64| [(at - OLD, at / 600); 3];
        assert_eq!(loggers((0..50).map(|at| backlog(600 * at))), (0, 0), "one throw in a second");
        let slow = |at: i64| [(at - OLD, at / 3); 3];
        assert_eq!(loggers((0..50).map(|at| slow(600 * at))), (0, 0), "three times as fast as they were made");
        let wrong = |at: i64| [OLD, 2 * OLD, 0].map(|age| (at - age, at));
        assert_eq!(loggers([wrong(0), wrong(600)]), (0, 0), "each by another time");
        let one = |at: i64| [OLD, 0, 0].map(|age| (at - age, at));
        assert_eq!(loggers([one(0), one(600)]), (0, 0), "one alone");
        let mut clocks = LoggerClocks::default();
        let now = Timestamp::from_second(1_800_000_000).unwrap();
        clocks.note(&MachineId::new("north", "a").unwrap(), now + 3 * DAY, now);
        assert_eq!(clocks.ahead(), 0, "the only one, ahead");
    }
}
