//! A received message, and its size limits.

use zenoh::{
    bytes::ZBytes,
    sample::{Sample, SampleKind},
};

use crate::wire::QUARANTINED_BYTES;

/// A received message, live or from a backlog.
#[derive(Debug)]
pub(crate) struct Message {
    pub key: String,
    /// Content type; empty if the sender gave none.
    pub content_type: String,
    /// Payload; only its first bytes if it is too large.
    pub payload: Vec<u8>,
    /// Size of the whole payload \[bytes\].
    pub bytes: usize,
    /// Whether the sender deleted the key. Such a message has no payload, and is no throw.
    pub is_delete: bool,
}

/// Number of bytes that are kept of a payload of `bytes`, with the limit `max_bytes`: the quarantine needs only the start
/// of a larger one.
pub(super) fn kept(bytes: usize, max_bytes: usize) -> usize {
    if bytes > max_bytes { QUARANTINED_BYTES } else { bytes }
}

impl Message {
    /// Memory of the message in a queue \[bytes\].
    pub(super) fn memory(&self) -> usize {
        self.payload.len() + self.key.len() + self.content_type.len()
    }

    pub(super) fn of(sample: &Sample, max_bytes: usize) -> Self {
        let bytes = sample.payload().len();
        let payload = beginning(sample.payload(), kept(bytes, max_bytes));
        let key = sample.key_expr().as_str().to_owned();
        let is_delete = sample.kind() == SampleKind::Delete;
        Self { key, content_type: sample.encoding().to_string(), payload, bytes, is_delete }
    }
}

/// The first `limit` bytes of a payload, or all of it.
fn beginning(payload: &ZBytes, limit: usize) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(payload.len().min(limit));
    for slice in payload.slices() {
        let left = limit - bytes.len();
        bytes.extend_from_slice(&slice[..slice.len().min(left)]);
    }
    bytes
}
