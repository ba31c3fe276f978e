//! Detects two loggers that publish as one machine, from the boots of their throws. A boot is a run of a logger, from
//! one start to the next.
//!
//! After a restart, a logger makes no throws in an older boot. So the boots of one logger never alternate in the order
//! in which their throws were made. In the order of reception they may: pages of a backlog, messages that a router kept
//! and repeated messages arrive late. The delay of a throw, from its date to its reception, distinguishes the two
//! cases: a late throw has a longer delay. Delays are compared only within a boot, so the clocks need not be right. A
//! jump of a clock is no evidence.
//!
//! A throw is *live* if it has the same delay as the throw of its boot before it, which was received well before. If
//! live throws of two boots alternate [`TURNS`] times, they come from two loggers.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use crate::throw::ThrowRef;

/// Number of boots that are stored: two loggers with one restart each.
const BOOTS: usize = 4;
/// Largest difference between the delays of two live throws: a throw may last longer than another, and its message may
/// wait for the link.
const SAME_DELAY: SignedDuration = SignedDuration::from_secs(30);
/// Least time between the receptions of two throws whose delays are compared, and between two turns. Within a shorter
/// time, late throws of one page have equal delays too.
const APART: SignedDuration = SignedDuration::from_mins(1);
/// Number of turns, from a live throw of one boot to a live throw of another, that show two loggers. A late throw of an
/// old boot may have the delay of the throw before it by chance. It gives two turns: its own, and that of the next
/// throw of the new boot.
const TURNS: u32 = 3;
/// Time without a turn after which only one logger publishes: a machine in use makes throws on most days.
pub(crate) const ALONE: SignedDuration = SignedDuration::from_hours(24);

/// A boot and its last throw.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Boot {
    id: Box<str>,
    /// Time of its first throw, or of the reception of this throw if that is earlier.
    since: Timestamp,
    started_at: Timestamp,
    received_at: Timestamp,
    /// Reception of the first live throw of another boot since the last throw of this one.
    #[serde(skip_serializing_if = "Option::is_none")]
    crossed_at: Option<Timestamp>,
}

/// Two loggers that publish as one machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct TwoLoggers {
    /// The boot ids of the two loggers, the earlier boot first.
    pub(crate) boots: [String; 2],
    /// Time of the first throw of the later boot.
    pub(crate) since: Timestamp,
}

/// The last boots of a machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Boots {
    /// The boots in the order of their last throws.
    last: Vec<Boot>,
    /// Boxed, as few machines have turns.
    #[serde(skip_serializing_if = "Option::is_none")]
    turns: Option<Box<Turns>>,
}

/// The turns between live throws of different boots.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Turns {
    count: u32,
    /// Reception of the throw of the last turn.
    last_at: Timestamp,
    two: Option<TwoLoggers>,
}

impl Boots {
    /// Applies a throw; throws come in the order in which they are judged.
    pub(crate) fn follow(&mut self, throw: &ThrowRef, started_at: Timestamp, received_at: Timestamp) {
        let known = self.last.iter().position(|boot| *boot.id == throw.boot_id);
        let last = known.map(|at| self.last.remove(at));
        let is_live = last.as_ref().is_some_and(|last| {
            let received = received_at.duration_since(last.received_at);
            let made = started_at.duration_since(last.started_at);
            received > APART && (received - made).abs() <= SAME_DELAY
        });
        let crossed_at = last.as_ref().and_then(|last| last.crossed_at).filter(|_| is_live);
        let first = started_at.min(received_at);
        let since = last.map_or(first, |last| last.since);
        if is_live {
            self.last.iter_mut().for_each(|other| _ = other.crossed_at.get_or_insert(received_at));
        }
        if crossed_at.is_some_and(|at| received_at.duration_since(at) > APART) {
            let turns = self.turns.get_or_insert_with(|| Box::new(Turns { count: 0, last_at: received_at, two: None }));
            (turns.count, turns.last_at) = (turns.count.saturating_add(1), received_at);
            if let Some(other) = self.last.last().filter(|_| turns.count >= TURNS) {
                let mut boots = [(other.since, other.id.to_string()), (since, throw.boot_id.clone())];
                boots.sort();
                turns.two = Some(TwoLoggers { since: boots[1].0, boots: boots.map(|(_, id)| id) });
            }
        } else if let Some(turns) = &self.turns
            && received_at.duration_since(turns.last_at).abs() >= ALONE
        {
            self.turns = None;
        }
        if self.last.len() == BOOTS {
            self.last.remove(0);
        }
        self.last.reserve_exact(1);
        let id = throw.boot_id.as_str().into();
        self.last.push(Boot { id, since, started_at, received_at, crossed_at: None });
    }

