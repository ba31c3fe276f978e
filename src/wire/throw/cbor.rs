//! Throws in CBOR (RFC 8949); the channels are plain arrays or typed arrays (RFC 8746).

use std::convert::Infallible;

use minicbor::{
    Decoder, Encoder,
    data::{Tag, Type},
    decode::Error as DecodeError,
    encode::Error as EncodeError,
};

use super::{
    super::Invalid,
    fields::{self, Fields, SCHEMA, UNKNOWN_DIRECTION},
    values::{COUNT, Channel, Count, Supply},
};
use crate::throw::{Direction, MAX_SAMPLES, Throw};

/// Tag "self-described CBOR" (RFC 8949, 3.4.6), which some encoders put before the map.
const SELF_DESCRIBED: Tag = Tag::new(55799);
/// Tag of a text that is an RFC 3339 time (RFC 8949, 3.4.1): some encoders put it before a value of a date type.
const TIME: Tag = Tag::new(0);
/// Typed array of little-endian float32 (RFC 8746, table 4).
const F32_LITTLE_ENDIAN: Tag = Tag::new(85);
/// Typed array of little-endian float64.
const F64_LITTLE_ENDIAN: Tag = Tag::new(86);
/// Largest nesting depth in ignored fields.
const MAX_DEPTH: usize = 16;
/// Longest text of a field \[bytes\].
const MAX_TEXT_BYTES: usize = 4096;

/// Decodes a message. After an error the fields before it are returned too, for boot and number of the rejected throw.
pub(super) fn decode(payload: &[u8]) -> (Fields, Result<(), Invalid>) {
    let mut decoder = Decoder::new(payload);
    let mut fields = Fields::default();
    let read = read(&mut decoder, &mut fields).map_err(|failure| failure.at(decoder.position()));
    let rest = payload.len() - decoder.position();
    let is_whole = read.and_then(|()| match rest {
        0 => Ok(()),
        _ => Err(Failure::Bytes(format!("{rest} bytes follow the message")).at(decoder.position())),
    });
    (fields, is_whole)
}

/// Invalid CBOR, or an invalid field.
enum Failure {
    Bytes(String),
    Field(Invalid),
}

impl Failure {
    fn at(self, position: usize) -> Invalid {
        match self {
            Self::Bytes(problem) => Invalid(format!("not valid CBOR at byte {position}: {problem}")),
            Self::Field(error) => error,
        }
    }
}

impl From<DecodeError> for Failure {
    fn from(error: DecodeError) -> Self {
        Self::Bytes(error.to_string())
    }
}

type Decoded<T> = Result<T, Failure>;

fn wrong(field: &str, problem: impl Into<String>) -> Failure {
    Failure::Field(fields::wrong(field, &problem.into()))
}

fn read(decoder: &mut Decoder<'_>, fields: &mut Fields) -> Decoded<()> {
    if decoder.datatype()? == Type::Tag && decoder.tag()? != SELF_DESCRIBED {
        return Err(Failure::Bytes("a tag where the map of a throw should begin".into()));
    }
    let mut left = decoder.map()?;
    while next_item(decoder, &mut left)? {
        match key(decoder)?.as_deref() {
            Some("schema") => set(decoder, "schema", &mut fields.schema, text)?,
            Some("boot_id") => set(decoder, "boot_id", &mut fields.boot_id, text)?,
            Some("throw_no") => set(decoder, "throw_no", &mut fields.throw_no, count)?,
            Some("started_at") => set(decoder, "started_at", &mut fields.started_at, time)?,
            Some("direction") => set(decoder, "direction", &mut fields.direction, text)?,
            Some("sample_rate_hz") => set(decoder, "sample_rate_hz", &mut fields.sample_rate_hz, float)?,
            Some("current_a") => set(decoder, "current_a", &mut fields.current_a, channel)?,
            Some("position_mm") => set(decoder, "position_mm", &mut fields.position_mm, channel)?,
            Some("temperature_c") => set(decoder, "temperature_c", &mut fields.temperature_c, float)?,
            Some("supply_v") => set(decoder, "supply_v", &mut fields.supply_v, supply)?,
            Some("anti_alias_hz") => set(decoder, "anti_alias_hz", &mut fields.anti_alias_hz, float)?,
            _ => skip(decoder, MAX_DEPTH)?,
        }
    }
    Ok(())
}

/// Whether another item follows in an array or map, which has `left` more items, or an indefinite length (`None`).
/// Skips the break at the end of an indefinite length.
fn next_item(decoder: &mut Decoder<'_>, left: &mut Option<u64>) -> Decoded<bool> {
    match left {
        Some(0) => Ok(false),
        Some(count) => {
            *count -= 1;
            Ok(true)
        }
        None if decoder.datatype()? == Type::Break => {
            decoder.set_position(decoder.position() + 1);
            Ok(false)
        }
        None => Ok(true),
    }
}

