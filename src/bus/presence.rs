//! Watches the liveliness tokens of loggers and daemons.

use zenoh::{
    Session,
    sample::{Sample, SampleKind},
};

use super::error::BusError;

/// Watches the liveliness tokens in a key expression while the session is open. `on_change` gets the key of each token
/// that appears (true) or disappears (false); the present tokens come first. It runs on a thread of zenoh and must not
/// wait: a cut link removes all tokens of a region at once, and a queue of these changes would overflow.
pub(crate) async fn watch_tokens(
    session: &Session,
    key_expression: &str,
    on_change: impl Fn(&str, bool) + Send + Sync + 'static,
) -> Result<(), BusError> {
    session
        .liveliness()
        .declare_subscriber(key_expression.to_owned())
        .history(true)
        .callback(move |sample: Sample| {
            on_change(sample.key_expr().as_str(), sample.kind() == SampleKind::Put);
        })
        .background()
        .await
        .map_err(BusError::new(format!("watch the liveliness of {key_expression}")))
}
