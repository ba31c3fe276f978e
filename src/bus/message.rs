//! A message as it arrived.

use zenoh::sample::Sample;

/// One message as it arrived, live or from a backlog.
#[derive(Debug)]
pub struct Message {
    /// The key that it was published on.
    pub key: String,
    /// Its content type; empty when the sender gave none.
    pub content_type: String,
    /// The payload; of one that is too large, only the beginning.
    pub payload: Vec<u8>,
    /// The size of the whole payload \[bytes\].
    pub bytes: usize,
}

/// Capacity limits of what is received.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Largest payload that is kept whole \[bytes\].
    pub max_payload_bytes: usize,
    /// How much of a larger one is kept as a sample \[bytes\].
    pub kept_of_larger_bytes: usize,
}

impl Limits {
    pub(super) fn kept(self, bytes: usize) -> usize {
        if bytes > self.max_payload_bytes { self.kept_of_larger_bytes } else { bytes }
    }
}

impl Message {
    /// Memory that the message takes while it is queued \[bytes\].
    pub(super) fn memory(&self) -> usize {
        self.payload.len() + self.key.len() + self.content_type.len()
    }

    pub(super) fn of(sample: &Sample, limits: Limits) -> Self {
        let bytes = sample.payload().len();
        let kept = limits.kept(bytes);
        let mut payload = Vec::with_capacity(kept);
        for slice in sample.payload().slices() {
            let left = kept - payload.len();
            payload.extend_from_slice(&slice[..slice.len().min(left)]);
        }
        let key = sample.key_expr().as_str().to_owned();
        Self { key, content_type: sample.encoding().to_string(), payload, bytes }
    }
}
