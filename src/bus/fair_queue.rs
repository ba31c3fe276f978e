//! The queue of the inbox. It serves the keys in turn, so that a flood with one key does not delay others.

use std::{
    collections::VecDeque,
    sync::{Mutex, PoisonError},
};

use super::{
    message::Message,
    queue_budget::{QueueBudget, SLOTS},
};

/// Received messages that are not stored yet. Keys with the same hash share a slot.
#[derive(Debug, Default)]
pub(super) struct FairQueue {
    budget: QueueBudget,
    queues: Mutex<Queues>,
}

#[derive(Debug)]
struct Queues {
    slots: Vec<VecDeque<Message>>,
    /// Slots with messages, in the order of their turns.
    turns: VecDeque<usize>,
}

impl Default for Queues {
    fn default() -> Self {
        Self { slots: (0..SLOTS).map(|_| VecDeque::new()).collect(), turns: VecDeque::new() }
    }
}

impl FairQueue {
    /// Memory of the queued messages \[bytes\].
    pub(super) fn bytes(&self) -> usize {
        self.budget.reserved()
    }

    /// Queues a message of this key and size; false if the capacity or the share of the key is used up.
    pub(super) fn push(&self, key: &str, memory: usize, message: impl FnOnce() -> Message) -> bool {
        if !self.budget.reserve(key, memory) {
            return false;
        }
        let (message, slot) = (message(), self.budget.slot_number(key));
        let mut queues = self.queues.lock().unwrap_or_else(PoisonError::into_inner);
        if queues.slots[slot].is_empty() {
            queues.turns.push_back(slot);
        }
        queues.slots[slot].push_back(message);
        true
    }

    /// Removes the oldest message of the next slot.
    pub(super) fn pop(&self) -> Option<Message> {
        let mut queues = self.queues.lock().unwrap_or_else(PoisonError::into_inner);
        let slot = queues.turns.pop_front()?;
        let message = queues.slots[slot].pop_front()?;
        if !queues.slots[slot].is_empty() {
            queues.turns.push_back(slot);
        }
        drop(queues);
        self.budget.release(&message.key, message.memory());
        Some(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_take_turns() {
        let queue = FairQueue::default();
        for (key, bytes) in (0..100).map(|number| ("flood", number)).chain([("calm", 100), ("calm", 101)]) {
            let message = || Message { key: key.to_owned(), content_type: String::new(), payload: Vec::new(), bytes };
            assert!(queue.push(key, 0, message));
        }
        let first: Vec<usize> = (0..4).map(|_| queue.pop().unwrap().bytes).collect();
        assert_eq!(first, [0, 100, 1, 101]);
        assert_eq!((std::iter::from_fn(|| queue.pop()).count(), queue.bytes()), (98, 0));
    }
}
