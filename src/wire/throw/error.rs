//! The errors of decoding a throw.

use crate::throw::InvalidTrace;

/// A payload that is not a throw. `Display` is one sentence for a person.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum InvalidThrow {
    #[error("not valid CBOR at byte {at}: {problem}")]
    Cbor { at: usize, problem: String },
    #[error("not a throw in JSON: {problem}")]
    Json { problem: String },
    #[error("the field {field} is missing")]
    Missing { field: &'static str },
    #[error("{field}: {problem}")]
    Field { field: &'static str, problem: String },
    #[error(transparent)]
    Trace(#[from] InvalidTrace),
}
