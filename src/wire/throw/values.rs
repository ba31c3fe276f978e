//! JSON of a whole number, of a channel and of the supply voltage.

use std::fmt;

use serde::{
    Deserialize, Deserializer, Serialize,
    de::{self, SeqAccess, Visitor, value::SeqAccessDeserializer},
};
use serde_json::Number;

use crate::throw::MAX_SAMPLES;

/// A whole number; the form 7.0, which some languages write, is accepted too.
#[derive(Debug, Serialize, Deserialize)]
#[serde(try_from = "Number")]
pub(super) struct Count(pub(super) u64);

impl TryFrom<Number> for Count {
    type Error = String;

    fn try_from(number: Number) -> Result<Self, String> {
        // Beyond 2^53 a float does not represent every whole number.
        let is_whole = |value: &f64| value.fract() == 0.0 && (0.0..=9_007_199_254_740_992.0).contains(value);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be exact")]
        let whole = || number.as_f64().filter(is_whole).map(|value| value as u64);
        let count = number.as_u64().or_else(whole);
        count.map(Self).ok_or_else(|| format!("{number}, must be a whole number from 0"))
    }
}

/// A channel. A sample that was not measured is NaN, and null in JSON: `serde_json` writes NaN and infinities as null.
#[derive(Debug, Serialize)]
pub(super) struct Channel(pub(super) Vec<f64>);

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

/// The supply voltage \[V\]: a number, or a value for each sample of the current.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub(super) enum Supply {
    Number(f64),
    Samples(Channel),
}

/// By hand: the derived decoder would first build a tree of the whole value, which takes 44 times as much memory as the
/// message.
impl<'de> Deserialize<'de> for Supply {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visit;
        impl<'de> Visitor<'de> for Visit {
            type Value = Supply;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number or an array of numbers")
            }

            fn visit_f64<E>(self, value: f64) -> Result<Supply, E> {
                Ok(Supply::Number(value))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Supply, E> {
                Ok(Supply::Number(value as f64))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Supply, E> {
                Ok(Supply::Number(value as f64))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, sequence: A) -> Result<Supply, A::Error> {
                Channel::deserialize(SeqAccessDeserializer::new(sequence)).map(Supply::Samples)
            }
        }
        deserializer.deserialize_any(Visit)
    }
}
