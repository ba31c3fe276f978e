//! Errors of zenoh.

/// An action that failed in zenoh, with the error.
#[derive(Debug, thiserror::Error)]
#[error("zenoh: cannot {action}: {source}{}", advice(.source))]
pub struct BusError {
    action: String,
    source: zenoh::Error,
}

/// The action of opening a session.
pub(super) const OPEN: &str = "open the session";
/// Parts of the texts of temporary errors: a port in use, an address that does not exist yet, a name server or a router
/// that does not answer.
const TEMPORARY: [&str; 4] = ["(os error ", "nable to connect", "imeout", "lookup"];

impl BusError {
    /// Whether a later attempt may succeed. The other errors of opening come from the configuration: for example, a
    /// file is not a certificate.
    pub(crate) fn is_temporary(&self) -> bool {
        let text = self.source.to_string();
        self.action != OPEN || TEMPORARY.iter().any(|part| text.contains(part))
    }

    pub(super) fn new(action: impl Into<String>) -> impl FnOnce(zenoh::Error) -> Self {
        let action = action.into();
        move |source| Self { action, source }
    }
}

/// Advice for a known error; empty for other errors.
fn advice(source: &zenoh::Error) -> &'static str {
    if source.to_string().contains("Address already in use") {
        ". Another program listens there, perhaps another pointsd: stop it, or change listen.endpoints of [zenoh]"
    } else {
        ""
    }
}
