//! Answers questions from the database, and hands operators' commands to the loop that judges.

use std::time::Duration;

use jiff::Timestamp;
use tokio::{
    sync::{mpsc, oneshot},
    time,
};

use super::{judge::Order, status::Gauges};
use crate::{
    bus::{self, Question, Questions},
    store::{HealthRow, Reader, Selector, StoreError},
    throw::Direction,
    wire::{self, Health, HistoryQuery, Kind, Reply},
};

/// Longest wait for a command: the loop that judges may be in the middle of a batch.
const COMMAND_LIMIT: Duration = Duration::from_secs(20);

type Replies = Result<Vec<(String, Vec<u8>)>, String>;

/// Answers questions about health.
pub(super) async fn health(mut questions: Questions, reader: Reader) {
    while let Some(question) = questions.next().await {
        let replies = health_replies(&question, &reader).await;
        bus::answer(question, replies).await;
    }
}

async fn health_replies(question: &Question, reader: &Reader) -> Replies {
    let rows = match HistoryQuery::parse(question.parameters()).map_err(|error| error.to_string())? {
        HistoryQuery::Current => reader.latest_health(&selector(question)).await,
        HistoryQuery::History { since, limit } => {
            reader.health_history(&selector(question), since.unwrap_or(Timestamp::UNIX_EPOCH), row_limit(limit)).await
        }
    };
    let rows = rows.map_err(|error| unavailable(&error))?;
    let messages =
        rows.iter().map(|row| (wire::machine_key(&row.machine, Kind::Health), health_message(row).to_json()));
    Ok(messages.filter(|(key, _)| question.asks_about(key)).collect())
}

/// Answers questions about alarms; not those that also go to the queryable `elsewhere`, which answers them.
pub(super) async fn alarms(mut questions: Questions, reader: Reader, elsewhere: Option<String>) {
    while let Some(question) = questions.next().await {
        if elsewhere.as_ref().is_some_and(|elsewhere| question.asks_about(elsewhere)) {
            continue;
        }
        let replies = alarm_replies(&question, &reader).await;
        bus::answer(question, replies).await;
    }
}

async fn alarm_replies(question: &Question, reader: &Reader) -> Replies {
    let rows = match HistoryQuery::parse(question.parameters()).map_err(|error| error.to_string())? {
        HistoryQuery::Current => reader.open_alarms(&selector(question)).await,
        HistoryQuery::History { since, limit } => {
            reader.alarm_history(&selector(question), since.unwrap_or(Timestamp::UNIX_EPOCH), row_limit(limit)).await
        }
    };
    let rows = rows.map_err(|error| unavailable(&error))?;
    let messages = rows.into_iter().map(|row| (wire::machine_key(&row.machine, Kind::Alarm), row.payload.into_bytes()));
    Ok(messages.filter(|(key, _)| question.asks_about(key)).collect())
}

/// Takes operators' commands.
pub(super) async fn commands(mut questions: Questions, orders: mpsc::Sender<Order>) {
    while let Some(question) = questions.next().await {
        let replies = command_reply(&question, &orders).await;
        bus::answer(question, replies).await;
    }
}

async fn command_reply(question: &Question, orders: &mpsc::Sender<Order>) -> Replies {
    let (machine, _) = wire::parse_key(question.key())
        .map_err(|error| format!("a command goes to one machine, so its key has no wildcard: {error}"))?;
    let command = wire::decode_command(&question.payload()).map_err(|error| error.to_string())?;
    let (reply, answer) = oneshot::channel();
    let order = Order { machine: machine.clone(), command, reply };
    let busy = || "the daemon is busy: ask again".to_owned();
    let answer = time::timeout(COMMAND_LIMIT, async {
        orders.send(order).await.map_err(|_| busy())?;
        answer.await.map_err(|_| busy())
    });
    let reply: Reply = answer.await.map_err(|_| busy())??;
    Ok(vec![(wire::machine_key(&machine, Kind::Command), reply.to_json())])
}

/// Answers questions about the daemon itself.
pub(super) async fn status(mut questions: Questions, key: String, gauges: Gauges) {
    while let Some(question) = questions.next().await {
        let replies = serde_json::to_vec(&gauges.report()).map(|report| vec![(key.clone(), report)]);
        bus::answer(question, replies.map_err(|error| error.to_string())).await;
    }
}

fn unavailable(error: &StoreError) -> String {
    format!("the daemon cannot answer: {error}")
}

fn row_limit(limit: usize) -> u32 {
    u32::try_from(limit).unwrap_or(u32::MAX)
}

/// Narrows the database query where the question names a site or machine; the rest is filtered by key.
fn selector(question: &Question) -> Selector {
    let mut chunks = question.key().split('/').skip(2);
    let mut name = || chunks.next().and_then(|chunk| chunk.parse().ok());
    // After `**` the position of a chunk says nothing.
    if question.key().contains("**") {
        return Selector::default();
    }
    Selector { site: name(), machine: name() }
}

fn health_message(row: &HealthRow) -> Health {
    let of = |three: Option<[f64; 3]>, at: usize| three.map(|three| three[at]);
    Health {
        schema: Health::SCHEMA.to_owned(),
        site: row.machine.site.to_string(),
        machine: row.machine.machine.to_string(),
        boot_id: row.throw.boot_id.clone(),
        throw_no: row.throw.throw_no,
        started_at: row.started_at,
        direction: row.direction.map_or("unknown", Direction::as_str).to_owned(),
        quality: row.quality.clone(),
        b0: of(row.coefficients, 0),
        a1: of(row.coefficients, 1),
        a0: of(row.coefficients, 2),
        b0_sd: of(row.sd, 0),
        a1_sd: of(row.sd, 1),
        a0_sd: of(row.sd, 2),
        b0_pct: of(row.change_pct, 0),
        a1_pct: of(row.change_pct, 1),
        a0_pct: of(row.change_pct, 2),
        fit_pct: row.fit_pct,
        duration_s: row.duration_s,
        peak_current_a: row.peak_current_a,
        mean_current_a: row.mean_current_a,
    }
}
