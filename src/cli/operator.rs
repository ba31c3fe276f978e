//! Common parts of the operators' commands: the connection to a daemon, shared arguments, and sending a command.

use std::path::PathBuf;

use anyhow::{Context, anyhow};
use serde::de::DeserializeOwned;
use zenoh::Session;

use super::{Exit, Failure, Outcome, ResultExt, argument, output, runtime, terminal};
use crate::{
    bus::{self, Answers, OperatorError},
    daemon::config::{Document, OperatorSession, operator_session},
    diagnose::Command,
    throw::MachineId,
    wire::{Reply, json, json_bytes, parse_monitor_key},
};

/// Time after which an attempt to connect fails \[ms\].
const CONNECT_TIMEOUT_MS: u32 = 5_000;

/// The options for the connection to a daemon.
#[derive(Debug, clap::Args)]
pub(super) struct Connection {
    /// Zenoh endpoint of the daemon or of its router [default without --config: tcp/127.0.0.1:7447].
    #[arg(long, value_name = "ENDPOINT", value_parser = argument::endpoint)]
    connect: Option<String>,
    /// File with endpoint and certificates: the configuration of the daemon, or a file with a [zenoh] section for a
    /// client.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

/// A session with a daemon or its router.
pub(super) struct Client {
    pub(super) session: Session,
    /// Name of the daemon whose configuration was given; `None` if it was not that of a daemon.
    pub(super) monitor: Option<MachineId>,
}

impl Client {
    /// The answers of all daemons.
    pub(super) async fn ask(&self, selector: &str) -> Result<Answers, Failure> {
        Ok(bus::ask(&self.session, selector, None, bus::ANSWER_TIMEOUT).await?)
    }

    /// Closes the session. An error does not matter, as the end of the process closes the link.
    async fn close(self) {
        if let Err(error) = self.session.close().await {
            tracing::debug!(%error, "closing the session failed");
        }
    }
}

impl Connection {
    /// Does the work of a command with a connection, which is closed afterwards.
    pub(super) fn with<T>(&self, work: impl AsyncFnOnce(&Client) -> Result<T, Failure>) -> Result<T, Failure> {
        runtime::block_on(async {
            let client = self.open().await?;
            let result = work(&client).await;
            client.close().await;
            result
        })
    }

