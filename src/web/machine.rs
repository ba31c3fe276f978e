//! `/machines/{site}/{machine}`: trends, alarms and last throws of one machine.

use std::{collections::HashSet, sync::Arc};

use askama::Template;
use axum::{
    extract::{Path, RawQuery, State, rejection::PathRejection},
    response::Response,
};
use jiff::Timestamp;

use super::{
    Web,
    fleet::{Way, reason, ways},
    overview::readable,
    page::{self, Failure},
    standing::{self, Standing},
    trend::{self, Mark, Picture, Ways},
};
use crate::{
    daemon::clock,
    diagnose::AlarmState,
    store::{AlarmEventRow, HealthRow, Reader, Selector, StoreError},
    throw::{Direction, MachineId},
    wire::{self, Alarm},
};

/// Throws in the table.
const THROWS: u32 = 20;
/// Alarm events in the table.
const EVENTS: u32 = 50;

/// How much of a machine's life the trends show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Span {
    Newest(u32),
    All,
}

impl Span {
    const CHOICES: [(Self, &str, &str); 3] = [
        (Self::Newest(100), "100", "last 100"),
        (Self::Newest(1_000), "1000", "last 1,000"),
        (Self::All, "all", "all that is kept"),
    ];

    fn from_query(query: Option<&str>) -> Result<Self, Failure> {
        let Some(word) = query.filter(|query| !query.is_empty()) else { return Ok(Self::Newest(100)) };
        let choice = Self::CHOICES.into_iter().find(|(_, choice, _)| word.strip_prefix("span=") == Some(choice));
        let wrong =
            || Failure::bad_request("The address may end in ?span=100, ?span=1000 or ?span=all, and nothing else.");
        choice.map(|(span, ..)| span).ok_or_else(wrong)
    }
}

#[derive(Template)]
#[template(path = "machine.html", config = "src/web/askama.toml")]
struct Page {
    trouble: Vec<String>,
    machine: MachineId,
    standing: Standing,
    ways: Vec<Way>,
    /// Address, words, and whether it is what is shown.
    spans: Vec<(&'static str, &'static str, bool)>,
    trends: Vec<Picture>,
    drawn: String,
    events: Vec<Event>,
    throws: Vec<Row>,
    now: String,
}

/// One event in the life of an alarm.
struct Event {
    at: String,
    standing: Standing,
    cause: String,
    state: String,
    text: String,
    by: String,
}

/// One throw.
pub(super) struct Row {
    pub(super) boot_id: String,
    pub(super) throw_no: u64,
    pub(super) at: String,
    pub(super) direction: String,
    pub(super) changes: Option<[String; 3]>,
    pub(super) fit: String,
    pub(super) duration: String,
    pub(super) peak: String,
    pub(super) refused: Option<String>,
}

pub(super) async fn page(
    State(web): State<Arc<Web>>,
    names: Result<Path<(String, String)>, PathRejection>,
    RawQuery(query): RawQuery,
) -> Result<Response, Failure> {
    let Path((site, machine)) = names?;
    let machine = known_name(&site, &machine)?;
    let span = Span::from_query(query.as_deref())?;
    let trouble = web.trouble().await;
    let _turn = web.turn().await?;
    let reader = web.view.reader();
    let throws = reader.newest_throws_of(&machine, THROWS).await?;
    let events = reader.alarm_events_of(&machine, EVENTS).await?;
    if throws.is_empty() && events.is_empty() {
        return Err(Failure::not_found(format!("No throw of a machine {machine} is known.")));
    }
    let both = [
        (Direction::NormalToReverse, rows(reader, &machine, Direction::NormalToReverse, span).await?),
        (Direction::ReverseToNormal, rows(reader, &machine, Direction::ReverseToNormal, span).await?),
    ];
    let which = Selector { site: Some(machine.site.clone()), machine: Some(machine.machine.clone()) };
    let alarms = readable(&reader.open_alarms(&which).await?);
    let alarms: Vec<&Alarm> = alarms.iter().collect();
    let latest: Vec<HealthRow> = both.iter().filter_map(|(_, rows)| rows.last().cloned()).collect();
    let ways = ways(&latest, &alarms);
    let events: Vec<(Alarm, AlarmEventRow)> =
        events.into_iter().filter_map(|row| Some((serde_json::from_str(&row.payload).ok()?, row))).collect();
    let worst = ways.iter().map(|way| way.standing).chain(alarms.iter().map(|alarm| Standing::of_alarm(alarm))).min();
    Ok(page::html(&Page {
        trouble,
        standing: worst.unwrap_or(Standing::Filling),
        ways,
        spans: Span::CHOICES.into_iter().map(|(choice, word, says)| (word, says, choice == span)).collect(),
        trends: trend::trends(&both, &marks(&both, &events), &web.view.config().diagnosis),
        drawn: drawn(&both),
        events: events.iter().map(|(alarm, row)| event(alarm, row)).collect(),
        throws: throws.iter().map(row).collect(),
        machine,
        now: page::time(clock::now()),
    }))
}

