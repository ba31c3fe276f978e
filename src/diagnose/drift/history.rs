//! The residuals of the throws since the baseline, averaged in blocks so that the memory is bounded; for the course of
//! slow drifts.

use std::{iter::repeat_n, ops::Range};

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::Point;
use crate::diagnose::statistics::{LONGEST_WINDOW, LastValues, to_f32};

/// Means of consecutive blocks of throws since the baseline. The latest blocks have [`History::FIRST_LENGTH`] throws.
/// When there are [`History::FULL`] blocks of a length, the two oldest of these are joined: so the length of a block is
/// about a sixth of its age, up to 256 throws. All blocks together reach back at least 3000 throws.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "Stored")]
pub(crate) struct History {
    /// Means of the blocks, the oldest first.
    means: LastValues<[f32; 3], { History::PLACES }>,
    /// Number of throws since the beginning.
    count: u32,
    /// Sum of the residuals in the block that is not complete yet.
    sum: [f64; 3],
    /// Number of the first throw of the history among those of the machine.
    since: Option<u64>,
}

impl History {
    const PLACES: usize = 48;
    /// Number of latest blocks in a course: about a thousand throws, as far as a forecast reaches.
    const LATEST: usize = 32;
    /// Length of the latest blocks \[throws\]: enough throws to average the scatter, and few enough for a fast ramp.
    const FIRST_LENGTH: u32 = 4;
    /// Number of lengths, each twice the one before it. Blocks of the last length are not joined.
    const LENGTHS: u32 = 7;
    /// Number of blocks of a length at which two of them are joined.
    const FULL: u32 = 8;

    /// Adds the residual of the machine's throw number `order`.
    pub(crate) fn push(&mut self, residual: &Vector3<f64>, order: u64) {
        self.since.get_or_insert(order);
        for (sum, value) in self.sum.iter_mut().zip(residual.iter()) {
            *sum += value;
        }
        self.count += 1;
        if self.is_block_complete() {
            self.means.push(self.sum.map(|sum| to_f32(sum / f64::from(Self::FIRST_LENGTH))));
            self.sum = [0.0; 3];
            self.join();
        }
    }

    fn is_block_complete(&self) -> bool {
        self.count.is_multiple_of(Self::FIRST_LENGTH)
    }

    /// Joins the two oldest blocks of each length that has too many, after a block was added.
    fn join(&mut self) {
        let mut added = self.count / Self::FIRST_LENGTH;
        let mut end = self.means.len();
        for _ in 1..Self::LENGTHS {
            if added < Self::FULL || !added.is_multiple_of(2) {
                break;
            }
            let older = end - Self::FULL as usize;
            let younger = self.means.remove(older + 1);
            let joined = &mut self.means[older];
            *joined = [0, 1, 2].map(|i| f32::midpoint(joined[i], younger[i]));
            added = Self::joined(added);
            end = older + 1;
        }
    }

    /// Number of joined blocks when this many blocks of a length were added.
    fn joined(added: u32) -> u32 {
        (added + 2).saturating_sub(Self::FULL) / 2
    }

    /// The blocks, the latest first: each with its mean, its length, and its age, which is that of its latest throw
    /// \[throws of the history\].
    fn latest_first(&self) -> impl Iterator<Item = (&[f32; 3], u32, u32)> {
        let mut added = self.count / Self::FIRST_LENGTH;
        let lengths = (0..Self::LENGTHS).flat_map(move |doubled| {
            let joined = if doubled + 1 < Self::LENGTHS { Self::joined(added) } else { 0 };
            let kept = added - 2 * joined;
            added = joined;
            repeat_n(Self::FIRST_LENGTH << doubled, kept as usize)
        });
        let mut age = self.count % Self::FIRST_LENGTH;
        self.means.iter().rev().zip(lengths).map(move |(mean, length)| {
            age += length;
            (mean, length, age - length)
        })
    }

    /// Mean of the latest throws with ages in this range \[throws of the history\]: of the fewest whole blocks that
    /// have at least [`LONGEST_WINDOW`] throws. `None` with fewer throws.
    pub(crate) fn mean(&self, ages: Range<u32>) -> Option<Vector3<f64>> {
        let (mut sum, mut count) = (Vector3::zeros(), 0);
        let is_inside = |length: u32, age: u32| age >= ages.start && age + length <= ages.end;
        for (mean, length, _) in self.latest_first().filter(|(_, length, age)| is_inside(*length, *age)) {
            if count >= LONGEST_WINDOW {
                break;
            }
            sum += Vector3::from(mean.map(f64::from)) * f64::from(length);
            count += length;
        }
        (count >= LONGEST_WINDOW).then(|| sum / f64::from(count))
    }