    /// The two loggers that publish at present, if any.
    pub(crate) fn two(&self) -> Option<&TwoLoggers> {
        self.turns.as_ref()?.two.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: Timestamp = Timestamp::constant(1_800_000_000, 0);

    fn minutes(minutes: i64) -> SignedDuration {
        SignedDuration::from_mins(minutes)
    }

    /// Whether two loggers are found after these throws: boot, minute of the reception, and delay \[min\].
    fn finds(throws: impl IntoIterator<Item = (&'static str, i64, i64)>) -> bool {
        let mut boots = Boots::default();
        for (throw_no, (boot_id, received, delay)) in (1..).zip(throws) {
            let throw = ThrowRef { boot_id: boot_id.to_owned(), throw_no };
            let received_at = START + minutes(received);
            boots.follow(&throw, received_at - minutes(delay), received_at);
        }
        boots.two().is_some()
    }

    #[test]
    fn two_loggers_are_found_whatever_their_clocks_say() {
        for (first, second) in [(0, 0), (600, 0), (-600, 0), (0, 3_000_000)] {
            let turns = |throws: i64| {
                finds((0..throws).map(move |k| if k % 2 == 0 { ("a", 10 * k, first) } else { ("b", 10 * k, second) }))
            };
            assert!(turns(6) && !turns(5), "{first} {second}");
        }
        // Both record every throw of the machine, and the same logger always publishes first.
        assert!(finds((0..10).flat_map(|k| [("a", 10 * k, 0), ("b", 10 * k, 0)])));
        // The second logger restarts from time to time.
        let boots = ["b", "c", "d", "e"];
        let restarts = boots.into_iter().flat_map(|boot| ["a", boot, "a", boot, "a", boot]);
        assert!(finds((0..).zip(restarts).map(|(k, boot)| (boot, 10 * k, 0))));
    }

    #[test]
    fn one_logger_is_one_whatever_comes_late() {
        let before = || (0..20).map(|k| ("a", 10 * k, 0));
        // A new boot publishes from minute 200 on. `old` gives minute of reception and delay \[min\] of the throws of
        // the old boot in between.
        let between = |old: fn(i64) -> (i64, i64)| -> Vec<_> {
            let new = (0..40).map(|k| ("b", 200 + 10 * k, 0));
            let old = (0..40).map(move |k| ("a", old(k).0, old(k).1));
            let mut both: Vec<(&str, i64, i64)> = new.chain(old).collect();
            both.sort_by_key(|(_, received, _)| *received);
            before().chain(both).collect()
        };
        let restarts = ["b", "c", "d", "e"].into_iter().flat_map(|boot| [boot; 10]);
        let lives = [
            ("restarts", before().chain((0..).zip(restarts).map(|(k, boot)| (boot, 200 + 10 * k, 0))).collect()),
            // Made every four minutes until minute 196.
            ("late throws", between(|k| (205 + 10 * k, 165 + 6 * k))),
            ("late throws after a jump of the clock", between(|k| (205 + 10 * k, 165 + 6 * k + 60 * (k / 20)))),
            ("slow pages of five throws", between(|k| (205 + 20 * (k / 5), 165 + 20 * (k / 5) - 4 * k))),
            ("a burst", between(|k| (205, 165 - 4 * k))),
        ];
        for (what, life) in lives {
            assert!(!finds(life), "{what}");
        }
        // The same throws if they were live.
        assert!(finds(between(|k| (205 + 10 * k, 0))));
    }

    #[test]
    fn one_logger_alone_ends_it() {
        let turns = (0..8).map(|k| (if k % 2 == 0 { "a" } else { "b" }, 10 * k, 0));
        let alone = |last: i64| (8..=last).map(|k| ("a", 10 * k, 0));
        // The last turn is that of "a" at minute 80.
        assert!(finds(turns.clone().chain(alone(8 + 143))));
        assert!(!finds(turns.clone().chain(alone(8 + 144))));
        // The other logger publishes again: two turns may be those of a late throw, as at the beginning.
        let again = |throws: i64| (0..throws).map(|k| (if k % 2 == 0 { "b" } else { "a" }, 10 * (160 + k), 0));
        let alone_then = |throws| turns.clone().chain(alone(8 + 144)).chain(again(throws));
        assert!(!finds(alone_then(2)) && finds(alone_then(3)));
    }
}
