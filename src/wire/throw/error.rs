//! The errors of decoding a throw.

use crate::throw::InvalidTrace;

/// A payload that is not a throw. `Display` is one sentence for a person.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InvalidThrow {
    /// The bytes are not CBOR.
    #[error("not valid CBOR at byte {at}: {problem}")]
    Cbor {
        /// Offset of the error \[bytes\].
        at: usize,
        /// The error at this offset.
        problem: String,
    },
    /// The bytes are not JSON, or a field has the wrong type.
    #[error("not a throw in JSON: {problem}")]
    Json {
        /// The parser's error with line and column.
        problem: String,
    },
    /// A required field is missing.
    #[error("the field {field} is missing")]
    Missing {
        /// The field.
        field: &'static str,
    },
    /// The value of a field is invalid.
    #[error("{field}: {problem}")]
    Field {
        /// The field.
        field: &'static str,
        /// The value and the allowed values.
        problem: String,
    },
    /// The two channels do not form a trace.
    #[error(transparent)]
    Trace(#[from] InvalidTrace),
}
