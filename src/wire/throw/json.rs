//! Throws in JSON.

use std::fmt;

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{self, SeqAccess, Visitor},
};

use super::{
    error::InvalidThrow,
    fields::{Fields, SCHEMA, Supply, UNKNOWN_DIRECTION},
};
use crate::{
    throw::{Direction, MAX_SAMPLES, Throw},
    wire::text::json,
};

#[derive(Deserialize)]
struct Read {
    schema: Option<String>,
    boot_id: Option<String>,
    throw_no: Option<Count>,
    started_at: Option<String>,
    direction: Option<String>,
    sample_rate_hz: Option<f64>,
    current_a: Option<Channel>,
    position_mm: Option<Channel>,
    temperature_c: Option<f64>,
    supply_v: Option<Voltage>,
    anti_alias_hz: Option<f64>,
}

/// The supply voltage, a number or an array.
#[derive(Deserialize)]
#[serde(untagged, expecting = "supply_v must be a number, or an array of numbers")]
enum Voltage {
    Number(f64),
    Samples(Channel),
}

pub(super) fn decode(payload: &[u8]) -> Result<Fields, InvalidThrow> {
    // serde_json rejects nesting beyond 128 and bytes after the value.
    let read: Read =
        serde_json::from_slice(payload).map_err(|error| InvalidThrow::Json { problem: error.to_string() })?;
    Ok(Fields {
        schema: read.schema,
        boot_id: read.boot_id,
        throw_no: read.throw_no.map(|count| count.0),
        started_at: read.started_at,
        direction: read.direction,
        sample_rate_hz: read.sample_rate_hz,
        current_a: read.current_a.map(|channel| channel.0),
        position_mm: read.position_mm.map(|channel| channel.0),
        temperature_c: read.temperature_c,
        supply_v: read.supply_v.map(|voltage| match voltage {
            Voltage::Number(value) => Supply::Number(value),
            Voltage::Samples(channel) => Supply::Samples(channel.0),
        }),
        anti_alias_hz: read.anti_alias_hz,
    })
}

/// A whole number, also in the form 7.0 of some languages.
struct Count(u64);

impl<'de> Deserialize<'de> for Count {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visit;
        impl Visitor<'_> for Visit {
            type Value = Count;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a whole number from 0")
            }

            fn visit_u64<E: de::Error>(self, value: u64) -> Result<Count, E> {
                Ok(Count(value))
            }

            fn visit_f64<E: de::Error>(self, value: f64) -> Result<Count, E> {
                // Beyond 2^53 a float does not represent every whole number.
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be exact")]
                if value.fract() == 0.0 && (0.0..=9_007_199_254_740_992.0).contains(&value) {
                    Ok(Count(value as u64))
                } else {
                    Err(E::invalid_value(de::Unexpected::Float(value), &self))
                }
            }
        }
        deserializer.deserialize_any(Visit)
    }
}

/// A channel; null is a sample that was not measured.
struct Channel(Vec<f64>);

impl<'de> Deserialize<'de> for Channel {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visit;
        impl<'de> Visitor<'de> for Visit {
            type Value = Channel;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "an array of at most {MAX_SAMPLES} numbers")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Channel, A::Error> {
                let mut samples = Vec::new();
                while let Some(sample) = sequence.next_element::<Option<f64>>()? {
                    if samples.len() == MAX_SAMPLES {
                        return Err(de::Error::invalid_length(MAX_SAMPLES + 1, &self));
                    }
                    samples.push(sample.unwrap_or(f64::NAN));
                }
                Ok(Channel(samples))
            }
        }
        deserializer.deserialize_seq(Visit)
    }
}

#[derive(Serialize)]
struct Written<'a> {
    schema: &'static str,
    boot_id: &'a str,
    throw_no: u64,
    started_at: jiff::Timestamp,
    direction: &'static str,
    sample_rate_hz: f64,
    #[serde(serialize_with = "write_channel")]
    current_a: &'a [f64],
    #[serde(serialize_with = "write_channel")]
    position_mm: &'a [f64],
    #[serde(skip_serializing_if = "Option::is_none")]
    temperature_c: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    supply_v: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    anti_alias_hz: Option<f64>,
}

/// `serde_json` writes NaN and infinities as null, which reads back as NaN.
fn write_channel<S: Serializer>(samples: &&[f64], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(samples.iter())
}

pub(super) fn encode(throw: &Throw) -> Vec<u8> {
    let written = Written {
        schema: SCHEMA,
        boot_id: &throw.id.boot_id,
        throw_no: throw.id.throw_no,
        started_at: throw.started_at,
        direction: throw.direction.map_or(UNKNOWN_DIRECTION, Direction::as_str),
        sample_rate_hz: throw.trace.sample_rate_hz(),
        current_a: throw.trace.current_a(),
        position_mm: throw.trace.position_mm(),
        temperature_c: throw.temperature_c,
        supply_v: throw.supply_v,
        anti_alias_hz: throw.anti_alias_hz,
    };
    json(&written).into_bytes()
}
