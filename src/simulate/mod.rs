//! The simulated point machine, and simulated fleets. It shares only the throw type with the monitor, so that
//! the monitor is never tested against its own model. The numbers of equations are those of the paper that `estimate`
//! names.
//!
//! | file | what it holds |
//! |---|---|
//! | `machine` | the parameters, and the coefficients that follow from them |
//! | `rails` | the switch rails: finite elements, reduced to modes |
//! | `dynamics` | the linear part of the mechanics, discretised exactly |
//! | `friction` | dry friction with sticking |
//! | `drive` | the drive between screw and toe, with its friction clutch |
//! | `supply` | the supply voltage over time |
//! | `motion` | one throw, step by step |
//! | `filter` | the logger's anti-alias filter |
//! | `sensors` | from the true motion to the recorded trace |
//! | `fault` | faults of a machine |
//! | `fleet` | many machines, their weather and wear |

mod drive;
mod dynamics;
mod fault;
mod filter;
mod fleet;
mod friction;
mod machine;
mod motion;
mod rails;
mod sensors;
mod supply;

pub use fault::{Condition, Fault, Part, Shape};
pub use fleet::{
    FleetClimate, FleetFault, FleetScatter, FleetSettings, Incident, IncidentKind, SimulatedMachine, Spread,
};
pub use machine::{Coefficients, MotorKind, Parameters};
pub use motion::{Conditions, Motion, STEP_S};
pub use rails::{MAX_MODES, RailModel, Rails};
pub use sensors::{Recording, Sensor, Sensors, Stuck};
pub use supply::Waveform;