    /// Connects within [`CONNECT_TIMEOUT_MS`]. If the configuration is that of a daemon, this daemon must be running.
    async fn open(&self) -> Result<Client, Failure> {
        let document = self.config.as_deref().map(Document::read).transpose().or_exit(Exit::Config)?;
        let OperatorSession { zenoh: mut config, endpoints, monitor } =
            operator_session(document.as_ref(), self.connect.as_deref())
                .context("no daemon can be reached with this configuration")
                .or_exit(if document.is_some() { Exit::Config } else { Exit::Usage })?;
        let mut set = |key: &str, value: serde_json::Value| {
            let wrong = |error| Failure::new(Exit::Usage, anyhow!("{key} = {value}: {error}"));
            config.insert_json5(key, &value.to_string()).map_err(wrong)
        };
        // Whatever the file says: an operator's command is a client with a short timeout.
        set("mode", "client".into())?;
        set("listen/endpoints", serde_json::json!([]))?;
        set("connect/timeout_ms", CONNECT_TIMEOUT_MS.into())?;
        set("connect/exit_on_failure", true.into())?;
        let session = bus::open(config).await.map_err(|error| {
            let is_encrypted = endpoints.iter().any(|endpoint| endpoint.starts_with("tls/"));
            let advice = if is_encrypted {
                "Is pointsd running, and does each side accept the certificate of the other: authority, dates, host name, \
                 key? Name the endpoint with --connect tls/HOST:7447, and the certificates in the file of --config"
            } else {
                "Is pointsd running? Name its endpoint with --connect tcp/HOST:7447"
            };
            Failure::new(Exit::Unavailable, anyhow!("no answer from {}. {advice} ({error})", endpoints.join(" or ")))
        })?;
        let client = Client { session, monitor };
        if let Some(monitor) = &client.monitor
            && let Err(error) = bus::require_running(&client.session, monitor).await
        {
            client.close().await;
            return Err(error.into());
        }
        Ok(client)
    }
}

/// A reply to a query: its key and its payload.
type Message = (String, Vec<u8>);

/// Reads the messages as JSON. Returns the values with their messages, and the number of problems: unreadable messages
/// and errors of daemons. Each problem is also printed on stderr, as it must not look like an empty answer.
pub(super) fn read<T: DeserializeOwned>(answers: &Answers) -> (Vec<(&Message, T)>, usize) {
    let mut values = Vec::with_capacity(answers.messages.len());
    for message in &answers.messages {
        match serde_json::from_slice(&message.1) {
            Ok(value) => values.push((message, value)),
            Err(error) => terminal::complain(format_args!(
                "unreadable reply of {}, perhaps of a newer daemon: {error}",
                message.0
            )),
        }
    }
    for error in &answers.errors {
        terminal::complain(format_args!("no answer of a daemon: {error}"));
    }
    let problems = answers.messages.len() - values.len() + answers.errors.len();
    (values, problems)
}

/// Reads the messages as JSON. Returns the values, and the number of problems that [`read`] printed on stderr.
pub(super) fn values<T: DeserializeOwned>(answers: &Answers) -> (Vec<T>, usize) {
    let (values, problems) = read(answers);
    (values.into_iter().map(|(_, value)| value).collect(), problems)
}

/// Name of a daemon, `{site}/{id}`, from the key of its status. Another key is returned unchanged.
pub(super) fn monitor_name(key: &str) -> String {
    parse_monitor_key(key).map_or_else(|| key.to_owned(), |monitor| monitor.to_string())
}

/// Names of the daemons that answered.
pub(super) fn answered(answers: &Answers) -> Vec<MachineId> {
    answers.messages.iter().filter_map(|(key, _)| parse_monitor_key(key)).collect()
}

/// The daemons that were `present` before a query and did not answer it; each is named on stderr. The query itself ends
/// without an error if a daemon hangs: zenoh closes its link while the query waits.
pub(super) fn silent<'a>(present: &'a [MachineId], answers: &Answers) -> Vec<&'a MachineId> {
    let answered = answered(answers);
    let silent = present.iter().filter(|daemon| !answered.contains(daemon));
    silent.inspect(|daemon| terminal::complain(format_args!("no answer of the daemon {daemon}"))).collect()
}

impl From<OperatorError> for Failure {
    fn from(error: OperatorError) -> Self {
        let exit = if matches!(error, OperatorError::Refused(_)) { Exit::Negative } else { Exit::Unavailable };
        Self::new(exit, error)
    }
}

/// The arguments of commands that change something: machine, name of the operator, connection, and format of the
/// answer.
#[derive(Debug, clap::Args)]
pub(super) struct Sender {
    /// The machine.
    #[arg(value_name = "SITE/MACHINE", value_parser = argument::machine)]
    machine: MachineId,
    /// Your name, stored with the alarm [default: your login name].
    #[arg(long, value_name = "NAME")]
    by: Option<String>,
    #[command(flatten)]
    connection: Connection,
    /// Print the answer as JSON.
    #[arg(long)]
    json: bool,
}

impl Sender {
    /// The name of the operator.
    pub(super) fn name(&self) -> Result<String, Failure> {
        let named = self.by.clone().or_else(|| std::env::var("USER").ok()).filter(|name| !name.trim().is_empty());
        named.context("no name given: use --by NAME").or_exit(Exit::Usage)
    }

    /// Sends a command to the daemon of the machine and prints the reply.
    pub(super) fn send(&self, command: &Command) -> Outcome {
        let answer = self.connection.with(async |Client { session, monitor }| {
            Ok(bus::command(session, &self.machine, monitor.as_ref(), json_bytes(command)).await?)
        })?;
        let reply: Reply = serde_json::from_slice(&answer).or_exit(Exit::Unavailable)?;
        if self.json {
            output::line(json(&reply))?;
        } else {
            output::line(format_args!("{}: {}", reply.monitor, reply.text))?;
        }
        Ok(if reply.done { Exit::Ok } else { Exit::Negative })
    }
}