/// A machine that could exist.
pub(super) fn known_name(site: &str, machine: &str) -> Result<MachineId, Failure> {
    let wrong = |_| Failure::not_found("There is no such machine: names have 1 to 64 of A-Z a-z 0-9 _ -");
    MachineId::new(site, machine).map_err(wrong)
}

async fn rows(
    reader: &Reader,
    machine: &MachineId,
    direction: Direction,
    span: Span,
) -> Result<Vec<HealthRow>, StoreError> {
    match span {
        Span::Newest(limit) => Ok(trend::thinned(reader.newest_of(machine, direction, limit).await?)),
        Span::All => reader.spread_of(machine, direction, u32::try_from(trend::POINTS).unwrap_or(u32::MAX)).await,
    }
}

/// "From … to …: 250 and 250 throws drawn."
fn drawn(ways: &Ways) -> String {
    let times = || ways.iter().flat_map(|(_, rows)| rows).map(|row| row.started_at);
    let (Some(first), Some(last)) = (times().min(), times().max()) else {
        return "No throw whose direction is known.".to_owned();
    };
    let [there, back] = ways.each_ref().map(|(_, rows)| rows.len());
    format!(
        "{} to {}; drawn are {there} throws normal to reverse and {back} back.",
        page::time(first),
        page::time(last)
    )
}

/// When alarms were raised, within what is shown; oldest first.
fn marks(ways: &Ways, events: &[(Alarm, AlarmEventRow)]) -> Vec<Mark> {
    let first = ways.iter().filter_map(|(_, rows)| rows.first()).map(|row| row.started_at).min();
    let mut seen = HashSet::new();
    let raised = events.iter().rev().filter(|(alarm, _)| seen.insert((&alarm.alarm_id, alarm.severity)));
    let shown = |at: Timestamp| first.is_some_and(|first| first <= at);
    raised
        .filter(|(alarm, _)| shown(alarm.event_at) && alarm.state == AlarmState::ActiveUnacknowledged)
        .map(|(alarm, _)| Mark { at: alarm.event_at, label: format!("{}, {}", alarm.cause, alarm.severity.as_str()) })
        .collect()
}

fn event(alarm: &Alarm, row: &AlarmEventRow) -> Event {
    let by = match (&row.by, &row.why) {
        (Some(by), Some(why)) => format!("{by}: {why}"),
        (Some(by), None) => by.clone(),
        (None, _) => String::new(),
    };
    Event {
        at: page::time(alarm.event_at),
        standing: Standing::of_alarm(alarm),
        cause: alarm.cause.to_string(),
        state: alarm.state.as_str().replace('_', ", "),
        text: alarm.text.clone(),
        by,
    }
}

pub(super) fn row(health: &HealthRow) -> Row {
    let with =
        |value: Option<f64>, decimals: usize| value.map(|value| format!("{value:.decimals$}")).unwrap_or_default();
    Row {
        boot_id: health.throw.boot_id.clone(),
        throw_no: health.throw.throw_no,
        at: page::time(health.started_at),
        direction: health.direction.map_or_else(|| "unknown".to_owned(), |direction| direction.to_string()),
        changes: standing::changes(health),
        fit: with(health.fit_pct, 2),
        duration: with(health.duration_s, 2),
        peak: with(health.peak_current_a, 1),
        refused: (health.quality != wire::GOOD).then(|| reason(health)),
    }
}
