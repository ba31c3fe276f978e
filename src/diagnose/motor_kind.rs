//! The kind of motor that the first throws of a machine show, against the configured one.

use serde::{Deserialize, Serialize};

use super::observation::{Observation, Parameters};
use crate::estimate::Motor;

/// Throws of each direction that decide.
const FIRST: u8 = 12;
/// Least number of them that show a kind. In both directions: where the toe is driven by levers or the position sensor is not
/// linear, the speed varies along the stroke as it would with a load, which has the opposite effect in the other direction.
const LEAST: u8 = 8;

/// Numbers of the first throws of each direction.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct MotorKind([Counts; 2]);

#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
struct Counts {
    throws: u8,
    series: u8,
    magnets: u8,
}

impl MotorKind {
    /// Adds a throw of a machine in service.
    pub(super) fn learn(&mut self, observation: &Observation) {
        let features = &observation.features;
        let is_whole = !observation.incomplete && features.travel_mm.is_some() && features.duration_s.is_some();
        let Some(direction) = observation.direction.filter(|_| is_whole) else { return };
        let counts = &mut self.0[direction.side()];
        if counts.throws < FIRST {
            counts.throws += 1;
            counts.series += u8::from(features.motor == Some(Motor::Series));
            counts.magnets += u8::from(features.motor == Some(Motor::PermanentMagnet));
        }
    }

    /// The kind that the throws show, if it is not the configured one.
    pub(super) fn unlike(&self, parameters: Option<Parameters>) -> Option<Motor> {
        let configured = parameters.map(|parameters| parameters.motor).unwrap_or_default();
        let is_shown = |of: fn(&Counts) -> u8| self.0.iter().all(|counts| of(counts) >= LEAST);
        match configured {
            Motor::PermanentMagnet => is_shown(|counts| counts.series).then_some(Motor::Series),
            Motor::Series => is_shown(|counts| counts.magnets).then_some(Motor::PermanentMagnet),
        }
    }
}
