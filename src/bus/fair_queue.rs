//! The queue of the inbox, with limited memory. It serves the keys in turn, and limits the share of each key, so a
//! flood with one key neither delays nor displaces the messages with other keys.

use std::{
    collections::VecDeque,
    hash::{BuildHasher, RandomState},
};

use parking_lot::Mutex;

use super::message::Message;

/// Capacity \[bytes\]: about one second of throws of 40 kB at the measured rate of the database.
const CAPACITY: usize = 128 << 20;
/// Least memory that a message counts \[bytes\]: limits the number of small messages.
const LEAST_COST: usize = 8 << 10;
/// Largest memory of one key while more than half of the capacity is in use \[bytes\]: 64 throws of 64 kB.
const SHARE: usize = CAPACITY / 32;
/// Number of slots. A key belongs to the slot of its hash; keys of one slot share its turn and its memory.
const SLOTS: usize = 1_024;

/// Received messages that are not stored yet.
#[derive(Debug, Default)]
pub(super) struct FairQueue {
    queues: Mutex<Queues>,
    /// Random, so that a sender cannot choose a key in the slot of another key.
    hasher: RandomState,
}

#[derive(Debug)]
struct Queues {
    /// Bytes in use by all slots.
    reserved: usize,
    slots: Vec<Slot>,
    /// Slots with messages, in the order of their turns.
    turns: VecDeque<usize>,
}

#[derive(Debug, Default)]
struct Slot {
    reserved: usize,
    /// The messages, with the bytes reserved for each.
    messages: VecDeque<(usize, Message)>,
}

impl Default for Queues {
    fn default() -> Self {
        Self { reserved: 0, slots: (0..SLOTS).map(|_| Slot::default()).collect(), turns: VecDeque::new() }
    }
}

impl Queues {
    /// Reserves memory; false if the capacity or the share of the slot is used up.
    fn reserve(&mut self, slot: usize, cost: usize) -> bool {
        let (all, own) = (self.reserved + cost, self.slots[slot].reserved + cost);
        let is_fair = all <= CAPACITY / 2 || own <= SHARE || own == cost;
        let fits = all <= CAPACITY && is_fair;
        if fits {
            (self.reserved, self.slots[slot].reserved) = (all, own);
        }
        fits
    }
}

impl FairQueue {
    /// Memory of the queued messages \[bytes\].
    pub(super) fn bytes(&self) -> usize {
        self.queues.lock().reserved
    }

    /// Queues a message of this key and size; false if the capacity or the share of the key is used up.
    pub(super) fn push(&self, key: &str, memory: usize, message: impl FnOnce() -> Message) -> bool {
        let (slot, cost) = (self.slot(key), memory.max(LEAST_COST));
        if !self.queues.lock().reserve(slot, cost) {
            return false;
        }
        // The payload is copied while the lock is free.
        let message = message();
        let mut queues = self.queues.lock();
        if queues.slots[slot].messages.is_empty() {
            queues.turns.push_back(slot);
        }
        queues.slots[slot].messages.push_back((cost, message));
        true
    }

    /// Removes the oldest message of the next slot.
    pub(super) fn pop(&self) -> Option<Message> {
        let mut queues = self.queues.lock();
        let at = queues.turns.pop_front()?;
        let slot = &mut queues.slots[at];
        let (cost, message) = slot.messages.pop_front()?;
        slot.reserved -= cost;
        if !slot.messages.is_empty() {
            queues.turns.push_back(at);
        }
        queues.reserved -= cost;
        Some(message)
    }

    #[expect(clippy::cast_possible_truncation, reason = "a remainder below SLOTS")]
    fn slot(&self, key: &str) -> usize {
        (self.hasher.hash_one(key) % SLOTS as u64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest number of messages in the queue.
    const MAX_MESSAGES: usize = CAPACITY / LEAST_COST;

    /// Queues a message with this memory.
    fn push(queue: &FairQueue, key: &str, memory: usize) -> bool {
        let message = || Message {
            is_delete: false,
            key: key.to_owned(),
            content_type: String::new(),
            payload: vec![0; memory.saturating_sub(key.len())],
            bytes: memory,
        };
        queue.push(key, message().memory(), message)
    }

    /// Keys in slots of their own.
    fn keys<const N: usize>(queue: &FairQueue) -> [String; N] {
        let mut taken = std::collections::HashSet::new();
        let mut apart = (0..).map(|number| format!("key {number}")).filter(|key| taken.insert(queue.slot(key)));
        std::array::from_fn(|_| apart.next().unwrap())
    }

    #[test]
    fn keys_take_turns() {
        let queue = FairQueue::default();
        let [flood, calm] = &keys(&queue);
        for (key, bytes) in (10..110).map(|number| (flood, number)).chain([(calm, 100), (calm, 101)]) {
            assert!(push(&queue, key, bytes));
        }
        let first: Vec<usize> = (0..4).map(|_| queue.pop().unwrap().bytes).collect();
        assert_eq!(first, [10, 100, 11, 101]);
        assert_eq!((std::iter::from_fn(|| queue.pop()).count(), queue.bytes()), (98, 0));
    }

    #[test]
    fn one_key_leaves_half_of_the_capacity_to_the_others() {
        let queue = FairQueue::default();
        let flood = (0..2 * MAX_MESSAGES).filter(|_| push(&queue, "flood", 40)).count();
        assert_eq!(flood, MAX_MESSAGES / 2);
        let others = (0..8).map(|other| (0..1_000).filter(|_| push(&queue, &format!("other {other}"), 40)).count());
        // A key that shares its slot with another key gets less memory: by chance, this may be two of the eight keys.
        assert!(others.filter(|&taken| taken == SHARE / LEAST_COST).count() >= 6);
        queue.pop();
        assert!(!push(&queue, "flood", 40), "it still has more than its share");
    }

    #[test]
    fn the_capacity_is_a_limit_and_freed_memory_is_used_again() {
        let queue = FairQueue::default();
        let taken = (0..10 * MAX_MESSAGES).filter(|number| push(&queue, &number.to_string(), 0)).count();
        assert!(taken <= MAX_MESSAGES && taken > MAX_MESSAGES / 2, "{taken} messages");
        let large = FairQueue::default();
        let [a, b, c, d] = &keys(&large);
        let sizes = [(a, CAPACITY / 2), (b, CAPACITY / 4), (c, CAPACITY / 4), (d, 1)];
        assert_eq!(sizes.map(|(key, bytes)| push(&large, key, bytes)), [true, true, true, false]);
        assert_eq!(large.pop().unwrap().key, *a);
        assert!(push(&large, d, 1));
        assert_eq!(large.bytes(), CAPACITY / 2 + LEAST_COST);
    }
}
