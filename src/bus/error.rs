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
/// that does not answer; and the channel that closes when zenoh panics without a free thread or descriptor.
const TEMPORARY: [&str; 5] = ["(os error ", "nable to connect", "imeout", "lookup", "channel closed"];

impl BusError {
    /// Whether a later attempt may succeed. The other errors of opening come from the configuration: for example, a
    /// file is not a certificate.
    pub(crate) fn is_temporary(&self) -> bool {
        let text = self.source.to_string();
        self.action != OPEN || TEMPORARY.iter().any(|part| text.contains(part))
    }

    pub(crate) fn new(action: impl Into<String>) -> impl FnOnce(zenoh::Error) -> Self {
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

#[cfg(test)]
mod tests {
    use tokio::sync::oneshot;

    use super::*;

    /// Systemd starts the daemon again.
    #[test]
    fn a_panic_of_zenoh_is_no_wrong_configuration() {
        let (done, opened) = oneshot::channel::<()>();
        drop(done);
        let panicked = opened.blocking_recv().unwrap_err();
        assert!(BusError::new(OPEN)(panicked.into()).is_temporary());
        assert!(!BusError::new(OPEN)("no certificate".into()).is_temporary());
    }
}