/// A key of the message's map; `None` for a key that is not a text, whose value is ignored.
fn key(decoder: &mut Decoder<'_>) -> Decoded<Option<String>> {
    match decoder.datatype()? {
        Type::String | Type::StringIndef => Ok(Some(joined_text(decoder)?)),
        _ => {
            skip(decoder, MAX_DEPTH)?;
            Ok(None)
        }
    }
}

/// A text of definite or indefinite length, at most [`MAX_TEXT_BYTES`] long.
fn joined_text(decoder: &mut Decoder<'_>) -> Decoded<String> {
    let mut text = String::new();
    for part in decoder.str_iter()? {
        let part = part?;
        if text.len() + part.len() > MAX_TEXT_BYTES {
            return Err(Failure::Bytes(format!("a text is longer than {MAX_TEXT_BYTES} bytes")));
        }
        text.push_str(part);
    }
    Ok(text)
}

/// Reads the value of a field; null and undefined leave it unset.
fn set<T>(
    decoder: &mut Decoder<'_>,
    field: &str,
    slot: &mut Option<T>,
    read: impl FnOnce(&mut Decoder<'_>, &str) -> Decoded<T>,
) -> Decoded<()> {
    if slot.is_some() {
        return Err(wrong(field, "given twice"));
    }
    match decoder.datatype()? {
        Type::Null | Type::Undefined => skip(decoder, 1)?,
        _ => *slot = Some(read(decoder, field)?),
    }
    Ok(())
}

/// The name of a type in words: minicbor gives the name of the encoding, such as `u8`.
fn named(value: Type) -> String {
    let words = match value {
        Type::U8 | Type::U16 | Type::U32 | Type::U64 => "a whole number",
        Type::I8 | Type::I16 | Type::I32 | Type::I64 | Type::Int => "a negative number",
        Type::F16 | Type::F32 | Type::F64 => "a floating-point number",
        Type::String | Type::StringIndef => "a text",
        Type::Array | Type::ArrayIndef => "an array",
        other => return other.to_string(),
    };
    words.to_owned()
}

fn text(decoder: &mut Decoder<'_>, field: &str) -> Decoded<String> {
    match decoder.datatype()? {
        Type::String | Type::StringIndef => joined_text(decoder),
        other => Err(wrong(field, format!("{}, must be a text", named(other)))),
    }
}

/// A time as text, with or without [`TIME`].
fn time(decoder: &mut Decoder<'_>, field: &str) -> Decoded<String> {
    match decoder.datatype()? {
        Type::Tag if decoder.tag()? != TIME => Err(wrong(field, "a number of seconds or another tag, must be a text")),
        _ => text(decoder, field),
    }
}

fn count(decoder: &mut Decoder<'_>, field: &str) -> Decoded<Count> {
    match decoder.datatype()? {
        Type::U8 | Type::U16 | Type::U32 | Type::U64 => Ok(Count(decoder.u64()?)),
        other => Err(wrong(field, format!("{}, must be {COUNT}", named(other)))),
    }
}

fn supply(decoder: &mut Decoder<'_>, field: &str) -> Decoded<Supply> {
    match decoder.datatype()? {
        Type::Tag | Type::Array | Type::ArrayIndef => channel(decoder, field).map(Supply::Samples),
        _ => float(decoder, field).map(Supply::Number),
    }
}

/// A number of any type; null and undefined are NaN.
fn float(decoder: &mut Decoder<'_>, field: &str) -> Decoded<f64> {
    match decoder.datatype()? {
        Type::F16 | Type::F32 | Type::F64 => Ok(decoder.f64()?),
        Type::U8 | Type::U16 | Type::U32 | Type::U64 | Type::I8 | Type::I16 | Type::I32 | Type::I64 | Type::Int => {
            Ok(i128::from(decoder.int()?) as f64)
        }
        Type::Null | Type::Undefined => {
            skip(decoder, 1)?;
            Ok(f64::NAN)
        }
        other => Err(wrong(field, format!("{}, must be a number", named(other)))),
    }
}

fn channel(decoder: &mut Decoder<'_>, field: &str) -> Decoded<Channel> {
    match decoder.datatype()? {
        Type::Tag => typed_array(decoder, field),
        Type::Array | Type::ArrayIndef => plain_array(decoder, field),
        other => Err(wrong(field, format!("{}, must be an array or a typed array", named(other)))),
    }
    .map(Channel)
}

fn plain_array(decoder: &mut Decoder<'_>, field: &str) -> Decoded<Vec<f64>> {
    let mut left = decoder.array()?;
    if left.is_some_and(|length| length > MAX_SAMPLES as u64) {
        return Err(too_many(field));
    }
    // The declared length may be wrong. Every sample takes at least one byte, so the bytes left bound the capacity.
    let bytes_left = decoder.input().len() - decoder.position();
    let declared = left.and_then(|length| usize::try_from(length).ok()).unwrap_or(0);
    let mut samples = Vec::with_capacity(declared.min(bytes_left));
    while next_item(decoder, &mut left)? {
        if samples.len() == MAX_SAMPLES {
            return Err(too_many(field));
        }
        samples.push(float(decoder, field)?);
    }
    Ok(samples)
}

fn typed_array(decoder: &mut Decoder<'_>, field: &str) -> Decoded<Vec<f64>> {
    let tag = decoder.tag()?;
    if decoder.datatype()? != Type::Bytes {
        return Err(wrong(field, "a typed array must be one byte string of definite length"));
    }
    let bytes = decoder.bytes()?;
    let width = match tag {
        F32_LITTLE_ENDIAN => 4,
        F64_LITTLE_ENDIAN => 8,
        other => {
            let problem = format!("typed array with tag {}, must be 85 (float32) or 86 (float64)", other.as_u64());
            return Err(wrong(field, problem));
        }
    };
    if bytes.len() % width != 0 {
        return Err(wrong(field, format!("{} bytes are not a whole number of {width}-byte samples", bytes.len())));
    }
    if bytes.len() / width > MAX_SAMPLES {
        return Err(too_many(field));
    }
    Ok(if width == 4 {
        bytes.as_chunks::<4>().0.iter().map(|sample| f64::from(f32::from_le_bytes(*sample))).collect()
    } else {
        bytes.as_chunks::<8>().0.iter().map(|sample| f64::from_le_bytes(*sample)).collect()
    })
}

fn too_many(field: &str) -> Failure {
    wrong(field, format!("more than {MAX_SAMPLES} samples"))
}

/// Skips one item of any type, nested at most `depth` deep.
fn skip(decoder: &mut Decoder<'_>, depth: usize) -> Decoded<()> {
    if depth == 0 {
        return Err(Failure::Bytes(format!("nested deeper than {MAX_DEPTH}")));
    }
    match decoder.datatype()? {
        Type::Array | Type::ArrayIndef => {
            let mut left = decoder.array()?;
            while next_item(decoder, &mut left)? {
                skip(decoder, depth - 1)?;
            }
        }
        Type::Map | Type::MapIndef => {
            let mut left = decoder.map()?;
            while next_item(decoder, &mut left)? {
                skip(decoder, depth - 1)?;
                skip(decoder, depth - 1)?;
            }
        }
        Type::Tag => {
            decoder.tag()?;
            skip(decoder, depth - 1)?;
        }
        Type::Bytes | Type::BytesIndef => decoder.bytes_iter()?.try_for_each(|part| part.map(drop))?,
        Type::String | Type::StringIndef => decoder.str_iter()?.try_for_each(|part| part.map(drop))?,
        Type::Break => return Err(Failure::Bytes("a break where a value should be".into())),
        Type::Unknown(byte) => return Err(Failure::Bytes(format!("byte {byte:#04x} does not begin a value"))),
        // Numbers, booleans, null and simple values are one token.
        _ => decoder.skip()?,
    }
    Ok(())
}

/// Encodes a throw in CBOR, with little-endian float32 typed arrays (RFC 8746).
#[expect(
    clippy::expect_used,
    clippy::missing_panics_doc,
    reason = "it never fails, and a receiver could take an empty message for a valid one"
)]
pub fn encode(throw: &Throw) -> Vec<u8> {
    let mut encoder = Encoder::new(Vec::with_capacity(256 + 8 * throw.trace.len()));
    write(&mut encoder, throw).expect("every throw has a CBOR form");
    encoder.into_writer()
}

