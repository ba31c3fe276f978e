//! Why a message is no throw.

use crate::throw::InvalidTrace;

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
