//! The texts of alarms and caveats: what happened, how certain it is, what to check, and the forecast.

mod blind;
mod daemon;
mod drift;
mod logger;
mod sensor;
mod throws;

pub(super) use blind::*;
pub(crate) use daemon::without_operator;
pub(super) use daemon::*;
pub(super) use drift::*;
pub(super) use logger::*;
pub(super) use sensor::*;
pub(super) use throws::*;

use crate::throw::Direction;

/// A text about a machine without details.
pub(super) fn machine(name: &str, sentence: &str) -> String {
    format!("Machine {name}: {sentence}")
}

/// "Machine 21B, normal to reverse"; "Machine 21B" for both directions.
pub(super) fn subject(name: &str, direction: Option<Direction>) -> String {
    match direction {
        Some(direction) => format!("Machine {name}, {direction}"),
        None => format!("Machine {name}"),
    }
}
