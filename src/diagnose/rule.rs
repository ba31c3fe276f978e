//! The rule that owns an alarm: several rules raise the same alarm, and only the owner ends it.

use serde::{Deserialize, Serialize};

/// The rule that owns an active alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Rule {
    /// The usual rule of the cause; for a drift, that of the windows of coefficients.
    #[default]
    Usual,
    /// Changed features of throws without coefficients.
    Features,
    /// A changed start of the movement.
    Start,
    /// Departures of some throws.
    Intermittent,
    /// Dates of throws that a right clock cannot give.
    Dates,
    /// Gauges that show a faulty sensor.
    Gauges,
    /// An offset of a sensor.
    #[serde(rename = "rest")]
    Offset,
    /// A changed resistance of the motor and its line to the supply.
    Circuit,
}

impl Rule {
    /// Whether an alarm of this rule knows no part: it ends when a part is named.
    pub(super) const fn knows_no_part(self) -> bool {
        matches!(self, Self::Features | Self::Start)
    }
}
