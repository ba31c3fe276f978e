//! What the operators' commands have in common: how to reach a running daemon, and how to tell it something.

use std::{path::PathBuf, str::FromStr, time::Duration};

use zenoh::Session;

use super::{Exit, Failure, Outcome, ResultExt, runtime};
use crate::{
    bus::{self, OperatorError},
    daemon::config::{Document, client_session},
    diagnose::{Cause, Command},
    throw::MachineId,
    wire::Reply,
};

/// Longest wait for an answer; longer than a daemon takes in the middle of a batch.
pub(super) const ANSWER_LIMIT: Duration = Duration::from_secs(25);
/// Longest wait for the router.
const CONNECT_LIMIT_MS: u32 = 5_000;

/// Where the daemon is.
#[derive(Debug, clap::Args)]
pub(super) struct Connection {
    /// Zenoh endpoint of the daemon or of its router [default: tcp/127.0.0.1:7447].
    #[arg(long, value_name = "ENDPOINT")]
    connect: Option<String>,
    /// A file with a [zenoh] section for a client, for example with certificates.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

impl Connection {
    /// Connects, or gives up after a few seconds.
    pub(super) async fn open(&self) -> Result<Session, Failure> {
        let document = match &self.config {
            Some(file) => Document::read(file),
            None => Document::parse("built-in defaults".as_ref(), String::new()),
        }
        .or_exit(Exit::Config)?;
        let mut config = client_session(&document).or_exit(Exit::Config)?;
        let mut set = |key: &str, value: serde_json::Value| {
            let wrong = |error| Failure { exit: Exit::Usage, error: anyhow::anyhow!("{key} = {value}: {error}") };
            config.insert_json5(key, &value.to_string()).map_err(wrong)
        };
        // Whatever the file is for, an operator is a client that does not wait for ever.
        set("mode", "client".into())?;
        set("listen/endpoints", serde_json::json!([]))?;
        set("connect/timeout_ms", CONNECT_LIMIT_MS.into())?;
        set("connect/exit_on_failure", true.into())?;
        if let Some(endpoint) = &self.connect {
            set("connect/endpoints", serde_json::json!([endpoint]))?;
        }
        bus::open(config).await.map_err(|error| {
            let error = anyhow::anyhow!("{error}. Is pointsd running? Where is it: --connect tcp/HOST:7447");
            Failure { exit: Exit::Unavailable, error }
        })
    }
}

/// Closes a session; whoever cannot be told is told by the end of the link.
pub(super) async fn close(session: Session) {
    if let Err(error) = session.close().await {
        tracing::debug!(%error, "the session was not closed in good order");
    }
}

/// The exit code for an answer that did not come.
pub(super) fn failure(error: OperatorError) -> Failure {
    let exit = match &error {
        OperatorError::Bus(_) | OperatorError::NoDaemon | OperatorError::NotServed(_) | OperatorError::Unknown(_) => {
            Exit::Unavailable
        }
        OperatorError::Refused(_) => Exit::Negative,
    };
    Failure { exit, error: error.into() }
}

/// A machine on the command line.
#[derive(Debug, Clone)]
pub(super) struct MachineArgument(pub(super) MachineId);

impl FromStr for MachineArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (site, machine) = text.split_once('/').ok_or("write SITE/MACHINE, as north/21B")?;
        MachineId::new(site, machine).map(Self).map_err(|error| error.to_string())
    }
}

/// The cause of an alarm on the command line.
#[derive(Debug, Clone, Copy)]
pub(super) struct CauseArgument(pub(super) Cause);

impl FromStr for CauseArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = || Cause::ALL.map(Cause::as_str).join(", ");
        Cause::from_word(text).map(Self).ok_or_else(|| format!("must be one of {}", known()))
    }
}

/// Who sends a command, to where, and how the answer is printed: the same for every command that changes something.
#[derive(Debug, clap::Args)]
pub(super) struct Sender {
    /// Who you are; it is kept with the alarm [default: your login name].
    #[arg(long, value_name = "NAME")]
    by: Option<String>,
    #[command(flatten)]
    connection: Connection,
    /// Print the answer as JSON.
    #[arg(long)]
    json: bool,
}

impl Sender {
    /// Who acts.
    pub(super) fn name(&self) -> Result<String, Failure> {
        let named = self.by.clone().or_else(|| std::env::var("USER").ok()).filter(|name| !name.trim().is_empty());
        named.ok_or_else(|| Failure { exit: Exit::Usage, error: anyhow::anyhow!("who are you? --by NAME") })
    }

    /// Sends a command to the daemon of a machine and prints what it says.
    pub(super) fn send(&self, machine: &MachineId, command: &Command) -> Outcome {
        runtime::block_on(async {
            let session = self.connection.open().await?;
            let payload = serde_json::to_vec(command).or_exit(Exit::Software)?;
            let answer = bus::command(&session, machine, payload, ANSWER_LIMIT).await;
            close(session).await;
            let answer = answer.map_err(failure)?;
            let reply: Reply = serde_json::from_slice(&answer).or_exit(Exit::Unavailable)?;
            if self.json {
                println!("{}", String::from_utf8_lossy(&reply.to_json()));
            } else {
                println!("{}", reply.text);
            }
            Ok(if reply.done { Exit::Ok } else { Exit::Negative })
        })
    }
}
