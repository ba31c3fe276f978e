//! The neutral position, at which the spring of the rails is unstressed, as the throws of both directions show it.
//!
//! If the true neutral position is not the configured one, the spring has an additional constant force, which helps the
//! movement in one direction and hinders it in the other. In a steady movement (equation 12 of the study, without
//! acceleration) this force looks like friction. Let g be the distance from the configured to the true position as a
//! part of the travel, and T the duration of a throw. Then a1 of the throws to reverse is smaller by g a0 T, and a1 of
//! the throws to normal is larger by as much. So a1 / (a0 T) differs by 2 g between the directions of a machine with
//! the same friction in both. a0 / b0 is the same in both directions, unlike in a machine whose load differs for
//! another reason.

use serde::{Deserialize, Serialize};

use super::{BaselineRecord, friction_over_spring};
use crate::{
    diagnose::{
        Observation,
        observation::{Evaluated, apparent_friction},
        statistics::{median, to_f32},
    },
    estimate::Rejection,
};

/// Number of throws of each direction from which the neutral position is learned: half of those of the earliest
/// baseline.
const FIRST: usize = 6;
/// Ratio of the larger to the smaller friction of both directions from which the neutral position is another one: dry
/// chairs and the weight of rods make less difference in a machine that is new or adjusted.
const RATIO: f64 = 1.5;
/// Largest difference of ln(a0 / b0) between the directions that counts as none: a neutral position at the other end of
/// the stroke changes b0 by 2 % in each direction.
const SAME_SPRING: f64 = 0.06;

/// Evidence of the throws about the neutral position.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum Neutral {
    /// Not learned yet: a1 / (a0 T) and ln(a0 / b0) of the first throws of each direction. Boxed, as most monitors of a
    /// fleet have learned the position.
    Unknown(Box<[Vec<[f32; 2]>; 2]>),
    /// The neutral position is near the configured one, or the baselines were learned without a correction.
    Configured,
    /// The neutral position is at this distance from the configured one towards reverse, as part of the travel.
    Elsewhere(f32),
}

impl Default for Neutral {
    fn default() -> Self {
        Self::Unknown(Box::default())
    }
}

impl Neutral {
    /// Adds a throw of a machine without a baseline. Returns whether it shows that the neutral position is elsewhere;
    /// then the throws until now must not be part of a baseline.
    pub(crate) fn learn(&mut self, throw: &Observation) -> bool {
        let Self::Unknown(sides) = self else { return false };
        let coefficients = match &throw.outcome {
            Some(Ok(estimate)) => estimate.coefficients,
            // A wrong neutral position may make a1 negative.
            Some(Err(Rejection::NotPositive { b0, a1, a0 })) => [*b0, *a1, *a0],
            _ => return false,
        };
        let (Some(direction), Some(duration_s)) = (throw.direction, throw.features.duration_s) else { return false };
        let values = shown(coefficients, duration_s).map(to_f32);
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

    /// Ends the learning, when the machine has a baseline.
    pub(crate) fn settle(&mut self) {
        if matches!(self, Self::Unknown(_)) {
            *self = Self::Configured;
        }
    }

    /// The throw without the seeming friction of a neutral position elsewhere.
    pub(crate) fn corrected(&self, throw: Evaluated) -> Evaluated {
        if let Self::Elsewhere(share) = self { throw.without_shift((*share).into()) } else { throw }
    }

    /// The record with a1 as in the estimates, which are not corrected.
    pub(crate) fn as_estimated(&self, mut record: BaselineRecord) -> BaselineRecord {
        if let (Self::Elsewhere(share), Some(duration_s)) = (self, record.duration_s) {
            let [_, _, a0] = record.center;
            record.center[1] -= apparent_friction((*share).into(), record.direction, a0, duration_s);
        }
        record
    }

    /// Distance of the neutral position from the configured one as part of the travel: the corrected one, else the one
    /// that uncorrected baselines show. `centres`: b0, a1, a0 and the duration \[s\] of the baselines of both
    /// directions. `None` if the position is the configured one, or unknown.
    pub(crate) fn elsewhere(&self, centres: [Option<([f64; 3], f64)>; 2]) -> Option<f32> {
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

/// Distance of the neutral position from the configured one as part of the travel, from a1 / (a0 T) and ln(a0 / b0) of
/// both directions; `None` if they do not show another position.
fn elsewhere([[to_reverse, spring], [to_normal, other_spring]]: [[f64; 2]; 2]) -> Option<f32> {
    let (less, more) = (to_reverse.min(to_normal), to_reverse.max(to_normal));
    let is_shown = more > RATIO * less.max(0.0) && (spring - other_spring).abs() < SAME_SPRING;
    let share = to_f32((to_normal - to_reverse) / 2.0);
    (is_shown && share.is_finite()).then_some(share)
}
