//! What operators' programs ask of running daemons.

use std::time::Duration;

use zenoh::{
    Session,
    bytes::Encoding,
    query::{ConsolidationMode, QueryTarget},
};

use super::error::BusError;
use crate::{
    throw::MachineId,
    wire::{Commander, Kind, machine_key, monitor_alive_key},
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
    /// More than one daemon would carry the command out.
    #[error(
        "nothing was sent: several daemons serve {machine}: {daemons}. Each machine belongs to one daemon: mend subscribe.key, \
         or connect to one that no router joins to the others"
    )]
    Several {
        /// The machine.
        machine: String,
        /// Their names.
        daemons: String,
    },
    /// The daemon that answers is not the one of the given configuration.
    #[error(
        "nothing was sent: {found} answers there, and the configuration is that of {expected}. Is {expected} running?"
    )]
    AnotherDaemon {
        /// Its name.
        found: String,
        /// The name in the configuration.
        expected: String,
    },
    /// A daemon answers in a way that names nobody.
    #[error("nothing was sent: a daemon that serves {0} does not say who it is; it may be an older version")]
    Nameless(String),
    /// The daemon went away between the question and the command.
    #[error("the daemon {0} does not answer any more: look with pointsd alarms whether the command was carried out")]
    Gone(String),
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

/// Sends a command to the one daemon that serves a machine, and returns its reply. First the daemons that would carry
/// the command out are asked who they are: nothing is sent when they are several, or another one than `expected`.
///
/// # Errors
/// When none or several daemons serve the machine, or another one than expected; or when the daemon refuses.
pub async fn command(
    session: &Session,
    machine: &MachineId,
    expected: Option<&MachineId>,
    payload: Vec<u8>,
    timeout: Duration,
) -> Result<Vec<u8>, OperatorError> {
    let key = machine_key(machine, Kind::Command);
    let replies = ask(session, &key, None, timeout).await?;
    let daemons = replies.iter().map(|(_, payload)| serde_json::from_slice::<Commander>(payload));
    let daemons = daemons.collect::<Result<Vec<_>, _>>().map_err(|_| OperatorError::Nameless(machine.to_string()))?;
    let commander = match daemons.as_slice() {
        [only] => only,
        [] if !monitors(session).await?.is_empty() => return Err(OperatorError::NotServed(machine.to_string())),
        [] => return Err(OperatorError::NoDaemon),
        several => {
            let names = several.iter().map(|daemon| format!("{} (session {})", daemon.monitor, daemon.session));
            let daemons = names.collect::<Vec<_>>().join(" and ");
            return Err(OperatorError::Several { machine: machine.to_string(), daemons });
        }
    };
    if let Some(expected) = expected.map(ToString::to_string).filter(|expected| *expected != commander.monitor) {
        return Err(OperatorError::AnotherDaemon { found: commander.monitor.clone(), expected });
    }
    let replies = ask(session, &format!("{key}?session={}", commander.session), Some(payload), timeout).await?;
    replies.into_iter().next().map(|(_, reply)| reply).ok_or_else(|| OperatorError::Gone(commander.monitor.clone()))
}

/// The names of the running daemons, as `{site}/{id}`. Tells a question that nobody answers from one with an empty answer.
///
/// # Errors
/// When zenoh refuses the question.
pub async fn monitors(session: &Session) -> Result<Vec<String>, OperatorError> {
    let keys = alive(session, "points/v1/*/monitor/*/alive").await?;
    let name = |key: &String| {
        let mut chunks = key.split('/').skip(2);
        Some(format!("{}/{}", chunks.next()?, chunks.nth(1)?))
    };
    Ok(keys.iter().filter_map(name).collect())
}

/// Makes sure that the daemon of a configuration runs behind this session.
///
/// # Errors
/// When no daemon runs there, or only others.
pub async fn is_running(session: &Session, expected: &MachineId) -> Result<(), OperatorError> {
    let (found, expected) = (monitors(session).await?, expected.to_string());
    if found.contains(&expected) {
        Ok(())
    } else if found.is_empty() {
        Err(OperatorError::NoDaemon)
    } else {
        Err(OperatorError::AnotherDaemon { found: found.join(", "), expected })
    }
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
    if monitors(session).await?.is_empty() {
        return Err(OperatorError::NoDaemon);
    }
    let Some(machine) = machine else { return Ok(()) };
    let health = ask(session, &machine_key(machine, Kind::Health), None, timeout).await?;
    // A daemon's own alarms stand under its own name.
    if health.is_empty() && alive(session, &monitor_alive_key(&machine.site, &machine.machine)).await?.is_empty() {
        return Err(OperatorError::Unknown(machine.to_string()));
    }
    Ok(())
}

/// The keys of the liveliness tokens on a key expression.
async fn alive(session: &Session, key: &str) -> Result<Vec<String>, OperatorError> {
    let replies = session.liveliness().get(key).await.map_err(BusError::new("ask for liveliness tokens"))?;
    let mut keys = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        keys.extend(reply.result().ok().map(|token| token.key_expr().to_string()));
    }
    Ok(keys)
}
