//! The neutral position of the spring, as the throws of both directions show it.
//!
//! With another neutral position than the configured one the spring has a constant force more, which helps one direction
//! and hinders the other. In a steady movement (equation 12 without acceleration) it seems to be friction: with the share g of
//! the travel between the two positions, a1 of the throws to reverse is smaller by g a0 T, that of the throws to normal larger, T
//! being the duration. So a1 / (a0 T) differs by 2 g between the directions of a machine with the same friction in both, while
//! a0 / b0 is the same, as it is not in a machine whose load differs in other ways.

use serde::{Deserialize, Serialize};

use super::{
    baseline::{BaselineRecord, friction_over_spring},
    observation::{Evaluated, Observation, seeming_friction},
    robust::median,
};

/// Throws of each direction that show the neutral position, half of those of the earliest baseline.
const FIRST: usize = 6;
/// Ratio of the friction of both directions from which it shows another neutral position: dry chairs and the weight of rods differ
/// less in a machine that is new or adjusted.
const RATIO: f64 = 1.5;
/// Largest difference of ln(a0 / b0) between the directions: a neutral position at the other end of the stroke changes b0 by 2 % in
/// each of them.
const SAME_SPRING: f64 = 0.06;

/// Evidence of the throws about the neutral position.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) enum Neutral {
    /// a1 / (a0 T) and ln(a0 / b0) of the first throws of each direction; boxed, as most monitors of a fleet have learned it.
    Unknown(Box<[Vec<[f32; 2]>; 2]>),
    /// Near the configured one, or with baselines that do not correct it.
    Configured,
    /// At this distance from the configured one towards reverse, as part of the travel.
    Elsewhere(f32),
}

impl Default for Neutral {
    fn default() -> Self {
        Self::Unknown(Box::default())
    }
}

impl Neutral {
    /// Adds a throw of a machine without a baseline; returns whether the neutral position was found elsewhere, so that the throws
    /// before must not be part of a baseline.
    pub(super) fn learn(&mut self, throw: &Observation) -> bool {
        let Self::Unknown(sides) = self else { return false };
        let coefficients = throw.estimate.as_ref().map(|(estimate, _)| *estimate).or(throw.not_positive);
        let (Some(coefficients), Some(direction), Some(duration_s)) =
            (coefficients, throw.direction, throw.features.duration_s)
        else {
            return false;
        };
        #[expect(clippy::cast_possible_truncation, reason = "two digits are enough")]
        let values = shown(coefficients, duration_s).map(|value| value as f32);
        let side = &mut sides[direction.side()];
        if side.len() < FIRST && values.iter().all(|value| value.is_finite()) {
            side.push(values);
        }
        if sides.iter().any(|side| side.len() < FIRST) {
            return false;
        }
        let level = |side: &Vec<[f32; 2]>, at: usize| {
            median(&mut side.iter().map(|values| f64::from(values[at])).collect::<Vec<_>>())
        };
        *self = elsewhere(sides.each_ref().map(|side| [level(side, 0), level(side, 1)]))
            .map_or(Self::Configured, Self::Elsewhere);
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
        if let Self::Elsewhere(share) = self { throw.without_shift((*share).into()) } else { throw }
    }

    /// The record with a1 as in the estimates, which are not corrected.
    pub(super) fn as_estimated(&self, mut record: BaselineRecord) -> BaselineRecord {
        if let (Self::Elsewhere(share), Some(duration_s)) = (self, record.duration_s) {
            let [_, _, a0] = record.center;
            record.center[1] -= seeming_friction((*share).into(), record.direction, a0, duration_s);
        }
        record
    }

    /// The neutral position elsewhere, as corrected, or as the baselines of both directions show it that do not correct it. These have
    /// the centres b0, a1, a0 and the duration \[s\].
    pub(super) fn elsewhere(&self, centres: [Option<([f64; 3], f64)>; 2]) -> Option<f32> {
        if let Self::Elsewhere(share) = self {
            return Some(*share);
        }
        let [normal, reverse] =
            centres.map(|centre| centre.map(|(coefficients, duration_s)| shown(coefficients, duration_s)));
        elsewhere([normal?, reverse?])
    }
}

/// a1 / (a0 T) and ln(a0 / b0).
fn shown([b0, a1, a0]: [f64; 3], duration_s: f64) -> [f64; 2] {
    [friction_over_spring([b0, a1, a0], duration_s), (a0 / b0).ln()]
}

/// The share of the travel by a1 / (a0 T) and ln(a0 / b0) of both directions; `None` if they do not show another neutral position.
fn elsewhere([[to_reverse, spring], [to_normal, other_spring]]: [[f64; 2]; 2]) -> Option<f32> {
    let (less, more) = (to_reverse.min(to_normal), to_reverse.max(to_normal));
    let is_shown = more > RATIO * less.max(0.0) && (spring - other_spring).abs() < SAME_SPRING;
    #[expect(clippy::cast_possible_truncation, reason = "two digits are enough")]
    let share = ((to_normal - to_reverse) / 2.0) as f32;
    (is_shown && share.is_finite()).then_some(share)
}
