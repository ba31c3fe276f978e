//! Queries and commands from operators' programs to running daemons.

use std::{borrow::Cow, time::Duration};

use zenoh::{
    Session,
    bytes::Encoding,
    query::{ConsolidationMode, QueryTarget},
};

use super::error::BusError;
use crate::{
    throw::MachineId,
    wire::{CommandTarget, EVERY_MONITOR_ALIVE, Kind, machine_key, parse_monitor_key},
};

/// Time until a query of an operator fails: longer than a daemon takes for a batch of throws before it replies.
pub(crate) const ANSWER_TIMEOUT: Duration = Duration::from_secs(25);

/// A query or command without a usable answer.
#[derive(Debug, thiserror::Error)]
pub enum OperatorError {
    /// Zenoh refused the query.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// No daemon runs behind the session.
    #[error(
        "no daemon answers: none is connected to this router. Is pointsd running, and does [zenoh] connect to the same router?"
    )]
    NoDaemon,
    /// Other daemons run behind the session than that of the configuration.
    #[error(
        "nothing was sent: the configuration is that of {expected}, but only {found} connected there. Is {expected} running?"
    )]
    AnotherDaemon {
        /// Names of the running daemons, with "is" or "are".
        found: String,
        /// Name of the daemon of the configuration.
        expected: String,
    },
    /// No daemon applies the commands for a machine.
    #[error(
        "no daemon serves {0}: is the name right, does subscribe.key of a running pointsd include it, and may your certificate command it?"
    )]
    NotServed(MachineId),
    /// Several daemons would apply a command for a machine.
    #[error(
        "nothing was sent: several daemons serve {machine}: {}. Each machine belongs to one daemon: correct subscribe.key, \
         or connect to a daemon that no router joins to the others",
        .daemons.iter().map(|of| format!("{} (session {})", of.monitor, of.session)).collect::<Vec<_>>().join(" and ")
    )]
    ServedBySeveral {
        /// The machine.
        machine: MachineId,
        /// The daemons.
        daemons: Vec<CommandTarget>,
    },
    /// A daemon that serves a machine does not give its name.
    #[error("nothing was sent: a daemon that serves {0} does not give its name; it may be an older version")]
    Nameless(MachineId),
    /// No daemon knows a machine.
    #[error(
        "no daemon knows {0}, which is not the same as no alarms: is the name right, has it sent a throw, and does \
         subscribe.key of a running pointsd include it?"
    )]
    Unknown(MachineId),
    /// The daemon of this name stopped answering after a command was sent to it.
    #[error("the daemon {0} stopped answering: check with pointsd alarms whether the command was applied")]
    Gone(String),
    /// A daemon did not answer in time.
    #[error("a daemon did not answer in time: is its computer overloaded, or the link down?")]
    Timeout,
    /// The daemon refused the query or command, with this reason.
    #[error("{0}")]
    Refused(String),
}

/// The replies of all daemons to a query.
#[derive(Debug, Default)]
pub struct Answers {
    /// Keys and payloads, in the order of the keys.
    pub messages: Vec<(String, Vec<u8>)>,
    /// The errors of daemons that gave no answer.
    pub errors: Vec<OperatorError>,
}

impl Answers {
    /// Whether no daemon replied.
    pub(crate) fn is_empty(&self) -> bool {
        self.messages.is_empty() && self.errors.is_empty()
    }

    /// The messages, if no daemon replied with an error.
    ///
    /// # Errors
    /// The first error of a daemon.
    pub fn complete(self) -> Result<Vec<(String, Vec<u8>)>, OperatorError> {
        self.errors.into_iter().next().map_or(Ok(self.messages), Err)
    }
}

/// Queries all daemons.
///
/// # Errors
/// When zenoh refuses the query.
pub async fn ask(
    session: &Session,
    selector: &str,
    payload: Option<Vec<u8>>,
    timeout: Duration,
) -> Result<Answers, OperatorError> {
    /// Text of the error reply that zenoh itself makes at the time limit of the query.
    const TIMEOUT: &str = "Timeout";
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
    let mut answers = Answers::default();
    while let Ok(reply) = replies.recv_async().await {
        match reply.into_result() {
            Ok(sample) => {
                let payload = sample.payload().to_bytes().into_owned();
                answers.messages.push((sample.key_expr().to_string(), payload));
            }
            Err(error) => {
                let text = error.payload().try_to_string().map_or_else(|_| "an error".to_owned(), Cow::into_owned);
                let is_timeout = text == TIMEOUT;
                answers.errors.push(if is_timeout { OperatorError::Timeout } else { OperatorError::Refused(text) });
            }
        }
    }
    // Daemons reply in any order. The sort is stable, as several messages with one key are in order.
    answers.messages.sort_by(|(one, _), (other, _)| one.cmp(other));
    Ok(answers)
}

