//! The memory of the inbox, shared so that one sender leaves room for the others.

use std::{
    hash::{BuildHasher, RandomState},
    sync::atomic::{AtomicUsize, Ordering::Relaxed},
};

/// Capacity \[bytes\]: about a second of the database's measured rate of 40 kB throws.
const ROOM: usize = 128 << 20;
/// Least size that a message counts with \[bytes\]: bounds the number of small messages.
pub(super) const LEAST: usize = 8 << 10;
/// Most messages in the inbox.
pub(super) const MESSAGES: usize = ROOM / LEAST;
/// Share of one key once half of the capacity is taken \[bytes\]: 64 throws of 64 kB.
const SHARE: usize = ROOM / 32;
/// Keys are counted by their hash: two keys with the same hash share one part.
const PARTS: usize = 1_024;

/// The capacity, and how much of it each key has taken.
#[derive(Debug)]
pub(super) struct Room {
    taken: AtomicUsize,
    parts: Vec<AtomicUsize>,
    /// Keyed at random, so that a sender cannot choose a key with the hash of another.
    hasher: RandomState,
}

impl Room {
    pub(super) fn new() -> Self {
        let parts = (0..PARTS).map(|_| AtomicUsize::new(0)).collect();
        Self { taken: AtomicUsize::new(0), parts, hasher: RandomState::new() }
    }

    /// Bytes that are taken.
    pub(super) fn taken(&self) -> usize {
        self.taken.load(Relaxed)
    }

    /// Takes room for a message. False when all is taken, or this key has its share.
    pub(super) fn take(&self, key: &str, bytes: usize) -> bool {
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

    /// Gives the room of a message back.
    pub(super) fn give_back(&self, key: &str, bytes: usize) {
        let cost = bytes.max(LEAST);
        self.part(key).fetch_sub(cost, Relaxed);
        self.taken.fetch_sub(cost, Relaxed);
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
}
