//! Common parts of the operators' commands: the connection to a daemon, shared arguments, and sending a command.

use std::{path::PathBuf, str::FromStr, time::Duration};

use anyhow::Context;
use jiff::{SignedDuration, Span, SpanRelativeTo, Timestamp, civil::Date, tz::TimeZone};
use serde::de::DeserializeOwned;
use strum::VariantArray as _;
use zenoh::Session;

use super::{Exit, Failure, Outcome, ResultExt, output, runtime};
use crate::{
    bus::{self, Answers, OperatorError},
    daemon::{
        clock,
        config::{Document, OperatorSession, operator_session},
    },
    diagnose::{Cause, Command},
    throw::MachineId,
    wire::{Reply, parse_monitor_key},
};

/// Time until a query fails; longer than a daemon needs for a batch of throws.
pub(super) const ANSWER_TIMEOUT: Duration = Duration::from_secs(25);
/// Time until a connection fails.
const CONNECT_TIMEOUT_MS: u32 = 5_000;

/// The options for the connection to a daemon.
#[derive(Debug, clap::Args)]
pub(super) struct Connection {
    /// Zenoh endpoint of the daemon or of its router [default without --config: tcp/127.0.0.1:7447].
    #[arg(long, value_name = "ENDPOINT")]
    connect: Option<String>,
    /// File with endpoint and certificates: the configuration of the daemon, or a file with a [zenoh] section for a
    /// client.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

/// A session with a daemon or its router.
pub(super) struct Client {
    pub(super) session: Session,
    /// The daemon of the given configuration; `None` if none was given.
    pub(super) monitor: Option<MachineId>,
}

impl Connection {
    /// Connects; fails after [`CONNECT_TIMEOUT_MS`].
    pub(super) async fn open(&self) -> Result<Client, Failure> {
        let document = self.config.as_deref().map(Document::read).transpose().or_exit(Exit::Config)?;
        let OperatorSession { zenoh: mut config, endpoints, monitor } =
            operator_session(document.as_ref(), self.connect.as_deref())
                .context("no daemon can be reached with this configuration")
                .or_exit(if document.is_some() { Exit::Config } else { Exit::Usage })?;
        let mut set = |key: &str, value: serde_json::Value| {
            let wrong = |error| Failure { exit: Exit::Usage, error: anyhow::anyhow!("{key} = {value}: {error}") };
            config.insert_json5(key, &value.to_string()).map_err(wrong)
        };
        // The file may be that of a daemon; an operator's command is always a client with a short timeout.
        set("mode", "client".into())?;
        set("listen/endpoints", serde_json::json!([]))?;
        set("connect/timeout_ms", CONNECT_TIMEOUT_MS.into())?;
        set("connect/exit_on_failure", true.into())?;
        let session = bus::open(config).await.map_err(|error| {
            let places = endpoints.join(" or ");
            let error = anyhow::anyhow!(
                "no answer from {places}. Is pointsd running? Name its endpoint with --connect tcp/HOST:7447 ({error})"
            );
            Failure { exit: Exit::Unavailable, error }
        })?;
        if let Some(monitor) = &monitor
            && let Err(error) = bus::require_running(&session, monitor).await
        {
            close(session).await;
            return Err(failure(error));
        }
        Ok(Client { session, monitor })
    }
}

/// A reply of a query: its key and its payload.
type Message = (String, Vec<u8>);

/// Reads the messages as JSON, and counts those that this program cannot read and the errors of daemons. Both are
/// reported: they must not look like silence.
pub(super) fn read<T: DeserializeOwned>(answers: &Answers) -> (Vec<(&Message, T)>, usize) {
    let mut values = Vec::with_capacity(answers.messages.len());
    for message in &answers.messages {
        match serde_json::from_slice(&message.1) {
            Ok(value) => values.push((message, value)),
            Err(error) => eprintln!("unreadable reply of {}, perhaps of a newer daemon: {error}", message.0),
        }
    }
    for error in &answers.errors {
        eprintln!("no answer of a daemon: {error}");
    }
    let problems = answers.messages.len() - values.len() + answers.errors.len();
    (values, problems)
}

/// Name of a daemon, `{site}/{id}`, from the key of its status; the key itself if it is none.
pub(super) fn monitor_name(key: &str) -> String {
    parse_monitor_key(key).map_or_else(|| key.to_owned(), |monitor| monitor.to_string())
}

/// The daemons that answered.
pub(super) fn monitors(answers: &bus::Answers) -> Vec<MachineId> {
    answers.messages.iter().filter_map(|(key, _)| parse_monitor_key(key)).collect()
}

/// Closes a session. After an error the end of the process closes the link.
pub(super) async fn close(session: Session) {
    if let Err(error) = session.close().await {
        tracing::debug!(%error, "closing the session failed");
    }
}

/// Exit code and text of a failed query or command.
pub(super) fn failure(error: OperatorError) -> Failure {
    let exit = match &error {
        OperatorError::Refused(_) => Exit::Negative,
        _ => Exit::Unavailable,
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
        let known = || Cause::VARIANTS.iter().map(|cause| cause.as_str()).collect::<Vec<_>>().join(", ");
        let is_named = |cause: &&Cause| cause.to_string().replace(' ', "_") == text.replace([' ', '-'], "_");
        let named = text.parse().ok().or_else(|| Cause::VARIANTS.iter().find(is_named).copied());
        named.map(Self).ok_or_else(|| format!("must be motor or one of {}", known()))
    }
}

/// A moment on the command line: a date (0:00 UTC) or a time with its zone.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moment(pub(super) Timestamp);

impl FromStr for Moment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let date = || text.parse::<Date>().ok()?.to_zoned(TimeZone::UTC).ok().map(|day| day.timestamp());
        // `Date` would accept a date and time without a zone, and ignore the time.
        let date = if text.contains(['T', ' ', ':']) { None } else { date() };
        let wrong = || format!("{text:?} is neither a date, as 2026-05-04, nor a time, as 2026-05-04T06:00:00Z");
        date.or_else(|| text.parse().ok()).map(Self).ok_or_else(wrong)
    }
}

