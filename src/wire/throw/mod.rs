//! The throw message: CBOR (what `pointsim` sends) or JSON (easy from any language), with the same fields.
//!
//! Unknown fields are ignored, optional ones may be missing or null. Numbers may be written as integers. In the two
//! channels null stands for a sample that was not measured and becomes NaN: a broken sensor is a fact to be stored.
//! `started_at` is RFC 3339 with `Z` or any numeric offset; `direction` may be missing, which means "unknown".

mod cbor;
mod fields;
mod json;

use crate::throw::{InvalidTrace, Throw};

/// Longest `boot_id`, in bytes: room for a UUID or a serial number, and no more that a key in the database must hold.
pub const MAX_BOOT_ID_BYTES: usize = 128;

/// How a throw is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// `application/cbor`.
    Cbor,
    /// `application/json`.
    Json,
}

impl Encoding {
    /// The content type on zenoh.
    #[must_use]
    pub const fn content_type(self) -> &'static str {
        match self {
            Self::Cbor => "application/cbor",
            Self::Json => "application/json",
        }
    }

    /// The encoding of a payload. A first byte `{` after white space is JSON whatever the content type says: no CBOR
    /// map begins with it, and many clients leave the content type as it is.
    #[must_use]
    pub fn of(content_type: &str, payload: &[u8]) -> Self {
        let first = payload.iter().find(|byte| !byte.is_ascii_whitespace());
        if first == Some(&b'{') || content_type.contains("json") { Self::Json } else { Self::Cbor }
    }
}

/// Why a payload is no throw. `Display` is one sentence for a person.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InvalidThrow {
    /// The bytes are not CBOR.
    #[error("not valid CBOR at byte {at}: {problem}")]
    Cbor {
        /// Byte offset.
        at: usize,
        /// What is wrong there.
        problem: String,
    },
    /// The bytes are not JSON, or a field has another type.
    #[error("not a throw in JSON: {problem}")]
    Json {
        /// What is wrong, with line and column.
        problem: String,
    },
    /// A required field is missing.
    #[error("the field {field} is missing")]
    Missing {
        /// The field.
        field: &'static str,
    },
    /// A field's value cannot be used.
    #[error("{field}: {problem}")]
    Field {
        /// The field.
        field: &'static str,
        /// What is wrong with it.
        problem: String,
    },
    /// The two channels are no trace.
    #[error(transparent)]
    Trace(#[from] InvalidTrace),
}

/// Reads a throw.
///
/// # Errors
/// When the payload is not well-formed, a required field is missing, or a value cannot be used.
pub fn decode_throw(encoding: Encoding, payload: &[u8]) -> Result<Throw, InvalidThrow> {
    match encoding {
        Encoding::Cbor => cbor::decode(payload),
        Encoding::Json => json::decode(payload),
    }?
    .into_throw()
}

/// Writes a throw: in CBOR with little-endian float32 typed arrays (RFC 8746), in JSON with shortest decimal numbers.
#[must_use]
pub fn encode_throw(encoding: Encoding, throw: &Throw) -> Vec<u8> {
    match encoding {
        Encoding::Cbor => cbor::encode(throw),
        Encoding::Json => json::encode(throw),
    }
}

#[cfg(test)]
mod tests;
