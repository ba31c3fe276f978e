//! The residuals of the throws since the baseline, averaged in blocks so that the memory is bounded; for the course of
//! slow drifts.

use std::ops::Range;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::Point;
use crate::diagnose::statistics::{LONGEST_WINDOW, LastValues, to_f32};

/// Means of consecutive blocks of throws since the baseline. When there are [`History::PLACES`] blocks, neighbouring
/// blocks are joined in pairs, and new blocks are twice as long. So the history stays complete, and becomes coarser.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct History {
    /// Length of a block \[throws\].
    length: u32,
    blocks: LastValues<[f32; 3], { History::PLACES }>,
    /// Number of throws in the block that is not complete yet.
    filling: u32,
    /// Sum of the residuals in this block.
    sum: [f64; 3],
    /// Number of the first throw of the history among those of the machine.
    since: Option<u64>,
}

impl Default for History {
    fn default() -> Self {
        Self { length: Self::FIRST_LENGTH, blocks: LastValues::default(), filling: 0, sum: [0.0; 3], since: None }
    }
}

impl History {
    /// Number of blocks at which they are joined; even, so that all can be joined in pairs.
    const PLACES: usize = 48;
    /// Number of latest blocks in a course, so that courses have about the same length at all times: 24 blocks are left
    /// after a join, and 47 before the next one.
    const LATEST: usize = 23;
    /// Initial length of a block \[throws\]: enough throws to average the scatter, and few enough for a fast ramp.
    const FIRST_LENGTH: u32 = 4;

    /// Adds the residual of the machine's throw number `order`.
    pub(crate) fn push(&mut self, residual: &Vector3<f64>, order: u64) {
        self.since.get_or_insert(order);
        for (sum, value) in self.sum.iter_mut().zip(residual.iter()) {
            *sum += value;
        }
        self.filling += 1;
        if self.filling < self.length {
            return;
        }
        self.blocks.push(self.sum.map(|sum| to_f32(sum / f64::from(self.length))));
        self.sum = [0.0; 3];
        self.filling = 0;
        if self.blocks.len() == Self::PLACES {
            let joined =
                self.blocks.chunks_exact(2).map(|pair| [0, 1, 2].map(|i| 0.5 * (pair[0][i] + pair[1][i]))).collect();
            self.blocks = joined;
            self.length *= 2;
        }
    }

    /// Mean of the latest throws with ages in this range \[throws of the history\]: of the fewest whole blocks that
    /// have at least [`LONGEST_WINDOW`] throws. `None` with fewer throws.
    pub(crate) fn mean(&self, ages: Range<u32>) -> Option<Vector3<f64>> {
        let (mut sum, mut count, mut age) = (Vector3::zeros(), 0, self.filling);
        for block in self.blocks.iter().rev() {
            let is_inside = age >= ages.start;
            age += self.length;
            if age > ages.end || count >= LONGEST_WINDOW {
                break;
            }
            if is_inside {
                sum += Vector3::from(block.map(f64::from)) * f64::from(self.length);
                count += self.length;
            }
        }
        (count >= LONGEST_WINDOW).then(|| sum / f64::from(count))
    }

    /// The latest blocks along `weights`, oldest first, each with its length and the age of its middle at the throw
    /// `now` \[throws of the machine\]. Throws without a residual, which the blocks do not contain, count as evenly
    /// distributed.
    pub(crate) fn along(&self, weights: &Vector3<f64>, now: u64) -> impl Iterator<Item = Point> {
        let throws = f64::from(self.length);
        let pushed = throws * self.blocks.len() as f64 + f64::from(self.filling);
        let passed = self.since.map_or(pushed, |since| now.saturating_sub(since) as f64 + 1.0);
        let each = passed / pushed.max(1.0);
        let last = f64::from(self.filling) + 0.5 * (throws - 1.0);
        let from = self.blocks.len().saturating_sub(Self::LATEST);
        let blocks = self.blocks[from..].iter().rev().enumerate().rev();
        blocks.map(move |(at, block)| {
            let value = weights.dot(&Vector3::from(block.map(f64::from)));
            Point { age: each * (last + throws * at as f64), value, throws }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_history_covers_a_whole_life_in_bounded_space() {
        let mut history = History::default();
        for at in 0..10_000_u32 {
            history.push(&Vector3::repeat(f64::from(at)), u64::from(at));
        }
        let points: Vec<Point> = history.along(&Vector3::new(1.0, 0.0, 0.0), 9_999).collect();
        assert!(history.blocks.len() < History::PLACES && points.len() == History::LATEST);
        for point in points {
            assert!((point.value + point.age - 9_999.0).abs() < 1.0, "{point:?}");
        }
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