fn write(encoder: &mut Encoder<Vec<u8>>, throw: &Throw) -> Result<(), EncodeError<Infallible>> {
    let optional =
        [("temperature_c", throw.temperature_c), ("supply_v", throw.supply_v), ("anti_alias_hz", throw.anti_alias_hz)];
    let present = optional.iter().filter(|(_, value)| value.is_some()).count() as u64;
    encoder.map(8 + present)?;
    encoder.str("schema")?.str(SCHEMA)?;
    encoder.str("boot_id")?.str(&throw.id.boot_id)?;
    encoder.str("throw_no")?.u64(throw.id.throw_no)?;
    encoder.str("started_at")?.str(&throw.started_at.to_string())?;
    encoder.str("direction")?.str(throw.direction.map_or(UNKNOWN_DIRECTION, Direction::as_str))?;
    encoder.str("sample_rate_hz")?.f64(throw.trace.sample_rate_hz())?;
    for (field, samples) in [("current_a", throw.trace.current_a()), ("position_mm", throw.trace.position_mm())] {
        encoder.str(field)?.tag(F32_LITTLE_ENDIAN)?.bytes(&f32_bytes(samples))?;
    }
    for (field, value) in optional {
        if let Some(value) = value {
            encoder.str(field)?.f64(value)?;
        }
    }
    Ok(())
}

/// Encodes samples as float32: its 24 bits exceed the 12 to 16 bits of the sensors.
#[expect(clippy::cast_possible_truncation, reason = "the message's resolution is float32")]
fn f32_bytes(samples: &[f64]) -> Vec<u8> {
    samples.iter().flat_map(|sample| (*sample as f32).to_le_bytes()).collect()
}
