//! Values as JSON.

use serde::Serialize;

/// A value as JSON, for messages and the database.
///
/// # Panics
/// When the value has no JSON: a map with keys that are no text, or a `Serialize` that fails by itself. No type of this
/// program does, and an empty message would be worse.
#[must_use]
#[expect(clippy::expect_used, reason = "an empty message would be taken for a true one")]
pub fn json<T: Serialize + ?Sized>(value: &T) -> Vec<u8> {
    serde_json::to_vec(value).expect("every message of this program has a JSON form")
}
