//! A series in which few throws have a value; only these values take memory.

use serde::{Deserialize, Serialize};

/// The last throws, with a value for some of them. In a snapshot, a list with `null` for the throws without.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(from = "Vec<Option<[f32; 3]>>", into = "Vec<Option<[f32; 3]>>")]
pub(crate) struct SparseValues {
    throws: u32,
    /// The values, the oldest first, each with its age: the number of throws after it.
    values: Vec<(u32, [f32; 3])>,
}

impl SparseValues {
    /// Number of throws, with and without a value.
    pub(crate) fn throws(&self) -> u32 {
        self.throws
    }

    pub(crate) fn push(&mut self, value: Option<[f32; 3]>) {
        self.throws += 1;
        self.values.iter_mut().for_each(|(age, _)| *age += 1);
        self.values.extend(value.map(|value| (0, value)));
    }

    /// Removes the oldest throw; returns its value.
    pub(crate) fn pop_oldest(&mut self) -> Option<[f32; 3]> {
        self.throws = self.throws.saturating_sub(1);
        let is_oldest = self.values.first().is_some_and(|(age, _)| *age == self.throws);
        is_oldest.then(|| self.values.remove(0).1)
    }

    /// The values of the last `throws` with their ages, the newest first.
    pub(crate) fn last(&self, throws: u32) -> impl Iterator<Item = &(u32, [f32; 3])> {
        self.values.iter().rev().take_while(move |(age, _)| *age < throws)
    }

    /// Removes the values, and keeps the number of throws.
    pub(crate) fn forget_values(&mut self) {
        self.values = Vec::new();
    }
}

impl From<Vec<Option<[f32; 3]>>> for SparseValues {
    fn from(all: Vec<Option<[f32; 3]>>) -> Self {
        let mut sparse = Self::default();
        for value in all {
            sparse.push(value);
        }
        sparse
    }
}

impl From<SparseValues> for Vec<Option<[f32; 3]>> {
    fn from(sparse: SparseValues) -> Self {
        let mut all = vec![None; sparse.throws as usize];
        for (age, value) in sparse.values {
            all[(sparse.throws - 1 - age) as usize] = Some(value);
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_those_of_the_last_throws() {
        let mut sparse = SparseValues::default();
        let mut all = Vec::new();
        for throw in 0..40_u8 {
            let value = throw.is_multiple_of(7).then(|| [f32::from(throw); 3]);
            sparse.push(value);
            all.push(value);
            if sparse.throws() > 15 {
                assert_eq!(sparse.pop_oldest(), all.remove(0));
            }
            assert_eq!(Vec::from(sparse.clone()), all);
            assert_eq!(SparseValues::from(all.clone()), sparse);
            let last = (0..10).zip(all.iter().rev()).filter_map(|(age, value)| Some((age, (*value)?)));
            assert_eq!(sparse.last(10).copied().collect::<Vec<_>>(), last.collect::<Vec<_>>());
        }
    }
}
