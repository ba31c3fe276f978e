//! Memory budget of the inbox, shared fairly: one key cannot use the share of the others.

use std::{
    hash::{BuildHasher, RandomState},
    sync::atomic::{AtomicUsize, Ordering::Relaxed},
};

/// Capacity \[bytes\]: about one second of 40 kB throws at the measured rate of the database.
const CAPACITY: usize = 128 << 20;
/// Least cost of a message \[bytes\]: bounds the number of small messages.
const LEAST_COST: usize = 8 << 10;
/// Largest number of messages in the inbox.
#[cfg(test)]
const MAX_MESSAGES: usize = CAPACITY / LEAST_COST;
/// Share of one key while more than half of the capacity is in use \[bytes\]: 64 throws of 64 kB.
const SHARE: usize = CAPACITY / 32;
/// Counters of keys, addressed by hash; keys with the same hash share one counter.
pub(super) const SLOTS: usize = 1_024;

/// Bytes in use, in total and for each slot of keys.
#[derive(Debug)]
pub(super) struct QueueBudget {
    reserved: AtomicUsize,
    slots: Vec<AtomicUsize>,
    /// Random, so that a sender cannot choose a key with the hash of another key.
    hasher: RandomState,
}

impl QueueBudget {
    pub(super) fn new() -> Self {
        let slots = (0..SLOTS).map(|_| AtomicUsize::new(0)).collect();
        Self { reserved: AtomicUsize::new(0), slots, hasher: RandomState::new() }
    }

    /// Bytes in use.
    pub(super) fn reserved(&self) -> usize {
        self.reserved.load(Relaxed)
    }

    /// Reserves memory for a message; false if the capacity or the share of the key is used up.
    pub(super) fn reserve(&self, key: &str, bytes: usize) -> bool {
        let cost = bytes.max(LEAST_COST);
        let all = self.reserved.fetch_add(cost, Relaxed) + cost;
        let own = self.slot(key).fetch_add(cost, Relaxed) + cost;
        let fair = all <= CAPACITY / 2 || own <= SHARE || own == cost;
        if all <= CAPACITY && fair {
            return true;
        }
        self.reserved.fetch_sub(cost, Relaxed);
        self.slot(key).fetch_sub(cost, Relaxed);
        false
    }

    /// Releases the memory of a message.
    pub(super) fn release(&self, key: &str, bytes: usize) {
        let cost = bytes.max(LEAST_COST);
        self.slot(key).fetch_sub(cost, Relaxed);
        self.reserved.fetch_sub(cost, Relaxed);
    }

    #[expect(clippy::cast_possible_truncation, reason = "a remainder below SLOTS")]
    pub(super) fn slot_number(&self, key: &str) -> usize {
        (self.hasher.hash_one(key) % SLOTS as u64) as usize
    }

    fn slot(&self, key: &str) -> &AtomicUsize {
        &self.slots[self.slot_number(key)]
    }
}

impl Default for QueueBudget {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_key_leaves_half_of_the_room_to_the_others() {
        let budget = QueueBudget::new();
        let flood = (0..2 * MAX_MESSAGES).filter(|_| budget.reserve("flood", 40)).count();
        assert_eq!(flood, MAX_MESSAGES / 2);
        let others = (0..8).map(|other| (0..1_000).filter(|_| budget.reserve(&format!("other {other}"), 40)).count());
        // Every key gets its share, except those in the slot of the flood.
        assert!(others.filter(|&taken| taken == SHARE / LEAST_COST).count() >= 6);
        budget.release("flood", 40);
        assert!(!budget.reserve("flood", 40), "it still has more than its share");
    }

    #[test]
    fn the_room_has_an_end_and_what_is_given_back_can_be_taken_again() {
        let budget = QueueBudget::new();
        let taken = (0..10 * MAX_MESSAGES).filter(|number| budget.reserve(&number.to_string(), 0)).count();
        assert!(taken <= MAX_MESSAGES && taken > MAX_MESSAGES / 2, "{taken} messages");
        let large = QueueBudget::new();
        let sizes = [("a", CAPACITY / 2), ("b", CAPACITY / 4), ("c", CAPACITY / 4), ("d", 1)];
        assert_eq!(sizes.map(|(key, bytes)| large.reserve(key, bytes)), [true, true, true, false]);
        large.release("c", CAPACITY / 4);
        assert!(large.reserve("d", 1));
        assert_eq!(large.reserved(), CAPACITY / 4 * 3 + LEAST_COST);
    }
}
