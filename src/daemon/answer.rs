//! Answers queries from the database, and forwards operators' commands to the judge loop.

use std::sync::Arc;

use tokio::time::Instant;
use zenoh::{bytes::ZBytes, query::Query};

use super::{judge::commands::CommandSender, shared::Shared, supervision::status::Status};
use crate::{
    bus::{self, QueryQueue},
    store::{Reader, Selector, StoreError, seldom},
    wire::{self, Alarm, CommandTarget, Health, HistoryQuery, Kind},
};

type Replies = Result<Vec<(String, Vec<u8>)>, String>;

/// The reply to a query for the history whose limit would be applied before [`messages`] filters.
const NO_PATTERN: &str =
    "the key expression of a query for the history must be that of machines, with `**` at most once";

/// Answers one kind of queries.
pub(super) enum Responder {
    /// To health queries.
    Health(Reader),
    /// To alarm queries. A query that also reaches the queryable on the key expression `elsewhere` is answered there.
    Alarms { reader: Reader, status: Arc<Status>, elsewhere: Option<String> },
    /// To operators' commands, and to queries for the name and session of the daemon, `itself`. A command for the
    /// session of another daemon gets no reply.
    Commands { sender: CommandSender, itself: CommandTarget },
    /// To status queries.
    Status { key: String, shared: Arc<Shared> },
}

impl Responder {
    /// Answers until the session is closed.
    pub(super) async fn run(self, mut questions: QueryQueue) {
        while let Some((arrived, question)) = questions.next().await {
            let dropped = questions.take_dropped();
            if dropped > 0 {
                seldom!(
                    warn,
                    dropped,
                    "queries refused: the queue is full, they waited too long, or they are too large"
                );
            }
            let replies = self.replies(&question, arrived).await;
            questions.answer(question, replies).await;
        }
    }

    async fn replies(&self, question: &Query, arrived: Instant) -> Replies {
        match self {
            Self::Health(reader) => health_replies(question, reader).await,
            Self::Alarms { elsewhere: Some(elsewhere), .. } if bus::intersect(question.key_expr(), elsewhere) => {
                Ok(Vec::new())
            }
            Self::Alarms { reader, status, .. } => alarm_replies(question, reader, status).await,
            Self::Commands { .. } if is_about_others(question) => Ok(Vec::new()),
            Self::Commands { sender, itself } => {
                wire::check_parameters(question.parameters().as_str(), &["session"])?;
                match question.parameters().get("session") {
                    Some(other) if other != itself.session => Ok(Vec::new()),
                    _ => command_reply(question, arrived, sender, itself).await,
                }
            }
            // As `points/v1/**?since=…`, a query for the history of health and alarms.
            Self::Status { .. } if !question.parameters().is_empty() && !question.key_expr().ends_with("/status") => {
                Ok(Vec::new())
            }
            Self::Status { key, shared } => {
                wire::check_parameters(question.parameters().as_str(), &[])?;
                Ok(vec![(key.clone(), wire::json_bytes(&shared.status.answer(&shared.store).await))])
            }
        }
    }
}

/// Whether a query on a wildcard as `points/v1/north/21B/*` is no command, as it has no payload. Health and alarms
/// answer it.
fn is_about_others(question: &Query) -> bool {
    question.payload().is_none_or(ZBytes::is_empty) && wire::parse_key(question.key_expr()).is_err()
}

async fn health_replies(question: &Query, reader: &Reader) -> Replies {
    let rows = match HistoryQuery::parse(question.parameters().as_str())? {
        HistoryQuery::Current => reader.latest_health(&patterns(question).unwrap_or_default()).await,
        HistoryQuery::History { since, limit } => {
            reader.health_history(&patterns(question).ok_or(NO_PATTERN)?, since, limit).await
        }
    };
    let message = |health: Health| (wire::machine_key(&health.machine, Kind::Health), wire::json_bytes(&health));
    messages(question, rows, message)
}

async fn alarm_replies(question: &Query, reader: &Reader, status: &Status) -> Replies {
    let rows = match HistoryQuery::parse(question.parameters().as_str())? {
        HistoryQuery::Current => reader
            .open_alarms(&patterns(question).unwrap_or_default())
            .await
            .map(|stored| status.with_uncommitted(stored)),
        HistoryQuery::History { since, limit } => {
            reader.alarm_history(&patterns(question).ok_or(NO_PATTERN)?, since, limit).await
        }
    };
    let message = |alarm: Alarm| (wire::machine_key(&alarm.machine, Kind::Alarm), alarm.into_message());
    messages(question, rows, message)
}

/// The replies for some rows, without those whose key the query does not match.
fn messages<T>(
    question: &Query,
    rows: Result<Vec<T>, StoreError>,
    message: impl Fn(T) -> (String, Vec<u8>),
) -> Replies {
    let rows = rows.map_err(|error| format!("the daemon cannot answer: {error}"))?;
    Ok(rows.into_iter().map(message).filter(|(key, _)| bus::intersect(question.key_expr(), key)).collect())
}

async fn command_reply(question: &Query, arrived: Instant, sender: &CommandSender, itself: &CommandTarget) -> Replies {
    let payload = question.payload().map(ZBytes::to_bytes).unwrap_or_default();
    let (machine, _) = wire::parse_key(question.key_expr())
        .map_err(|error| format!("a command goes to one machine, so its key has no wildcard: {error}"))?;
    let key = wire::machine_key(&machine, Kind::Command);
    if payload.is_empty() {
        return Ok(vec![(key, wire::json_bytes(itself))]);
    }
    let reply = sender.apply(machine, wire::decode_command(&payload)?, arrived).await?;
    Ok(vec![(key, wire::json_bytes(&reply))])
}

/// Selects the machines of a query. `None` if its key expression is no pattern of SQLite: a query without a limit then
/// selects all machines, and [`messages`] filters their replies.
fn patterns(question: &Query) -> Option<Selector> {
    wire::machine_patterns(question.key_expr()).map(|[site, machine]| Selector { site, machine })
}
