//! Watches the liveliness tokens of loggers and daemons.

use zenoh::{
    Session,
    sample::{Sample, SampleKind},
};

use super::error::BusError;

/// Change of a liveliness token.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Token {
    Appeared,
    Gone,
}

/// Watches the liveliness tokens in a key expression while the session is open. `on_change` gets the key of each token
/// with its change; the present tokens come first. It runs on a thread of zenoh and must not wait: a cut link removes
/// all tokens of a region at once, and a queue of these changes would overflow.
pub(crate) async fn watch_tokens(
    session: &Session,
    key_expression: &str,
    on_change: impl Fn(&str, Token) + Send + Sync + 'static,
) -> Result<(), BusError> {
    session
        .liveliness()
        .declare_subscriber(key_expression.to_owned())
        .history(true)
        .callback(move |sample: Sample| {
            let change = if sample.kind() == SampleKind::Put { Token::Appeared } else { Token::Gone };
            on_change(sample.key_expr().as_str(), change);
        })
        .background()
        .await
        .map_err(BusError::new(format!("watch the liveliness of {key_expression}")))
}