/// Sends a command to the daemon that serves a machine, and returns its reply. First queries the names of all daemons
/// that would apply the command. Sends nothing unless there is exactly one, with the name `expected` if given.
pub(crate) async fn command(
    session: &Session,
    machine: &MachineId,
    expected: Option<&MachineId>,
    payload: Vec<u8>,
) -> Result<Vec<u8>, OperatorError> {
    let (daemons, error) = targets(session, machine).await;
    if let Some(error) = error {
        return Err(error);
    }
    let commander = match <[CommandTarget; 1]>::try_from(daemons) {
        Ok([only]) => only,
        Err(several) if !several.is_empty() => {
            return Err(OperatorError::ServedBySeveral { machine: machine.clone(), daemons: several });
        }
        Err(_) if monitors(session).await?.is_empty() => return Err(OperatorError::NoDaemon),
        Err(_) => return Err(OperatorError::NotServed(machine.clone())),
    };
    if let Some(expected) = expected.map(ToString::to_string).filter(|expected| *expected != commander.monitor) {
        return Err(OperatorError::AnotherDaemon { found: format!("{} is", commander.monitor), expected });
    }
    let gone = || OperatorError::Gone(commander.monitor.clone());
    let selector = format!("{}?session={}", machine_key(machine, Kind::Command), commander.session);
    match ask(session, &selector, Some(payload), ANSWER_TIMEOUT).await?.complete() {
        Ok(replies) => replies.into_iter().next().map(|(_, reply)| reply).ok_or_else(gone),
        Err(OperatorError::Timeout) => Err(gone()),
        Err(refused) => Err(refused),
    }
}

/// The daemons that serve a machine, and so would apply a command for it. After an error there may be more.
pub(crate) async fn targets(session: &Session, machine: &MachineId) -> (Vec<CommandTarget>, Option<OperatorError>) {
    let answers = match ask(session, &machine_key(machine, Kind::Command), None, ANSWER_TIMEOUT).await {
        Ok(answers) => answers,
        Err(error) => return (Vec::new(), Some(error)),
    };
    let daemons: Vec<_> =
        answers.messages.iter().filter_map(|(_, payload)| serde_json::from_slice(payload).ok()).collect();
    let nameless = (daemons.len() < answers.messages.len()).then(|| OperatorError::Nameless(machine.clone()));
    (daemons, answers.errors.into_iter().next().or(nameless))
}

/// The names of the running daemons: those that have a liveliness token here.
///
/// # Errors
/// When zenoh refuses the query.
pub(crate) async fn monitors(session: &Session) -> Result<Vec<MachineId>, OperatorError> {
    let asked = session.liveliness().get(EVERY_MONITOR_ALIVE).await;
    let tokens = asked.map_err(BusError::new("ask for liveliness tokens"))?;
    let mut monitors = Vec::new();
    while let Ok(reply) = tokens.recv_async().await {
        monitors.extend(reply.result().ok().and_then(|token| parse_monitor_key(token.key_expr())));
    }
    Ok(monitors)
}

/// Checks that the daemon `expected` runs behind this session.
pub(crate) async fn require_running(session: &Session, expected: &MachineId) -> Result<(), OperatorError> {
    let found = monitors(session).await?;
    if found.contains(expected) {
        Ok(())
    } else if found.is_empty() {
        Err(OperatorError::NoDaemon)
    } else {
        let are = if found.len() == 1 { "is" } else { "are" };
        let found: Vec<String> = found.iter().map(ToString::to_string).collect();
        let found = format!("{} {are}", found.join(" and "));
        Err(OperatorError::AnotherDaemon { found, expected: expected.to_string() })
    }
}

/// Distinguishes "no alarms" from "not monitored by any daemon": checks that a daemon runs and, if a machine is given,
/// that a daemon knows it.
pub(crate) async fn require_monitored(session: &Session, machine: Option<&MachineId>) -> Result<(), OperatorError> {
    let running = monitors(session).await?;
    if running.is_empty() {
        return Err(OperatorError::NoDaemon);
    }
    let Some(machine) = machine else { return Ok(()) };
    let health = ask(session, &machine_key(machine, Kind::Health), None, ANSWER_TIMEOUT).await?.complete()?;
    // The machine may be the name of a daemon, for the alarms about the daemon itself.
    if health.is_empty() && !running.contains(machine) {
        return Err(OperatorError::Unknown(machine.clone()));
    }
    Ok(())
}
