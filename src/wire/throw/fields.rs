//! The fields of a throw message in CBOR and JSON, and their checks.

use jiff::Timestamp;
use serde::Deserialize;

use super::{
    super::Invalid,
    values::{self, Channel, Count, Supply},
};
use crate::throw::{Direction, Throw, ThrowRef, Trace};

/// Name and version of the message; no other is accepted.
pub(super) const SCHEMA: &str = "points.throw/1";
/// The direction in a message if it is not known.
pub(in crate::wire) const UNKNOWN_DIRECTION: &str = "unknown";
/// Longest `boot_id` \[bytes\]: enough for a UUID or a serial number. Indexes of the database contain it.
const MAX_BOOT_ID_BYTES: usize = 128;
/// Highest `throw_no`: the database stores a signed 64-bit integer.
const MAX_THROW_NO: u64 = i64::MAX as u64;

/// The fields of a throw message; `None` for a missing field or null.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Fields {
    pub(super) schema: Option<String>,
    pub(super) boot_id: Option<String>,
    pub(super) throw_no: Option<Count>,
    pub(super) started_at: Option<String>,
    pub(super) direction: Option<String>,
    #[serde(deserialize_with = "values::optional_number")]
    pub(super) sample_rate_hz: Option<f64>,
    pub(super) current_a: Option<Channel>,
    pub(super) position_mm: Option<Channel>,
    #[serde(deserialize_with = "values::optional_number")]
    pub(super) temperature_c: Option<f64>,
    pub(super) supply_v: Option<Supply>,
    #[serde(deserialize_with = "values::optional_number")]
    pub(super) anti_alias_hz: Option<f64>,
}

impl Fields {
    pub(super) fn into_throw(self) -> Result<Throw, Invalid> {
        let schema = required("schema", self.schema)?;
        if schema != SCHEMA {
            return Err(wrong("schema", &format!("{}, must be \"{SCHEMA}\"", quote(&schema))));
        }
        let id = ThrowRef {
            boot_id: boot_id(required("boot_id", self.boot_id)?)?,
            throw_no: throw_no(required("throw_no", self.throw_no)?.0)?,
        };
        let Channel(current_a) = required("current_a", self.current_a)?;
        // A logger without a toe sensor may leave the channel out.
        let position_mm = self.position_mm.map_or_else(|| vec![f64::NAN; current_a.len()], |channel| channel.0);
        let supply_v = self.supply_v.map(|supply| supply_v(supply, &current_a)).transpose()?;
        let trace = Trace::new(required("sample_rate_hz", self.sample_rate_hz)?, current_a, position_mm)
            .map_err(|error| Invalid(error.to_string()))?;
        Ok(Throw {
            id,
            started_at: started_at(&required("started_at", self.started_at)?)?,
            direction: direction(self.direction.as_deref())?,
            trace,
            temperature_c: self.temperature_c.filter(|value| value.is_finite()),
            supply_v: supply_v.filter(|value| value.is_finite()),
            anti_alias_hz: self.anti_alias_hz.filter(|value| value.is_finite()),
        })
    }
}

fn required<T>(field: &str, value: Option<T>) -> Result<T, Invalid> {
    value.ok_or_else(|| Invalid(format!("the field {field} is missing")))
}

/// The error of a field. `problem` names the value and the allowed values.
pub(super) fn wrong(field: &str, problem: &str) -> Invalid {
    Invalid(format!("{field}: {problem}"))
}

/// A received text, escaped and cut for an error message.
fn quote(text: &str) -> String {
    format!("{:?}", values::start(text))
}

/// The supply voltage of the throw \[V\]. For samples it is their mean weighted with the current, so that the energy of
/// the motor is correct. NaN if no sample was measured while current flowed.
fn supply_v(supply: Supply, current_a: &[f64]) -> Result<f64, Invalid> {
    let samples = match supply {
        Supply::Number(value) => return Ok(value),
        Supply::Samples(Channel(samples)) => samples,
    };
    if samples.len() != current_a.len() {
        let problem =
            format!("{} values, must be a number or as many as current_a ({})", samples.len(), current_a.len());
        return Err(wrong("supply_v", &problem));
    }
    let measured = samples.iter().zip(current_a).filter(|(volts, amperes)| volts.is_finite() && amperes.is_finite());
    let (sum, weight) = measured
        .fold((0.0, 0.0), |(sum, weight), (volts, amperes)| (sum + volts * amperes.abs(), weight + amperes.abs()));
    Ok(sum / weight)
}

/// Whether a text can be a `boot_id`.
pub fn is_boot_id(text: &str) -> bool {
    (1..=MAX_BOOT_ID_BYTES).contains(&text.len()) && !text.chars().any(char::is_control)
}

fn boot_id(text: String) -> Result<String, Invalid> {
    if !is_boot_id(&text) {
        let problem = format!("{}, must be 1 to {MAX_BOOT_ID_BYTES} bytes without control characters", quote(&text));
        return Err(wrong("boot_id", &problem));
    }
    Ok(text)
}

fn throw_no(value: u64) -> Result<u64, Invalid> {
    if value > MAX_THROW_NO {
        return Err(wrong("throw_no", &format!("{value}, must be at most {MAX_THROW_NO}")));
    }
    Ok(value)
}

/// Truncated to microseconds as in the database, so that the times of a throw in messages, queries and views are equal.
fn started_at(text: &str) -> Result<Timestamp, Invalid> {
    let parsed = text.parse::<Timestamp>().ok().filter(|time| {
        // Years before 0000 are outside of RFC 3339 and of SQL's date functions.
        time.as_second() >= -62_167_219_200
    });
    let truncated = parsed.and_then(|time| Timestamp::from_microsecond(time.as_microsecond()).ok());
    truncated.ok_or_else(|| {
        let problem = format!(
            "{}, must be RFC 3339 with Z or an offset, as 2026-05-04T10:11:12.345Z, and before 9999-12-30T22:00:00Z",
            quote(text)
        );
        wrong("started_at", &problem)
    })
}

fn direction(word: Option<&str>) -> Result<Option<Direction>, Invalid> {
    match word {
        None | Some(UNKNOWN_DIRECTION) => Ok(None),
        Some(word) => word.parse().map(Some).map_err(|_| {
            let problem = format!("{}, must be normal_to_reverse, reverse_to_normal or unknown", quote(word));
            wrong("direction", &problem)
        }),
    }
}
