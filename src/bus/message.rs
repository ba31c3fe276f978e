//! A received message, and its size limits.

use zenoh::{
    bytes::ZBytes,
    sample::{Sample, SampleKind},
};

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

/// Size limits of received payloads.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Largest accepted payload \[bytes\].
    pub max_payload_bytes: usize,
    /// Bytes kept of a larger payload, for the quarantine.
    pub kept_of_larger_bytes: usize,
}

impl Limits {
    /// Number of bytes that are kept of a payload of this size.
    pub(super) fn kept(self, bytes: usize) -> usize {
        if bytes > self.max_payload_bytes { self.kept_of_larger_bytes } else { bytes }
    }
}

impl Message {
    /// Memory of the message in a queue \[bytes\].
    pub(super) fn memory(&self) -> usize {
        self.payload.len() + self.key.len() + self.content_type.len()
    }

    pub(super) fn of(sample: &Sample, limits: Limits) -> Self {
        let bytes = sample.payload().len();
        let payload = beginning(sample.payload(), limits.kept(bytes));
        let key = sample.key_expr().as_str().to_owned();
        let is_delete = sample.kind() == SampleKind::Delete;
        Self { key, content_type: sample.encoding().to_string(), payload, bytes, is_delete }
    }
}

/// The first `limit` bytes of a payload, or all of it.
pub(super) fn beginning(payload: &ZBytes, limit: usize) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(payload.len().min(limit));
    for slice in payload.slices() {
        let left = limit - bytes.len();
        bytes.extend_from_slice(&slice[..slice.len().min(left)]);
    }
    bytes
}
