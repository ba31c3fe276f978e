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
    wire::{Kind, machine_key, monitor_alive_key},
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
    /// Daemons are there, and none of them has heard of the machine.
    #[error(
        "no daemon knows {0}, which is not the same as no alarms: is the name right, has it sent a throw, and does a running \
         pointsd's subscribe.key hold it?"
    )]
    Unknown(String),
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
    alive(session, "points/v1/*/monitor/*/alive").await
}

/// Makes sure that an empty answer about alarms is none of silence: that daemons run and, where it is about one machine,
/// that one of them knows it.
///
/// # Errors
/// When no daemon is there, or none has heard of the machine.
pub async fn is_watched(
    session: &Session,
    machine: Option<&MachineId>,
    timeout: Duration,
) -> Result<(), OperatorError> {
    if monitors(session).await? == 0 {
        return Err(OperatorError::NoDaemon);
    }
    let Some(machine) = machine else { return Ok(()) };
    let health = ask(session, &machine_key(machine, Kind::Health), None, timeout).await?;
    // A daemon's own alarms stand under its own name.
    if health.is_empty() && alive(session, &monitor_alive_key(&machine.site, &machine.machine)).await? == 0 {
        return Err(OperatorError::Unknown(machine.to_string()));
    }
    Ok(())
}

/// How many liveliness tokens there are on a key expression.
async fn alive(session: &Session, key: &str) -> Result<usize, OperatorError> {
    let asked = BusError::new("ask for liveliness tokens");
    let replies = session.liveliness().get(key).await.map_err(asked)?;
    let mut count = 0;
    while replies.recv_async().await.is_ok() {
        count += 1;
    }
    Ok(count)
}
