//! A throw of the points: its machine, time and direction, and its recorded trace.
//!
//! *Normal* and *reverse* are the two end positions. Position is measured at the toe, 0 mm at normal and the stroke at
//! reverse, so a throw from normal to reverse moves towards larger values.

mod machine;
mod range;
mod trace;

use std::fmt;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

pub use machine::{InvalidName, MachineId, Name};
pub use range::OutOfRange;
pub use trace::{InvalidTrace, MAX_SAMPLE_RATE_HZ, MAX_SAMPLES, MIN_SAMPLE_RATE_HZ, Trace};

/// The way in which a throw moves the toe.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Hash,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    strum::IntoStaticStr,
    strum::EnumString,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Direction {
    /// From normal (0 mm) to reverse (the stroke).
    NormalToReverse,
    /// From reverse (the stroke) to normal (0 mm).
    ReverseToNormal,
}

impl Direction {
    /// Both directions, normal to reverse first.
    pub const BOTH: [Self; 2] = [Self::NormalToReverse, Self::ReverseToNormal];

    /// The word used in messages and in the database.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        self.into()
    }

    /// +1 when the throw increases the toe position, -1 when it decreases it.
    #[must_use]
    pub const fn sign(self) -> f64 {
        match self {
            Self::NormalToReverse => 1.0,
            Self::ReverseToNormal => -1.0,
        }
    }

    /// The other direction.
    #[must_use]
    pub const fn opposite(self) -> Self {
        match self {
            Self::NormalToReverse => Self::ReverseToNormal,
            Self::ReverseToNormal => Self::NormalToReverse,
        }
    }
}

/// Plain words, for people: "normal to reverse".
impl fmt::Display for Direction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NormalToReverse => "normal to reverse",
            Self::ReverseToNormal => "reverse to normal",
        })
    }
}

/// Identity of a throw within its machine: the boot of the logger and the sequence number within that boot.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ThrowRef {
    /// New at each start of the logger.
    pub boot_id: String,
    /// Sequence number: increases by 1 with each throw of a boot.
    pub throw_no: u64,
}

/// A throw as its logger recorded it.
#[derive(Debug, Clone, PartialEq)]
pub struct Throw {
    /// Identity within its machine.
    pub id: ThrowRef,
    /// Wall time of the first sample (UTC).
    pub started_at: Timestamp,
    /// The direction that the logger declared; `None` when it does not know.
    pub direction: Option<Direction>,
    /// Motor current and toe position.
    pub trace: Trace,
    /// Ambient or machine temperature \[°C\].
    pub temperature_c: Option<f64>,
    /// Supply voltage during the throw \[V\].
    pub supply_v: Option<f64>,
    /// Cut-off of the anti-alias filter that both channels passed \[Hz\].
    pub anti_alias_hz: Option<f64>,
}