    /// The latest blocks along `weights`, oldest first, each with its length and the age of its middle at the throw
    /// `now` \[throws of the machine\]. Throws without a residual, which the blocks do not contain, count as evenly
    /// distributed.
    pub(crate) fn along(&self, weights: &Vector3<f64>, now: u64) -> impl Iterator<Item = Point> {
        let pushed = f64::from(self.count);
        let passed = self.since.map_or(pushed, |since| now.saturating_sub(since) as f64 + 1.0);
        let each = passed / pushed.max(1.0);
        let point = |(mean, length, age): (&[f32; 3], u32, u32)| {
            let (throws, value) = (f64::from(length), weights.dot(&Vector3::from(mean.map(f64::from))));
            Point { age: each * (f64::from(age) + 0.5 * (throws - 1.0)), value, throws }
        };
        let latest: Vec<Point> = self.latest_first().take(Self::LATEST).map(point).collect();
        latest.into_iter().rev()
    }
}

/// A stored history. Earlier versions stored blocks of one `length`, and the throws `filling` the next one.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Stored {
    means: LastValues<[f32; 3], { History::PLACES }>,
    count: u32,
    sum: [f64; 3],
    since: Option<u64>,
    length: u32,
    blocks: LastValues<[f32; 3], { History::PLACES }>,
    filling: u32,
}

impl From<Stored> for History {
    fn from(stored: Stored) -> Self {
        let Stored { means, count, sum, since, length, blocks, filling } = stored;
        let mut history = Self { means, count, sum: if length > 0 { [0.0; 3] } else { sum }, since };
        let blocks = blocks.iter().map(|block| (Vector3::from(block.map(f64::from)), length));
        let rest = (Vector3::from(sum) / f64::from(filling.max(1)), filling);
        for (mean, throws) in blocks.chain([rest]) {
            for _ in 0..throws {
                history.push(&mean, since.unwrap_or_default());
            }
        }
        history
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each block must be where its mean says, with a length in proportion to its age.
    #[test]
    fn the_blocks_of_every_count_are_gapless_and_finer_the_later_they_are() {
        let mut history = History::default();
        for at in 0..10_000_u32 {
            history.push(&Vector3::repeat(f64::from(at)), u64::from(at));
            let mut next = history.count % History::FIRST_LENGTH;
            for (mean, length, age) in history.latest_first() {
                assert_eq!(age, next, "after {at}");
                let middle = f64::from(at - age) - 0.5 * f64::from(length - 1);
                assert!((f64::from(mean[0]) - middle).abs() < 1e-2, "after {at}: {mean:?} for {middle}");
                assert!(length == History::FIRST_LENGTH || 3 * length <= age, "after {at}: {length} at {age}");
                next += length;
            }
            assert!(history.means.len() <= History::PLACES && next >= (at + 1).min(3000), "after {at}");
        }
        for point in history.along(&Vector3::x(), 9_999) {
            assert!((point.value + point.age - 9_999.0).abs() < 1.0, "{point:?}");
        }
        let before_alarm = |since: u32| history.mean(2 * LONGEST_WINDOW..since).is_some();
        assert!((0..200).find(|since| before_alarm(*since)).is_some_and(|first| first < 90));
    }

    #[test]
    fn a_history_of_an_earlier_version_is_read() {
        let json =
            r#"{"length": 16, "blocks": [[1, 2, 3], [2, 4, 6]], "filling": 2, "sum": [5.0, 6.0, 7.0], "since": 40}"#;
        let history: History = serde_json::from_str(json).unwrap();
        let read: Vec<_> = history.latest_first().map(|(mean, length, age)| (mean[0], length, age)).collect();
        assert_eq!(read[0], (2.0, 4, 2));
        assert_eq!(read[read.len() - 1], (1.0, 8, 26));
        assert_eq!((history.count, history.sum, history.since), (34, [5.0, 6.0, 7.0], Some(40)));
        assert_eq!(serde_json::from_str::<History>(&serde_json::to_string(&history).unwrap()).unwrap(), history);
    }

    /// The ages must fit to those of the single last throws, which count all throws of the machine.
    #[test]
    fn ages_count_rejected_throws_too() {
        let mut history = History::default();
        for at in (0..400_u32).step_by(2) {
            history.push(&Vector3::repeat(f64::from(at)), u64::from(at));
        }
        for point in history.along(&Vector3::new(1.0, 0.0, 0.0), 399) {
            assert!((point.value + point.age - 399.0).abs() < 3.0, "{point:?}");
        }
    }
}
