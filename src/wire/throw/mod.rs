//! The throw message, in CBOR (which `pointsim` sends) or JSON (easy from any language), with the same fields.
//!
//! Unknown fields are ignored; optional fields (`position_mm` among them) may be missing or null. Numbers may be
//! integers. In a channel, null is a sample that was not measured and becomes NaN. `started_at` is RFC 3339 with `Z` or
//! any numeric offset; `direction` may be missing, which means "unknown".

mod cbor;
mod fields;
mod values;

pub use cbor::encode as encode_throw;
pub(super) use fields::UNKNOWN_DIRECTION;
pub use fields::is_boot_id;

use super::{
    Invalid,
    text::{first_byte, not_an_object, without_byte_order_mark},
};
use crate::throw::{Throw, ThrowRef};
use values::Count;

/// Encoding of a throw message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// `application/cbor`.
    Cbor,
    /// `application/json`.
    Json,
}

impl Encoding {
    /// The encoding of a payload. If its first byte after white space is `{`, it is JSON whatever the content type,
    /// which many clients do not set: no CBOR map begins with this byte.
    pub fn of(content_type: &str, payload: &[u8]) -> Self {
        if first_byte(payload) == Some(b'{') || content_type.contains("json") { Self::Json } else { Self::Cbor }
    }
}

/// Decodes a throw.
///
/// # Errors
/// When the payload is not well-formed, a required field is missing, or a value is invalid.
pub fn decode_throw(encoding: Encoding, payload: &[u8]) -> Result<Throw, Invalid> {
    match encoding {
        Encoding::Cbor => {
            let (fields, is_whole) = cbor::decode(payload);
            is_whole.map(|()| fields)
        }
        Encoding::Json => {
            let payload = without_byte_order_mark(payload);
            // serde_json rejects nesting beyond 128 and bytes after the value.
            let decoded = match not_an_object(payload) {
                Some(problem) => Err(problem),
                None => serde_json::from_slice(payload).map_err(|error| problem(&error, payload)),
            };
            decoded.map_err(|problem| Invalid(format!("not a throw in JSON: {problem}")))
        }
    }?
    .into_throw()
}

/// The text of a JSON error with the name of the last field before it: `serde_json` names only the position.
fn problem(error: &serde_json::Error, payload: &[u8]) -> String {
    let lines = payload.split_inclusive(|byte| *byte == b'\n');
    let start: usize = lines.take(error.line().saturating_sub(1)).map(<[u8]>::len).sum();
    let at = (start + error.column()).min(payload.len());
    let before = &payload[..at];
    // A multi-byte character may be cut.
    let before = String::from_utf8_lossy(before);
    // Within a text, a quote before a colon is escaped with a backslash, which is not a character of a field name.
    let is_name = |name: &&str| name.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_');
    let name = |(at, _)| before[..at].trim_end().strip_suffix('"')?.rsplit('"').next().filter(is_name);
    let name = before.rmatch_indices(':').find_map(name);
    // The error is at the first or second byte of `NaN`, `Infinity` or `-Infinity`, which many languages write.
    let near = String::from_utf8_lossy(&payload[at.saturating_sub(2)..payload.len().min(at + 8)]);
    if let Some(word) = ["NaN", "Infinity"].into_iter().find(|word| error.is_syntax() && near.contains(word)) {
        let field = name.unwrap_or("a field");
        let (line, column) = (error.line(), error.column());
        return format!(
            "{field}: {word} is no JSON, write null for a value that was not measured (line {line} column {column})"
        );
    }
    let said = error
        .to_string()
        .replace("expected a number", "must be a number")
        .replace("expected a string", "must be a text");
    match name {
        Some(name) if error.is_data() => format!("{name}: {said}"),
        _ => said,
    }
}

/// Boot and number in a message that is not a valid throw; `None` unless both can be read.
pub fn throw_id(encoding: Encoding, payload: &[u8]) -> Option<ThrowRef> {
    let (boot_id, throw_no) = match encoding {
        Encoding::Cbor => {
            let (fields, _) = cbor::decode(payload);
            (fields.boot_id?, fields.throw_no?.0)
        }
        // Searched as text, as the message may not be JSON.
        Encoding::Json => {
            let text = String::from_utf8_lossy(payload);
            let boot_id = value(&text, "\"boot_id\"")?.strip_prefix('"')?.split('"').next()?;
            let throw_no = value(&text, "\"throw_no\"")?;
            // A number at the end of the text may be cut.
            let number = &throw_no[..throw_no.find([',', '}', ' ', '\t', '\r', '\n'])?];
            (boot_id.to_owned(), serde_json::from_str::<Count>(number).ok()?.0)
        }
    };
    (is_boot_id(&boot_id) && i64::try_from(throw_no).is_ok()).then_some(ThrowRef { boot_id, throw_no })
}

/// The text behind the quoted `name` and a colon.
fn value<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = text.split_once(name)?;
    rest.trim_start().strip_prefix(':').map(str::trim_start)
}

#[cfg(test)]
mod tests;
