//! Whether the last throws still look like the baseline: windows of 3, 6, 12 and 24 throws, T = m' V^-1 m against its
//! limit.
//!
//! Three streams are watched: each direction alone, and both together in the order of the throws. A fault of the
//! machine shows in the mixed stream soonest, a fault of one direction only in its own.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{
    baseline::Baseline,
    robust::clipped_mean,
    scatter::Scatter,
    sym3::Sym3,
    threshold::{Thresholds, WINDOWS},
};

/// Throws kept of each direction: the longest window.
const KEPT: usize = WINDOWS[3];

/// One throw since the baseline, as its residual from it. Short names keep the state small.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Recent {
    /// Counts the machine's throws.
    #[serde(rename = "n")]
    order: u64,
    #[serde(rename = "r")]
    residual: [f32; 3],
    #[serde(rename = "c")]
    sensor: Sym3,
    /// Distance from the reference temperature \[K\].
    #[serde(rename = "k")]
    distance_k: f32,
}

impl Recent {
    #[expect(clippy::cast_possible_truncation, reason = "1e-7 of a logarithm is far below any scatter")]
    pub(super) fn new(order: u64, residual: Vector3<f64>, distance_k: f64, sensor: Sym3) -> Self {
        let residual = [residual.x as f32, residual.y as f32, residual.z as f32];
        Self { order, residual, sensor, distance_k: distance_k as f32 }
    }

    pub(super) fn residual(&self) -> Vector3<f64> {
        Vector3::from(self.residual.map(f64::from))
    }
}

/// The last throws of one direction.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct Ring(VecDeque<Recent>);

impl Ring {
    pub(super) fn push(&mut self, throw: Recent) {
        if self.0.len() == KEPT {
            self.0.pop_front();
        }
        self.0.push_back(throw);
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Oldest first.
    pub(super) fn iter(&self) -> impl DoubleEndedIterator<Item = &Recent> + ExactSizeIterator {
        self.0.iter()
    }
}

/// The mean of one window, with what is known of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    /// Throws in it.
    pub(super) throws: usize,
    /// Clipped mean of the residuals.
    pub(super) mean: Vector3<f64>,
    /// Its covariance, the baseline's own uncertainty included.
    pub(super) covariance: Matrix3<f64>,
    /// T over its limit: a drift is detected above 1.
    pub(super) excess: f64,
}

/// A stream's last throws, newest first, at most the longest window.
pub(super) struct Tail<'a>(Vec<(usize, &'a Recent)>);

impl<'a> Tail<'a> {
    /// Of one direction.
    pub(super) fn of(ring: &'a Ring, direction: usize) -> Self {
        Self(ring.iter().rev().map(|throw| (direction, throw)).collect())
    }

    /// Of both directions, in the order of the throws.
    pub(super) fn mixed(rings: [&'a Ring; 2]) -> Self {
        let mut tail = Vec::with_capacity(KEPT);
        let mut sides = rings.map(|ring| ring.iter().rev().peekable());
        while tail.len() < KEPT {
            let newest = sides.each_mut().map(|side| side.peek().map(|throw| throw.order));
            let side = usize::from(newest[1] > newest[0]);
            let Some(throw) = sides[side].next() else { break };
            tail.push((side, throw));
        }
        Self(tail)
    }

    /// Of both directions, all that is kept.
    pub(super) fn all(rings: [&'a Ring; 2]) -> Self {
        let mut tail: Vec<(usize, &Recent)> =
            rings.into_iter().enumerate().flat_map(|(at, ring)| ring.iter().map(move |throw| (at, throw))).collect();
        tail.sort_unstable_by_key(|(_, throw)| std::cmp::Reverse(throw.order));
        Self(tail)
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Newest first.
    pub(super) fn iter(&self) -> impl Iterator<Item = &'a Recent> {
        self.0.iter().map(|(_, throw)| *throw)
    }

    /// The window of the last `throws`, without its test. `None` when there are fewer, or when a stream of two
    /// directions holds hardly any of one.
    pub(super) fn window(&self, throws: usize, scatter: &Scatter, baselines: [Option<&Baseline>; 2]) -> Option<Window> {
        let last = self.0.get(..throws)?;
        let count = |side: usize| last.iter().filter(|(at, _)| *at == side).count();
        let counts = [count(0), count(1)];
        let mut sensor = Matrix3::zeros();
        let mut distance = [0.0; 2];
        for (side, throw) in last {
            sensor += Matrix3::from(throw.sensor);
            distance[*side] += f64::from(throw.distance_k);
        }
        let n = throws as f64;
        sensor /= n;
        let sd = scatter.sd_of_one(&sensor);
        let mut values = [0.0; KEPT];
        let mean = Vector3::from_fn(|i, _| {
            for (value, (_, throw)) in values.iter_mut().zip(last) {
                *value = f64::from(throw.residual[i]);
            }
            clipped_mean(&mut values[..throws], sd[i])
        });
        // The centre of each direction errs on its own: together they are known as from this many throws.
        let mut spread = 0.0;
        let mut doubt = Vector3::zeros();
        for side in 0..2 {
            if counts[side] > 0 {
                let part = counts[side] as f64 / n;
                spread += part * part / baselines[side]?.throws() as f64;
                doubt += baselines[side]?.temperature_sd(distance[side] / n);
            }
        }
        let temperature = Matrix3::from_diagonal(&doubt.component_mul(&doubt));
        let covariance = scatter.of_mean(throws, &sensor, 1.0 / spread) + temperature;
        Some(Window { throws, mean, covariance, excess: 0.0 })
    }

    /// The window in which the drift shows most, whether or not it is above its limit.
    pub(super) fn strongest(
        &self,
        scatter: &Scatter,
        thresholds: &Thresholds,
        baselines: [Option<&Baseline>; 2],
    ) -> Option<Window> {
        let mut best: Option<Window> = None;
        for (at, &throws) in WINDOWS.iter().enumerate() {
            let Some(mut window) = self.window(throws, scatter, baselines) else { continue };
            let Some(inverse) = window.covariance.try_inverse() else { continue };
            window.excess = (window.mean.transpose() * inverse * window.mean).x / thresholds.of(at);
            if best.is_none_or(|best| window.excess > best.excess) {
                best = Some(window);
            }
        }
        best
    }

    /// Whether both directions take part in the last few throws.
    pub(super) fn is_balanced(&self) -> bool {
        let last = self.0.iter().take(KEPT);
        let (total, reverse) = last.fold((0, 0), |(total, reverse), (side, _)| (total + 1, reverse + side));
        total >= WINDOWS[0] && 4 * reverse >= total && 4 * (total - reverse) >= total
    }
}
