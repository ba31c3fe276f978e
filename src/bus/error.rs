//! Errors of zenoh.

/// An action that zenoh refused, and its error.
#[derive(Debug, thiserror::Error)]
#[error("zenoh: cannot {action}: {source}")]
pub struct BusError {
    action: String,
    source: zenoh::Error,
}

impl BusError {
    pub(super) fn new(action: impl Into<String>) -> impl FnOnce(zenoh::Error) -> Self {
        let action = action.into();
        move |source| Self { action, source }
    }
}
