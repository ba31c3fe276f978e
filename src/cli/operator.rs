//! The operators' commands: how to reach a running daemon, arguments that several commands take, and how to send a command.

use std::{path::PathBuf, str::FromStr, time::Duration};

use anyhow::Context;
use jiff::{SignedDuration, Span, SpanRelativeTo, Timestamp, civil::Date, tz::TimeZone};
use strum::VariantArray as _;
use zenoh::Session;

use super::{Exit, Failure, Outcome, ResultExt, output, runtime};
use crate::{
    bus::{self, OperatorError},
    daemon::{
        clock,
        config::{Document, OperatorSession, operator_session},
    },
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
    /// Zenoh endpoint of the daemon or of its router [default without --config: tcp/127.0.0.1:7447].
    #[arg(long, value_name = "ENDPOINT")]
    connect: Option<String>,
    /// The daemon's own configuration, or a file with a [zenoh] section for a client: endpoint and certificates come from it.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

/// A session to a daemon or its router.
pub(super) struct Client {
    pub(super) session: Session,
    /// The daemon that the given configuration describes.
    pub(super) monitor: Option<MachineId>,
}

impl Connection {
    /// Connects, or gives up after a few seconds.
    pub(super) async fn open(&self) -> Result<Client, Failure> {
        let document = self.config.as_deref().map(Document::read).transpose().or_exit(Exit::Config)?;
        let OperatorSession { zenoh: mut config, endpoints, monitor } =
            operator_session(document.as_ref(), self.connect.as_deref())
                .context("no daemon can be reached with this configuration")
                .or_exit(Exit::Config)?;
        let mut set = |key: &str, value: serde_json::Value| {
            let wrong = |error| Failure { exit: Exit::Usage, error: anyhow::anyhow!("{key} = {value}: {error}") };
            config.insert_json5(key, &value.to_string()).map_err(wrong)
        };
        // Whatever the file is for, an operator is a client that does not wait for ever.
        set("mode", "client".into())?;
        set("listen/endpoints", serde_json::json!([]))?;
        set("connect/timeout_ms", CONNECT_LIMIT_MS.into())?;
        set("connect/exit_on_failure", true.into())?;
        let session = bus::open(config).await.map_err(|error| {
            let places = endpoints.join(" or ");
            let error = anyhow::anyhow!(
                "nobody answers at {places}. Is pointsd running? Where is it: --connect tcp/HOST:7447 ({error})"
            );
            Failure { exit: Exit::Unavailable, error }
        })?;
        if let Some(monitor) = &monitor
            && let Err(error) = bus::is_running(&session, monitor).await
        {
            close(session).await;
            return Err(failure(error));
        }
        Ok(Client { session, monitor })
    }
}

/// Closes a session. The end of the link closes one that cannot be closed in order.
pub(super) async fn close(session: Session) {
    if let Err(error) = session.close().await {
        tracing::debug!(%error, "the session was not closed in good order");
    }
}

/// The exit code for an answer that did not come.
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

/// A moment on the command line: a date (its beginning in UTC) or a time with its zone.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moment(pub(super) Timestamp);

impl FromStr for Moment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let date = || text.parse::<Date>().ok()?.to_zoned(TimeZone::UTC).ok().map(|day| day.timestamp());
        // A date and time without a zone would be a date to the parser of dates.
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
        length.ok_or_else(|| format!("{text:?} is no length of time, as 90m, 8h or 3d"))
    }
}

/// When something that an operator begins ends by itself.
#[derive(Debug, clap::Args)]
pub(super) struct End {
    /// How long, as 90m, 8h, 3d or 2w.
    #[arg(long = "for", value_name = "LENGTH", conflicts_with = "until")]
    length: Option<Length>,
    /// Until when: a date, or a time as 2026-05-04T06:00:00Z.
    #[arg(long, value_name = "TIME")]
    until: Option<Moment>,
}

impl End {
    /// The end; `default` after now where the command line names none.
    pub(super) fn at(&self, default: Option<SignedDuration>) -> Result<Timestamp, Failure> {
        let usage = |problem: &str| Failure { exit: Exit::Usage, error: anyhow::anyhow!(problem.to_owned()) };
        if let Some(Moment(until)) = self.until {
            return Ok(until);
        }
        let length = self.length.map(|Length(length)| length).or(default);
        let length = length.ok_or_else(|| usage("until when? --for 8h, or --until 2026-05-04T06:00:00Z"))?;
        clock::now().checked_add(length).map_err(|_| usage("--for is too long"))
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
            let payload = serde_json::to_vec(command).or_exit(Exit::Software)?;
            let Client { session, monitor } = self.connection.open().await?;
            let answer = bus::command(&session, machine, monitor.as_ref(), payload, ANSWER_LIMIT).await;
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
