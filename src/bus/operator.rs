//! What operators' programs ask of running daemons.

use std::time::Duration;

use zenoh::{
    Session,
    bytes::Encoding,
    query::{ConsolidationMode, QueryTarget},
};

use super::BusError;
use crate::{
    throw::MachineId,
    wire::{Kind, machine_key},
};

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum OperatorError {
    /// The session does not do what it should.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Nobody is there.
    #[error(
        "no daemon answers: none is connected to this router. Is pointsd running, and does [zenoh] connect to the same router?"
    )]
    NoDaemon,
    /// Daemons are there, and this is not for them.
    #[error(
        "no daemon serves {0}: is the name right, does a running pointsd's subscribe.key hold it, and may your certificate command it?"
    )]
    NotServed(String),
    /// The daemon says no.
    #[error("{0}")]
    Refused(String),
}

/// Replies of all daemons to a question on a selector: the keys and payloads.
///
/// # Errors
/// When nobody answers, or a daemon answers with an error.
pub async fn ask(
    session: &Session,
    selector: &str,
    payload: Option<Vec<u8>>,
    timeout: Duration,
) -> Result<Vec<(String, Vec<u8>)>, OperatorError> {
    let asked = BusError::new(format!("ask {selector}"));
    let mut get = session
        .get(selector.to_owned())
        .target(QueryTarget::All)
        .consolidation(ConsolidationMode::None)
        .timeout(timeout);
    if let Some(payload) = payload {
        get = get.payload(payload).encoding(Encoding::APPLICATION_JSON);
    }
    let replies = get.await.map_err(asked)?;
    let mut messages = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        match reply.into_result() {
            Ok(sample) => messages.push((sample.key_expr().to_string(), sample.payload().to_bytes().into_owned())),
            Err(error) => {
                let text =
                    error.payload().try_to_string().map_or_else(|_| "an error".to_owned(), |text| text.to_string());
                return Err(OperatorError::Refused(text));
            }
        }
    }
    Ok(messages)
}

/// Sends a command to the daemon of one machine and returns its reply.
///
/// # Errors
/// When nobody answers, or the daemon refuses.
pub async fn command(
    session: &Session,
    machine: &MachineId,
    payload: Vec<u8>,
    timeout: Duration,
) -> Result<Vec<u8>, OperatorError> {
    let key = machine_key(machine, Kind::Command);
    let replies = ask(session, &key, Some(payload), timeout).await?;
    match replies.into_iter().next() {
        Some((_, payload)) => Ok(payload),
        None if monitors(session).await? > 0 => Err(OperatorError::NotServed(machine.to_string())),
        None => Err(OperatorError::NoDaemon),
    }
}

/// How many monitors show that they are alive. A question that nobody answers looks like one with an empty answer;
/// this tells the two apart.
///
/// # Errors
/// When zenoh refuses the question.
pub async fn monitors(session: &Session) -> Result<usize, OperatorError> {
    let asked = BusError::new("ask for liveliness tokens");
    let replies = session.liveliness().get("points/v1/*/monitor/*/alive").await.map_err(asked)?;
    let mut count = 0;
    while replies.recv_async().await.is_ok() {
        count += 1;
    }
    Ok(count)
}
