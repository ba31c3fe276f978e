//! JSON of values, and the error of a text that cannot be read.

use serde::Serialize;

/// A key, a selector, a command or a throw that cannot be read: one sentence with the reason.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Invalid(pub(super) String);

/// Encodes a value as JSON, for messages and the database.
///
/// # Panics
/// When the value has no JSON form: a map whose keys are not text, or a `Serialize` that fails. No type of this program
/// has this.
#[expect(clippy::expect_used, reason = "a receiver could take an empty message for a valid one")]
pub fn json<T: Serialize + ?Sized>(value: &T) -> String {
    serde_json::to_string(value).expect("every message of this program has a JSON form")
}

/// A message in JSON, by [`json`].
pub fn json_bytes<T: Serialize + ?Sized>(value: &T) -> Vec<u8> {
    json(value).into_bytes()
}
