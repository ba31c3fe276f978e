//! JSON of numbers, of a channel and of the supply voltage. The error of a text in their place repeats only its start:
//! that of serde repeats the whole text, which may be as long as the message.

use std::fmt;

use serde::{
    Deserialize, Deserializer,
    de::{self, Expected, SeqAccess, Unexpected, Visitor, value::SeqAccessDeserializer},
};
use serde_json::Number;

use crate::throw::MAX_SAMPLES;

/// The start of a received text, for an error message.
pub(super) fn start(text: &str) -> String {
    text.chars().take(40).collect()
}

/// The error of a text in place of another value.
fn wrong_text<E: de::Error>(text: &str, expected: &dyn Expected) -> E {
    E::invalid_type(Unexpected::Str(&start(text)), expected)
}

/// A number.
struct AnyNumber(Number);

impl<'de> Deserialize<'de> for AnyNumber {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visit;
        impl Visitor<'_> for Visit {
            type Value = AnyNumber;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number")
            }

            fn visit_f64<E: de::Error>(self, value: f64) -> Result<AnyNumber, E> {
                let number = Number::from_f64(value).map(AnyNumber);
                number.ok_or_else(|| E::invalid_value(Unexpected::Float(value), &self))
            }

            fn visit_u64<E>(self, value: u64) -> Result<AnyNumber, E> {
                Ok(AnyNumber(value.into()))
            }

            fn visit_i64<E>(self, value: i64) -> Result<AnyNumber, E> {
                Ok(AnyNumber(value.into()))
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<AnyNumber, E> {
                Err(wrong_text(text, &self))
            }
        }
        deserializer.deserialize_any(Visit)
    }
}

/// A number, or `None` for null.
pub(super) fn optional_number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    Ok(Option::<AnyNumber>::deserialize(deserializer)?.and_then(|AnyNumber(number)| number.as_f64()))
}

/// The allowed values of a [`Count`], for error messages.
pub(super) const COUNT: &str = "a whole number from 0 to 2^63 - 1, above 2^53 without point and exponent";

/// A whole number; the form 7.0, which some languages write, is accepted too.
#[derive(Debug, Deserialize)]
#[serde(try_from = "AnyNumber")]
pub(super) struct Count(pub(super) u64);

impl TryFrom<AnyNumber> for Count {
    type Error = String;

    fn try_from(AnyNumber(number): AnyNumber) -> Result<Self, String> {
        // Beyond 2^53 a float does not represent every whole number.
        let is_whole = |value: &f64| value.fract() == 0.0 && (0.0..=9_007_199_254_740_992.0).contains(value);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be exact")]
        let whole = || number.as_f64().filter(is_whole).map(|value| value as u64);
        let count = number.as_u64().or_else(whole);
        count.map(Self).ok_or_else(|| format!("{number}, must be {COUNT}"))
    }
}

/// A channel. A sample that was not measured is NaN, and null in JSON.
#[derive(Debug)]
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
                while let Some(sample) = sequence.next_element::<Option<AnyNumber>>()? {
                    let sample = sample.and_then(|AnyNumber(number)| number.as_f64());
                    if samples.len() == MAX_SAMPLES {
                        return Err(de::Error::invalid_length(MAX_SAMPLES + 1, &self));
                    }
                    samples.push(sample.unwrap_or(f64::NAN));
                }
                Ok(Channel(samples))
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Channel, E> {
                Err(wrong_text(text, &self))
            }
        }
        // Not `deserialize_seq`, whose error repeats a text.
        deserializer.deserialize_any(Visit)
    }
}

/// The supply voltage \[V\]: a number, or a value for each sample of the current.
#[derive(Debug)]
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

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Supply, E> {
                Err(wrong_text(text, &self))
            }
        }
        deserializer.deserialize_any(Visit)
    }
}
