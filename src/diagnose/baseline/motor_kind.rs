//! The kind of motor that the first throws of a machine show, against the configured one.

use serde::{Deserialize, Serialize};

use crate::{
    diagnose::{Observation, Parameters},
    estimate::Motor,
};

/// Number of first throws of each direction that decide.
const FIRST: u8 = 12;
/// Least number of these throws that show another kind, in each direction. Levers between motor and toe, or a position
/// sensor that is not linear, change the speed along the stroke as a load does, but as the opposite load in the other
/// direction.
const LEAST: u8 = 8;

/// The first throws of each direction, in one byte, as a fleet has many monitors: the lower four bits are their number,
/// the upper four bits the number of those that show another kind of motor than the configured one.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct ShownMotor([u8; 2]);

/// One throw of another kind.
const OTHER: u8 = 16;

impl ShownMotor {
    /// Adds a throw of a machine in service.
    pub(crate) fn learn(&mut self, observation: &Observation, parameters: Option<Parameters>) {
        let features = &observation.features;
        let is_whole = observation.covers_stroke() && features.travel_mm.is_some() && features.duration_s.is_some();
        let Some(direction) = observation.direction.filter(|_| is_whole) else { return };
        let counts = &mut self.0[direction.side()];
        if *counts % OTHER < FIRST {
            let is_other = features.motor.is_some_and(|motor| motor != configured(parameters));
            *counts += 1 + if is_other { OTHER } else { 0 };
        }
    }

    /// The kind that the throws show, if it is not the configured one.
    pub(crate) fn other(self, parameters: Option<Parameters>) -> Option<Motor> {
        let is_other = self.0.iter().all(|counts| counts / OTHER >= LEAST);
        is_other.then(|| match configured(parameters) {
            Motor::PermanentMagnet => Motor::Series,
            Motor::Series | Motor::ThreePhase => Motor::PermanentMagnet,
        })
    }
}

fn configured(parameters: Option<Parameters>) -> Motor {
    parameters.map(|parameters| parameters.motor).unwrap_or_default()
}
