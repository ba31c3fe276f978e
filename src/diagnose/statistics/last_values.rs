//! The last values of a series, in a list that reserves no spare memory.

use std::ops::{Deref, DerefMut};

use serde::{Deserialize, Deserializer, Serialize};

/// The last `N` values of a series, the oldest first. A plain `Vec` doubles its memory as it grows; such lists would be
/// most of the memory of a large fleet.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub(crate) struct LastValues<T, const N: usize>(Vec<T>);

impl<T, const N: usize> LastValues<T, N> {
    /// Adds a value. Returns the oldest one if the list was full.
    pub(crate) fn push(&mut self, value: T) -> Option<T> {
        let oldest = if self.len() == N { self.pop_oldest() } else { None };
        self.0.reserve_exact(N - self.len());
        self.0.push(value);
        oldest
    }

    /// Removes the oldest value. Frees the memory when the list becomes empty.
    pub(crate) fn pop_oldest(&mut self) -> Option<T> {
        let oldest = (!self.is_empty()).then(|| self.0.remove(0));
        if self.is_empty() {
            self.clear();
        }
        oldest
    }

    /// Removes and returns the value at `index`.
    pub(crate) fn remove(&mut self, index: usize) -> T {
        self.0.remove(index)
    }

    /// Removes all values, and frees their memory.
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }
}

impl<T, const N: usize> Default for LastValues<T, N> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T, const N: usize> Deref for LastValues<T, N> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<T, const N: usize> DerefMut for LastValues<T, N> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.0
    }
}

impl<T, const N: usize> FromIterator<T> for LastValues<T, N> {
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        let mut values: Vec<T> = values.into_iter().collect();
        values.drain(..values.len().saturating_sub(N));
        values.shrink_to(N);
        Self(values)
    }
}

impl<'de, T: Deserialize<'de>, const N: usize> Deserialize<'de> for LastValues<T, N> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Ok(Vec::deserialize(from)?.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_values_stay_in_memory_for_no_more() {
        let mut last = LastValues::<u32, 3>::default();
        assert_eq!([1, 2, 3, 4, 5].map(|value| last.push(value)), [None, None, None, Some(1), Some(2)]);
        assert_eq!(serde_json::to_string(&last).unwrap(), "[3,4,5]");
        let read: LastValues<u32, 3> = serde_json::from_str("[1,2,3,4,5]").unwrap();
        assert_eq!(read, last);
        assert_eq!([last.0.capacity(), read.0.capacity()], [3, 3]);
    }
}
