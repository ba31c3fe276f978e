//! JSON of values, and the error of a text that is not valid.

use serde::Serialize;

/// The reason why a key, a selector, a command or a throw is not valid, as one sentence.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Invalid(pub(super) String);

impl From<Invalid> for String {
    fn from(Invalid(reason): Invalid) -> Self {
        reason
    }
}

/// JSON without the byte order mark that some clients write, and that a reader may ignore (RFC 8259, section 8.1).
pub fn without_byte_order_mark(payload: &[u8]) -> &[u8] {
    payload.strip_prefix("\u{feff}".as_bytes()).unwrap_or(payload)
}

/// The first byte of JSON after white space.
pub(super) fn first_byte(payload: &[u8]) -> Option<u8> {
    without_byte_order_mark(payload).trim_ascii_start().first().copied()
}

/// A sentence about a payload whose first byte shows that it is no JSON object in UTF-8; `None` for other payloads.
pub(super) fn not_an_object(payload: &[u8]) -> Option<String> {
    let first = first_byte(payload).filter(|first| *first != b'{')?;
    Some(format!("it begins with the byte 0x{first:02x} instead of {{: JSON in UTF-8 is expected"))
}

/// Encodes a value as JSON, for messages and the database.
///
/// # Panics
/// When the value has no JSON form: a map whose keys are not text, or a failing `Serialize`. No type here is like that.
#[expect(clippy::expect_used, reason = "a receiver could take an empty message for a valid one")]
pub fn json<T: Serialize + ?Sized>(value: &T) -> String {
    serde_json::to_string(value).expect("every message of this program has a JSON form")
}

/// Encodes a value as the bytes of [`json`].
pub fn json_bytes<T: Serialize + ?Sized>(value: &T) -> Vec<u8> {
    json(value).into_bytes()
}
