//! Room for messages that wait, shared so that whoever fills it leaves some for the others.

use std::{
    hash::{BuildHasher, RandomState},
    sync::{
        Condvar, Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering::Relaxed},
    },
    time::Duration,
};

/// All there is \[bytes\]: about a second of the database's measured rate of 40 kB throws.
const ROOM: usize = 128 << 20;
/// What a message takes at least \[bytes\]: bounds the number of small ones.
const LEAST: usize = 8 << 10;
/// Most messages that there can be.
pub(super) const MESSAGES: usize = ROOM / LEAST;
/// Above half of the room, what one key may take \[bytes\]: 64 throws of 64 kB, as a logger's cache sends them after a
/// cut.
const SHARE: usize = ROOM / 32;
/// Keys are told apart by their hash: two that fall together share their part.
const PARTS: usize = 1_024;

/// When nothing is given back for so long, the database takes nothing, and waiting is of no use.
const STALLED: Duration = Duration::from_millis(500);
/// How often a message may wait for room until all of it is free again: several times what the caches of a cabinet's
/// loggers send to a daemon that starts. Who sends without end is not waited for any longer than that.
const PATIENCE: usize = 100_000;

/// The room and who has how much of it.
#[derive(Debug)]
pub(super) struct Room {
    taken: AtomicUsize,
    parts: Vec<AtomicUsize>,
    patience: AtomicUsize,
    waiting: Mutex<()>,
    freed: Condvar,
    /// Keyed at random, so that nobody can choose a key that falls together with another's.
    hasher: RandomState,
}

impl Room {
    pub(super) fn new() -> Self {
        let parts = (0..PARTS).map(|_| AtomicUsize::new(0)).collect();
        Self {
            taken: AtomicUsize::new(0),
            parts,
            patience: AtomicUsize::new(PATIENCE),
            waiting: Mutex::new(()),
            freed: Condvar::new(),
            hasher: RandomState::new(),
        }
    }

    /// What is taken \[bytes\].
    pub(super) fn taken(&self) -> usize {
        self.taken.load(Relaxed)
    }

    /// Takes room for a message, and waits for it while the database takes messages: a logger's link slows down then, and
    /// nothing of a burst is lost. False when there is none, or none for more messages of this key.
    pub(super) fn wait_for(&self, key: &str, bytes: usize) -> bool {
        if self.take(key, bytes) {
            return true;
        }
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        while !self.take(key, bytes) {
            if self.patience.try_update(Relaxed, Relaxed, |left| left.checked_sub(1)).is_err() {
                return false;
            }
            let (still, timeout) = self.freed.wait_timeout(waiting, STALLED).unwrap_or_else(PoisonError::into_inner);
            if timeout.timed_out() {
                self.patience.store(0, Relaxed);
            }
            waiting = still;
        }
        true
    }

    fn take(&self, key: &str, bytes: usize) -> bool {
        let cost = bytes.max(LEAST);
        let all = self.taken.fetch_add(cost, Relaxed) + cost;
        let own = self.part(key).fetch_add(cost, Relaxed) + cost;
        let fair = all <= ROOM / 2 || own <= SHARE || own == cost;
        if all <= ROOM && fair {
            return true;
        }
        self.taken.fetch_sub(cost, Relaxed);
        self.part(key).fetch_sub(cost, Relaxed);
        false
    }

    /// Gives back what was taken for a message.
    pub(super) fn give_back(&self, key: &str, bytes: usize) {
        let cost = bytes.max(LEAST);
        self.part(key).fetch_sub(cost, Relaxed);
        if self.taken.fetch_sub(cost, Relaxed) == cost {
            self.patience.store(PATIENCE, Relaxed);
        }
        // Whoever looked just before this waits by now.
        drop(self.waiting.lock());
        self.freed.notify_all();
    }

    #[expect(clippy::cast_possible_truncation, reason = "a remainder below PARTS")]
    fn part(&self, key: &str) -> &AtomicUsize {
        &self.parts[(self.hasher.hash_one(key) % PARTS as u64) as usize]
    }
}

impl Default for Room {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    #[test]
    fn one_key_leaves_half_of_the_room_to_the_others() {
        let room = Room::new();
        let flood = (0..2 * MESSAGES).filter(|_| room.take("flood", 40)).count();
        assert_eq!(flood, MESSAGES / 2);
        let others = (0..8).map(|other| (0..1_000).filter(|_| room.take(&format!("other {other}"), 40)).count());
        // All but those who fall together with the flood have their share.
        assert!(others.filter(|&taken| taken == SHARE / LEAST).count() >= 6);
        room.give_back("flood", 40);
        assert!(!room.take("flood", 40), "it still has more than its share");
    }

    #[test]
    fn the_room_has_an_end_and_what_is_given_back_can_be_taken_again() {
        let room = Room::new();
        let taken = (0..10 * MESSAGES).filter(|number| room.take(&number.to_string(), 0)).count();
        assert!(taken <= MESSAGES && taken > MESSAGES / 2, "{taken} messages");
        let large = Room::new();
        let sizes = [("a", ROOM / 2), ("b", ROOM / 4), ("c", ROOM / 4), ("d", 1)];
        assert_eq!(sizes.map(|(key, bytes)| large.take(key, bytes)), [true, true, true, false]);
        large.give_back("c", ROOM / 4);
        assert!(large.take("d", 1));
        assert_eq!(large.taken(), ROOM / 4 * 3 + LEAST);
    }

    #[test]
    fn a_message_waits_for_room_that_is_given_back_and_not_for_a_store_that_hangs() {
        let room = Room::new();
        assert!(room.wait_for("a", ROOM / 2) && room.wait_for("b", ROOM / 2));
        thread::scope(|scope| {
            let waits = scope.spawn(|| room.wait_for("c", 1));
            while room.patience.load(Relaxed) == PATIENCE {
                thread::yield_now();
            }
            room.give_back("b", ROOM / 2);
            assert!(waits.join().unwrap());
        });
        assert!(room.wait_for("b", ROOM / 2 - LEAST));
        assert!(!room.wait_for("d", 1), "nothing is given back");
        assert_eq!(room.patience.load(Relaxed), 0, "the next one does not wait");
        room.give_back("a", ROOM / 2);
        room.give_back("b", ROOM / 2 - LEAST);
        room.give_back("c", 1);
        assert_eq!((room.taken(), room.patience.load(Relaxed)), (0, PATIENCE));
    }
}
