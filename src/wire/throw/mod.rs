//! The throw message: CBOR (what `pointsim` sends) or JSON (easy from any language), with the same fields.
//!
//! Unknown fields are ignored; optional fields (`position_mm` among them) may be missing or null. Numbers may be
//! integers. In a channel, null is a sample that was not measured and becomes NaN. `started_at` is RFC 3339 with `Z` or
//! any numeric offset; `direction` may be missing, which means "unknown".

mod cbor;
mod error;
mod fields;
mod values;

pub use error::InvalidThrow;
pub use fields::{MAX_BOOT_ID_BYTES, is_boot_id};

use super::json_bytes;
use crate::throw::Throw;
use fields::Fields;

/// Encoding of a throw, by its content type on zenoh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// `application/cbor`.
    Cbor,
    /// `application/json`.
    Json,
}

impl Encoding {
    /// The encoding of a payload. A first byte `{` after white space means JSON also without the content type, which
    /// many clients do not set: no CBOR map begins with this byte.
    #[must_use]
    pub fn of(content_type: &str, payload: &[u8]) -> Self {
        let first = payload.iter().find(|byte| !byte.is_ascii_whitespace());
        if first == Some(&b'{') || content_type.contains("json") { Self::Json } else { Self::Cbor }
    }
}

/// Decodes a throw.
///
/// # Errors
/// When the payload is not well-formed, a required field is missing, or a value is invalid.
pub fn decode_throw(encoding: Encoding, payload: &[u8]) -> Result<Throw, InvalidThrow> {
    match encoding {
        Encoding::Cbor => cbor::decode(payload),
        // serde_json rejects nesting beyond 128 and bytes after the value.
        Encoding::Json => {
            serde_json::from_slice(payload).map_err(|error| InvalidThrow::Json { problem: problem(&error, payload) })
        }
    }?
    .into_throw()
}

/// The error with the name of the last field before it; `serde_json` names only its position.
fn problem(error: &serde_json::Error, payload: &[u8]) -> String {
    let lines = payload.split_inclusive(|byte| *byte == b'\n');
    let start: usize = lines.take(error.line().saturating_sub(1)).map(<[u8]>::len).sum();
    let before = payload.get(..start + error.column()).unwrap_or(payload);
    // A multi-byte character may be cut.
    let before = String::from_utf8_lossy(before);
    // In a text, a quote before a colon has a backslash, which is no part of a name.
    let is_name = |name: &&str| name.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_');
    let name = |(at, _)| before[..at].trim_end().strip_suffix('"')?.rsplit('"').next().filter(is_name);
    match before.rmatch_indices(':').find_map(name) {
        Some(name) if error.is_data() => format!("{name}: {error}"),
        _ => error.to_string(),
    }
}

/// Encodes a throw: in CBOR with little-endian float32 typed arrays (RFC 8746), in JSON with the shortest decimal
/// numbers.
#[must_use]
pub fn encode_throw(encoding: Encoding, throw: &Throw) -> Vec<u8> {
    match encoding {
        Encoding::Cbor => cbor::encode(throw),
        Encoding::Json => json_bytes(&Fields::from(throw)),
    }
}

#[cfg(test)]
mod tests;