/// A length of time on the command line, as 90m, 8h, 3d or 2w. A day has 24 hours.
#[derive(Debug, Clone, Copy)]
pub(super) struct Length(pub(super) SignedDuration);

impl FromStr for Length {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let days = SpanRelativeTo::days_are_24_hours();
        let length = text.parse::<Span>().and_then(|span| span.to_duration(days));
        let length = length.ok().filter(SignedDuration::is_positive).map(Self);
        length.ok_or_else(|| format!("{text:?} is not a length of time, as 90m, 8h or 3d"))
    }
}

/// The options for the end of a shelving or a maintenance.
#[derive(Debug, clap::Args)]
pub(super) struct End {
    /// Length, as 90m, 8h, 3d or 2w.
    #[arg(long = "for", value_name = "LENGTH", conflicts_with = "until")]
    length: Option<Length>,
    /// End: a date, or a time as 2026-05-04T06:00:00Z.
    #[arg(long, value_name = "TIME")]
    until: Option<Moment>,
}

impl End {
    /// The time of the end; `default` from now if the command line gives none.
    pub(super) fn at(&self, default: Option<SignedDuration>) -> Result<Timestamp, Failure> {
        let usage = |problem: &str| Failure { exit: Exit::Usage, error: anyhow::anyhow!(problem.to_owned()) };
        if let Some(Moment(until)) = self.until {
            return Ok(until);
        }
        let length = self.length.map(|Length(length)| length).or(default);
        let length = length.ok_or_else(|| usage("no end given: use --for 8h or --until 2026-05-04T06:00:00Z"))?;
        clock::now().checked_add(length).map_err(|_| usage("--for is too long"))
    }
}

/// The arguments of commands that change something: the machine, name of the operator, connection, format of the answer.
#[derive(Debug, clap::Args)]
pub(super) struct Sender {
    #[arg(value_name = "SITE/MACHINE")]
    machine: MachineArgument,
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
    pub(super) fn name(&self) -> Result<String, Failure> {
        let named = self.by.clone().or_else(|| std::env::var("USER").ok()).filter(|name| !name.trim().is_empty());
        named.ok_or_else(|| Failure { exit: Exit::Usage, error: anyhow::anyhow!("no name given: use --by NAME") })
    }

    /// Sends a command to the daemon of the machine and prints the reply.
    pub(super) fn send(&self, command: &Command) -> Outcome {
        let MachineArgument(machine) = &self.machine;
        runtime::block_on(async {
            let payload = serde_json::to_vec(command).or_exit(Exit::Software)?;
            let Client { session, monitor } = self.connection.open().await?;
            let answer = bus::command(&session, machine, monitor.as_ref(), payload, ANSWER_TIMEOUT).await;
            close(session).await;
            let answer = answer.map_err(failure)?;
            let reply: Reply = serde_json::from_slice(&answer).or_exit(Exit::Unavailable)?;
            if self.json {
                output::line(String::from_utf8_lossy(&reply.to_json()))?;
            } else {
                output::line(format_args!("{}: {}", reply.monitor, reply.text))?;
            }
            Ok(if reply.done { Exit::Ok } else { Exit::Negative })
        })
    }
}
