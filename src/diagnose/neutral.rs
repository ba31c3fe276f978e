//! The neutral position of the spring, as the throws of both directions show it.
//!
//! With another neutral position than the configured one the spring has a constant force more, which helps one direction
//! and hinders the other. In a steady movement (equation 12 without acceleration) it seems to be friction: with the share g of
//! the travel between the two positions, a1 of the throws to reverse is smaller by g a0 T, that of the throws to normal larger, T
//! being the duration. So a1 / (a0 T) differs by 2 g between the directions of a machine with the same friction in both, while
//! a0 / b0 is the same, as it is not in a machine whose load differs in other ways.

use serde::{Deserialize, Serialize};

use super::{baseline::BaselineRecord, observation::Evaluated, robust::median};
use crate::throw::Direction;

/// Throws of each direction that show the neutral position, half of those of the earliest baseline.
const FIRST: usize = 6;
/// Ratio of the friction of both directions from which it shows another neutral position: dry chairs and the weight of rods differ
/// less in a machine that is new or adjusted.
const RATIO: f64 = 1.5;
/// Largest difference of ln(a0 / b0) between the directions: a neutral position at the other end of the stroke changes b0 by 2 % in
/// each of them.
const SAME_SPRING: f64 = 0.06;

/// What the throws show about the neutral position.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) enum Neutral {
    /// a1 / (a0 T) and ln(a0 / b0) of the first throws of each direction; boxed, as most monitors of a fleet have learned it.
    Unknown(Box<[Vec<[f32; 2]>; 2]>),
    /// Near the configured one, or with baselines that do not correct it.
    Configured,
    /// Another one.
    Elsewhere(Elsewhere),
}

/// Another neutral position than the configured one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Elsewhere {
    /// Distance from the configured one towards reverse, as part of the travel.
    pub(super) share: f32,
    /// Ratio of the larger to the smaller friction of the directions.
    pub(super) ratio: f32,
}

impl Default for Neutral {
    fn default() -> Self {
        Self::Unknown(Box::default())
    }
}

impl Neutral {
    /// Adds a throw of a machine without a baseline; returns whether the neutral position was found elsewhere, so that the throws
    /// before must not be part of a baseline.
    pub(super) fn learn(&mut self, throw: &Evaluated) -> bool {
        let Self::Unknown(sides) = self else { return false };
        let Some(duration_s) = throw.duration_s else { return false };
        #[expect(clippy::cast_possible_truncation, reason = "two digits are enough")]
        let values = shown(throw.log, duration_s).map(|value| value as f32);
        let side = &mut sides[throw.direction.side()];
        if side.len() < FIRST && values.iter().all(|value| value.is_finite()) {
            side.push(values);
        }
        if sides.iter().any(|side| side.len() < FIRST) {
            return false;
        }
        let level = |side: &Vec<[f32; 2]>, at: usize| {
            median(&mut side.iter().map(|values| f64::from(values[at])).collect::<Vec<_>>())
        };
        let levels = sides.each_ref().map(|side| [level(side, 0), level(side, 1)]);
        *self = Elsewhere::of(levels).map_or(Self::Configured, Self::Elsewhere);
        matches!(self, Self::Elsewhere(_))
    }

    /// Ends the learning, as a machine has a baseline.
    pub(super) fn settle(&mut self) {
        if matches!(self, Self::Unknown(_)) {
            *self = Self::Configured;
        }
    }

    /// The throw with the friction that it has without the force of the spring.
    pub(super) fn corrected(&self, throw: Evaluated) -> Evaluated {
        match self {
            Self::Elsewhere(Elsewhere { share, .. }) => throw.without_shift((*share).into()),
            _ => throw,
        }
    }

    /// The record with a1 as in the estimates, which are not corrected.
    pub(super) fn as_estimated(&self, mut record: BaselineRecord) -> BaselineRecord {
        if let (Self::Elsewhere(Elsewhere { share, .. }), Some(duration_s)) = (self, record.duration_s) {
            let [_, a1, a0] = record.center;
            record.center[1] = a1 - record.direction.sign() * f64::from(*share) * a0 * duration_s;
        }
        record
    }

    /// The neutral position elsewhere, as corrected, or as the centres of baselines that do not correct it show it: ln b0, ln a1, ln
    /// a0 and duration \[s\] of each direction.
    pub(super) fn elsewhere(&self, centres: [Option<([f64; 3], f64)>; 2]) -> Option<Elsewhere> {
        if let Self::Elsewhere(elsewhere) = self {
            return Some(*elsewhere);
        }
        let [normal, reverse] = centres.map(|centre| centre.map(|(log, duration_s)| shown(log, duration_s)));
        Elsewhere::of([normal?, reverse?])
    }
}

/// a1 / (a0 T) and ln(a0 / b0).
fn shown([b0, a1, a0]: [f64; 3], duration_s: f64) -> [f64; 2] {
    [(a1 - a0).exp() / duration_s, a0 - b0]
}

impl Elsewhere {
    /// By a1 / (a0 T) and ln(a0 / b0) of both directions; `None` if they do not show one.
    #[expect(clippy::cast_possible_truncation, reason = "two digits are enough")]
    fn of(levels: [[f64; 2]; 2]) -> Option<Self> {
        let [[to_reverse, spring], [to_normal, other_spring]] =
            Direction::BOTH.map(|direction| levels[direction.side()]);
        let ratio = (to_normal / to_reverse).max(to_reverse / to_normal);
        let share = (to_normal - to_reverse) / 2.0;
        let is_shown = ratio > RATIO && ratio.is_finite() && (spring - other_spring).abs() < SAME_SPRING;
        is_shown.then_some(Self { share: share as f32, ratio: ratio as f32 })
    }
}
