//! A throw of the points: its machine, time and direction, and its recorded trace.
//!
//! *Normal* and *reverse* are the two end positions. Position is measured at the toe, 0 mm at normal and the stroke at
//! reverse, so a throw from normal to reverse moves towards larger values.

mod machine;
mod range;
mod settings;
mod text;
mod trace;

use std::fmt;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

pub use machine::{InvalidName, MachineId, Name};
pub use range::OutOfRange;
pub(crate) use range::Range;
pub(crate) use settings::{Number, settings};
pub use text::{brief, utc};
pub(crate) use text::{counted, rounded, without_digits};
pub use trace::{Channel, InvalidTrace, MAX_SAMPLE_RATE_HZ, MAX_SAMPLES, MIN_SAMPLE_RATE_HZ, Trace};

/// Direction of a throw.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, strum::IntoStaticStr, strum::EnumString)]
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

    /// The word in messages and in the database: `normal_to_reverse` or `reverse_to_normal`.
    pub fn as_str(self) -> &'static str {
        self.into()
    }

    /// +1 if the toe position increases in the throw, -1 if it decreases.
    pub const fn sign(self) -> f64 {
        match self {
            Self::NormalToReverse => 1.0,
            Self::ReverseToNormal => -1.0,
        }
    }

    /// Index of the direction, as in [`Self::BOTH`].
    pub const fn side(self) -> usize {
        self as usize
    }

    /// The opposite direction.
    #[must_use]
    pub const fn other(self) -> Self {
        Self::BOTH[1 - self.side()]
    }
}

/// The text for people: "normal to reverse".
impl fmt::Display for Direction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NormalToReverse => "normal to reverse",
            Self::ReverseToNormal => "reverse to normal",
        })
    }
}

/// Identity of a throw among the throws of its machine: the boot of the logger, and the sequence number in this boot.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Default, Serialize, Deserialize)]
pub struct ThrowRef {
    /// Identifier of the boot. The logger makes a new one at each start.
    pub boot_id: String,
    /// Sequence number of the throw; it increases by 1 with each throw of a boot.
    pub throw_no: u64,
}

/// A throw as its logger recorded it.
#[derive(Debug, Clone, PartialEq)]
pub struct Throw {
    /// Boot and sequence number.
    pub id: ThrowRef,
    /// Time of the first sample (UTC).
    pub started_at: Timestamp,
    /// Direction as the logger declared it; `None` for "unknown".
    pub direction: Option<Direction>,
    /// Motor current and toe position.
    pub trace: Trace,
    /// Temperature of the machine or of its surroundings \[°C\]; `None` if the logger does not measure it.
    pub temperature_c: Option<f64>,
    /// Mean supply voltage during the throw \[V\]; `None` if the logger does not measure it.
    pub supply_v: Option<f64>,
    /// Cut-off of the anti-alias filter of both channels \[Hz\]; `None` if the logger declares no filter.
    pub anti_alias_hz: Option<f64>,
}

/// Units in which a logger may send the position by mistake \[mm\].
pub(crate) const CENTIMETRE_MM: f64 = 10.0;
pub(crate) const INCH_MM: f64 = 25.4;
/// Possible temperatures of a machine \[°C\]: from the coldest place with rails to a machine in the sun.
pub const POSSIBLE_C: std::ops::RangeInclusive<f64> = -60.0..=90.0;
/// Possible supply voltages \[V\]: point machines have 20 to 400 V. Outside this range the sensor has failed.
pub const POSSIBLE_SUPPLY_V: std::ops::RangeInclusive<f64> = 5.0..=1000.0;

impl Throw {
    /// A throw whose trace alone is known, as from a recording. Its identity is arbitrary, and its time is in 1970.
    pub fn recorded(trace: Trace) -> Self {
        Self {
            id: ThrowRef { boot_id: "recorded".to_owned(), throw_no: 1 },
            started_at: Timestamp::UNIX_EPOCH,
            direction: None,
            trace,
            temperature_c: None,
            supply_v: None,
            anti_alias_hz: None,
        }
    }

    /// The supply voltage \[V\], if it was measured and is within [`POSSIBLE_SUPPLY_V`].
    pub fn possible_supply_v(&self) -> Option<f64> {
        self.supply_v.filter(|volts| POSSIBLE_SUPPLY_V.contains(volts))
    }

    /// The cut-off of the filter \[Hz\], if it is declared and possible at the sampling rate `rate_hz`. A filter with a
    /// cut-off above half of this rate suppresses no alias.
    pub fn possible_anti_alias_hz(&self, rate_hz: f64) -> Option<f64> {
        self.anti_alias_hz.filter(|hz| *hz > 0.0 && *hz <= 0.5 * rate_hz * 1.0001)
    }

    /// The optional fields whose values are not possible.
    pub fn impossible_fields(&self) -> Vec<OutOfRange> {
        let mut fields = Vec::new();
        let mut add = |key: &str, value, must| {
            fields.push(OutOfRange { key: key.to_owned(), value: rounded(value), must });
        };
        if let Some(hz) =
            self.anti_alias_hz.filter(|_| self.possible_anti_alias_hz(self.trace.sample_rate_hz()).is_none())
        {
            let half = brief(rounded(0.5 * self.trace.sample_rate_hz()));
            add("anti_alias_hz", hz, format!("above 0 and up to {half} Hz, half of sample_rate_hz"));
        }
        if let Some(volts) = self.supply_v.filter(|_| self.possible_supply_v().is_none()) {
            add("supply_v", volts, format!("{} to {} V", POSSIBLE_SUPPLY_V.start(), POSSIBLE_SUPPLY_V.end()));
        }
        if let Some(celsius) = self.temperature_c.filter(|celsius| !POSSIBLE_C.contains(celsius)) {
            add("temperature_c", celsius, format!("{} to {} °C", POSSIBLE_C.start(), POSSIBLE_C.end()));
        }
        fields
    }

    /// A sentence about [`Self::impossible_fields`], which are not used; `None` if there are none.
    pub fn unused_fields(&self) -> Option<String> {
        let sentences: Vec<_> =
            self.impossible_fields().iter().map(|field| format!("{field}, and is not used")).collect();
        (!sentences.is_empty()).then(|| sentences.join("; "))
    }
}
