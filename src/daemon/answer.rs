//! Answers queries from the database, and forwards operators' commands to the judge loop.

use super::{orders::Orders, status::Gauges};
use crate::{
    bus::{Question, Questions},
    store::{Reader, Selector, StoreError, seldom},
    wire::{self, Alarm, Commander, Health, HistoryQuery, Kind},
};

type Replies = Result<Vec<(String, Vec<u8>)>, String>;

/// The next query; `None` when the session is closed.
async fn next(questions: &mut Questions) -> Option<Question> {
    let question = questions.next().await;
    let dropped = questions.take_dropped();
    if dropped > 0 {
        seldom!(warn, dropped, "queue of queries full: queries refused");
    }
    question
}

/// Answers health queries.
pub(super) async fn health(mut questions: Questions, reader: Reader) {
    while let Some(question) = next(&mut questions).await {
        let replies = health_replies(&question, &reader).await;
        questions.answer(question, replies).await;
    }
}

async fn health_replies(question: &Question, reader: &Reader) -> Replies {
    let rows = match HistoryQuery::parse(question.parameters()).map_err(|error| error.to_string())? {
        HistoryQuery::Current => reader.latest_health(&selector(question)).await,
        HistoryQuery::History { since, limit } => reader.health_history(&selector(question), since, limit).await,
    };
    let message = |health: Health| (wire::machine_key(&health.machine, Kind::Health), health.to_json());
    messages(question, rows, message)
}

/// Answers alarm queries, except those that the queryable `elsewhere` receives and answers too.
pub(super) async fn alarms(mut questions: Questions, reader: Reader, elsewhere: Option<String>) {
    while let Some(question) = next(&mut questions).await {
        if elsewhere.as_ref().is_some_and(|elsewhere| question.asks_about(elsewhere)) {
            continue;
        }
        let replies = alarm_replies(&question, &reader).await;
        questions.answer(question, replies).await;
    }
}

async fn alarm_replies(question: &Question, reader: &Reader) -> Replies {
    let rows = match HistoryQuery::parse(question.parameters()).map_err(|error| error.to_string())? {
        HistoryQuery::Current => reader.open_alarms(&selector(question)).await,
        HistoryQuery::History { since, limit } => reader.alarm_history(&selector(question), since, limit).await,
    };
    let message = |alarm: Alarm| (wire::machine_key(&alarm.machine, Kind::Alarm), alarm.into_message());
    messages(question, rows, message)
}

fn messages<T>(
    question: &Question,
    rows: Result<Vec<T>, StoreError>,
    message: impl Fn(T) -> (String, Vec<u8>),
) -> Replies {
    let rows = rows.map_err(|error| format!("the daemon cannot answer: {error}"))?;
    Ok(rows.into_iter().map(message).filter(|(key, _)| question.asks_about(key)).collect())
}

/// Receives operators' commands, and answers queries for the name of the daemon, `itself`. A command for another daemon
/// gets no reply.
pub(super) async fn commands(mut questions: Questions, orders: Orders, itself: Commander) {
    while let Some(question) = next(&mut questions).await {
        let replies = match question.parameter("session") {
            Some(other) if other != itself.session => Ok(Vec::new()),
            _ => command_reply(&question, &orders, &itself).await,
        };
        questions.answer(question, replies).await;
    }
}

async fn command_reply(question: &Question, orders: &Orders, itself: &Commander) -> Replies {
    let (machine, _) = wire::parse_key(question.key())
        .map_err(|error| format!("a command goes to one machine, so its key has no wildcard: {error}"))?;
    let key = wire::machine_key(&machine, Kind::Command);
    let payload = question.payload();
    if payload.is_empty() {
        let reply = serde_json::to_vec(itself).map_err(|error| error.to_string())?;
        return Ok(vec![(key, reply)]);
    }
    let command = wire::decode_command(&payload).map_err(|error| error.to_string())?;
    Ok(vec![(key, orders.carry_out(machine, command).await?.to_json())])
}

/// Answers status queries.
pub(super) async fn status(mut questions: Questions, key: String, gauges: Gauges) {
    while let Some(question) = next(&mut questions).await {
        let mut report = gauges.report();
        match gauges.store.reader().windows(None).await {
            Ok(windows) => report.windows = windows,
            // The rest of the status is most important when the database does not answer.
            Err(error) => seldom!(warn, %error, "the database does not answer: status without maintenance windows"),
        }
        questions.answer(question, Ok(vec![(key.clone(), wire::json(&report).into_bytes())])).await;
    }
}

/// The machines of the question. A key expression that cannot be a pattern of SQLite selects all machines, and their
/// messages are filtered afterwards.
fn selector(question: &Question) -> Selector {
    wire::machine_patterns(question.key()).map_or_else(Selector::default, |[site, machine]| Selector { site, machine })
}
