//! `/machines/{site}/{machine}`: state, present drifts, trends, alarms and last throws of one machine.

use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
};

use askama::Template;
use axum::{
    extract::{Path, RawQuery, State, rejection::PathRejection},
    response::Response,
};
use jiff::SignedDuration;

use super::{
    alarm::AlarmLine,
    overview::Web,
    page::{self, Failure},
    state::{self, Badge},
    trend::{self, Directions, Mark, Picture},
};
use crate::{
    daemon::clock,
    diagnose::{AlarmState, BaselineRecord, MachineState, Present, Settings, is_possible_date},
    estimate::Grade,
    store::{CommandRow, Reader, StoreError, ThrowSelection, Window},
    throw::{Direction, MachineId, counted, utc},
    wire::{Alarm, BaselineProgress, Health},
};

/// Largest number of throws in the table.
const THROWS: u32 = 20;
/// Largest number of open alarms: a machine has one of each cause.
const ALARMS: u32 = 100;
/// Largest number of alarm events in the table.
const EVENTS: u32 = 50;
/// Largest number of operators' commands in the table.
const COMMANDS: u32 = 20;
/// Largest number of baselines in the charts. A machine has one for each direction, and new ones after work on it.
const BASELINES: u32 = 20;
/// Within this time complete baselines have one mark: those of both directions, which alternate.
const ONE_BASELINE: SignedDuration = SignedDuration::from_hours(24);

/// Which throws the charts of a machine show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Span {
    /// This number of the newest throws of each direction.
    Newest(u32),
    /// All stored throws.
    All,
}

impl Span {
    const CHOICES: [(Self, &str, &str); 3] = [
        (Self::Newest(100), "100", "last 100"),
        (Self::Newest(1_000), "1000", "last 1,000"),
        (Self::All, "all", "all stored"),
    ];

    fn from_query(query: Option<&str>) -> Result<Self, Failure> {
        let Some(word) = query.filter(|query| !query.is_empty()) else { return Ok(Self::Newest(100)) };
        let wrong =
            || Failure::bad_request("The address may end in ?span=100, ?span=1000 or ?span=all, and nothing else.");
        word.strip_prefix("span=").and_then(Self::from_word).ok_or_else(wrong)
    }

    /// The span for the word `100`, `1000` or `all`; `None` for another word.
    pub fn from_word(word: &str) -> Option<Self> {
        Self::CHOICES.into_iter().find(|(_, choice, _)| *choice == word).map(|(span, ..)| span)
    }
}

#[derive(Template)]
#[template(path = "machine.html", config = "src/web/askama.toml")]
struct Page {
    trouble: Vec<String>,
    machine: MachineId,
    badge: Badge,
    maintenance: Option<String>,
    /// Sentences about what the monitor cannot show at present.
    caveats: Vec<String>,
    alarms: Vec<AlarmLine>,
    /// Value for the address, text, and whether the span is selected.
    spans: Vec<(&'static str, &'static str, bool)>,
    /// The last throw of each direction.
    latest: Vec<Health>,
    /// The throws in the charts.
    both: Directions,
    /// Number of throws left out of the charts because of their dates.
    misdated: usize,
    baselines: Vec<BaselineRecord>,
    trends: Vec<Picture>,
    features: Vec<Picture>,
    events: Vec<Alarm>,
    commands: Vec<CommandRow>,
    /// The last throws, each with its quality in words.
    throws: Vec<Health>,
    takes_commands: bool,
    form: Form,
    /// Longest window in the form \[h\].
    longest_hours: u32,
    /// The style sheet, for the page as a file; `None` for a page of the dashboard.
    file_style: Option<&'static str>,
    volatile: String,
}

/// The form for commands.
#[derive(Default)]
pub(super) struct Form {
    /// Reason why the last command was refused.
    pub(super) refused: Option<String>,
    /// The values that the operator typed for it. The page repeats them, except the token.
    pub(super) fields: HashMap<String, String>,
}

impl Form {
    fn typed(&self, name: &str) -> &str {
        self.fields.get(name).map(String::as_str).unwrap_or_default()
    }

    /// For each command: its word, its text, and whether it is chosen. Commands about alarms are left out without an
    /// alarm.
    fn commands(&self, alarms: &[AlarmLine]) -> Vec<(&'static str, &'static str, bool)> {
        let of_alarms =
            [("ack", "acknowledge the alarm"), ("shelve", "shelve the alarm"), ("unshelve", "end the shelving")];
        let of_machine = [
            ("maintenance", "start maintenance"),
            ("maintenance_end", "end maintenance"),
            ("rebaseline", "take a new baseline"),
        ];
        let all = of_alarms.into_iter().filter(|_| !alarms.is_empty()).chain(of_machine);
        all.map(|(word, text)| (word, text, self.typed("command") == word)).collect()
    }
}

/// The last throw of a direction.
struct LastThrow {
    direction: Direction,
    baseline: String,
    /// For each coefficient: change in the last throw, and scatter of the machine.
    changes: Option<[(String, String); 3]>,
    /// Text in place of the changes.
    without: String,
}

pub(super) async fn page(
    State(web): State<Arc<Web>>,
    machine: Result<Path<MachineId>, PathRejection>,
    RawQuery(query): RawQuery,
) -> Result<Response, Failure> {
    let Path(machine) = machine?;
    show(&web, &machine, query.as_deref(), Form::default()).await
}

/// The page of a machine with a form, which is not empty after a refused command.
pub(super) async fn show(web: &Web, machine: &MachineId, query: Option<&str>, form: Form) -> Result<Response, Failure> {
    let span = Span::from_query(query)?;
    let trouble = web.trouble().await;
    let _permit = web.read_permit().await?;
    let config = web.view.config();
    let page = read(web.reader(), machine, span, &config.diagnosis).await?;
    let page = page.ok_or_else(|| Failure::not_found(format!("No throw of a machine {machine} is known.")))?;
    Ok(page::html(&Page { trouble, takes_commands: config.web.token.is_some(), form, ..page }))
}

/// The page of a machine as one HTML file without links. The charts show the limits in `settings`. `None` for an
/// unknown machine.
///
/// # Errors
/// When the database cannot be read.
pub async fn report(
    reader: &Reader,
    machine: &MachineId,
    span: Span,
    settings: &Settings,
) -> Result<Option<String>, StoreError> {
    let Some(mut file) = read(reader, machine, span, settings).await? else { return Ok(None) };
    file.file_style = Some(page::STYLE);
    file.trends.iter_mut().chain(&mut file.features).for_each(|picture| picture.data.clear());
    file.alarms.iter_mut().for_each(|alarm| alarm.throw = None);
    Ok(Some(page::rendered(&file)))
}

/// Reads the page of a machine; `None` for an unknown machine.
async fn read(
    reader: &Reader,
    machine: &MachineId,
    span: Span,
    settings: &Settings,
) -> Result<Option<Page>, StoreError> {
    if !reader.is_known(machine).await? {
        return Ok(None);
    }
    let throws = reader.newest_throws_of(machine, THROWS).await?;
    let events = reader.alarm_events_of(machine, EVENTS).await?;
    let Present { state: now_state, caveats, .. } = reader.state_of(machine).await?;
    let mut both = [
        (Direction::NormalToReverse, rows(reader, machine, Direction::NormalToReverse, span).await?),
        (Direction::ReverseToNormal, rows(reader, machine, Direction::ReverseToNormal, span).await?),
    ];
    let misdated = leave_out_misdated(&mut both);
    let baselines = reader.baselines_of(machine, BASELINES).await?;
    // Not the last row of a chart: the clock of the logger may have been ahead for a time.
    let latest = reader.latest_health(&machine.into()).await?;
    let of_baseline = [
        throws_of_baseline(reader, machine, Direction::NormalToReverse, &latest, &baselines).await?,
        throws_of_baseline(reader, machine, Direction::ReverseToNormal, &latest, &baselines).await?,
    ];
    let commands = reader.commands_of(machine, COMMANDS).await?;
    let windows = reader.windows(Some(machine)).await?;
    let open = reader.faults_of(machine, ALARMS).await?;
    let marks = marks(&both, &events, &baselines, &commands);
    Ok(Some(Page {
        trouble: Vec::new(),
        badge: Badge(now_state),
        caveats,
        maintenance: maintenance(now_state, &windows),
        alarms: AlarmLine::all(&open.alarms, &windows),
        spans: Span::CHOICES.into_iter().map(|(choice, word, text)| (word, text, choice == span)).collect(),
        trends: trend::coefficients(&both, &marks, &baselines, settings),
        features: trend::features(&both, &of_baseline, &marks),
        throws,
        events,
        commands,
        takes_commands: false,
        form: Form::default(),
        longest_hours: 24 * settings.longest_shelving_days,
        file_style: None,
        volatile: format!("As of {}.", utc(&clock::now())),
        machine: machine.clone(),
        latest,
        both,
        misdated,
        baselines,
    }))
}

/// Reason why the charts of the coefficients are empty.
fn no_trends(both: &Directions, baselines: &[BaselineRecord]) -> &'static str {
    let mut rows = trend::all(both).peekable();
    if rows.peek().is_some() && rows.all(|row| row.grade() == Some(Grade::CurrentOnly) && row.coefficients.is_none()) {
        "These throws have no toe position or a three-phase motor, and so no coefficients. Their duration and currents, below, are compared with \
         those of the first throws."
    } else if baselines.iter().any(|baseline| baseline.ratios_only) {
        "The throws of the baseline have only the ratios of the coefficients: changes of the ratios are below."
    } else if baselines.is_empty() {
        "No baseline yet: changes are shown as soon as a baseline has its first throws."
    } else {
        "None of these throws has coefficients to compare with the baseline."
    }
}

async fn rows(
    reader: &Reader,
    machine: &MachineId,
    direction: Direction,
    span: Span,
) -> Result<Vec<Health>, StoreError> {
    let mut rows = match span {
        Span::Newest(limit) => {
            trend::thinned(reader.throws_in(machine, direction, ThrowSelection::Newest(limit)).await?)
        }
        Span::All => reader.throws_in(machine, direction, ThrowSelection::Spread(trend::POINTS)).await?,
    };
    // The rows are in the order of arrival. Throws from a backlog arrive after newer ones.
    rows.sort_by_key(|row| row.started_at);
    Ok(rows)
}

/// Leaves out throws with impossible dates, and returns their number: one throw of 1970, from a logger that has not set
/// its clock yet, would press all others into a line. If no date is possible, all throws stay.
fn leave_out_misdated(both: &mut Directions) -> usize {
    let now = clock::now();
    let is_possible = |row: &Health| is_possible_date(row.started_at, now);
    let count = |both: &Directions| both.iter().map(|(_, rows)| rows.len()).sum::<usize>();
    let before = count(both);
    if trend::all(both).any(is_possible) {
        for (_, rows) in both.iter_mut() {
            rows.retain(is_possible);
        }
    }
    before - count(both)
}

/// The throws of the present baseline of a direction; empty if there is none, or a new one is still being learned.
async fn throws_of_baseline(
    reader: &Reader,
    machine: &MachineId,
    direction: Direction,
    latest: &[Health],
    baselines: &[BaselineRecord],
) -> Result<Vec<Health>, StoreError> {
    let Some(baseline) = trend::newest(baselines, direction) else { return Ok(Vec::new()) };
    let so_far = last_in(latest, direction).and_then(|last| last.baseline).map_or(0, |baseline| baseline.so_far);
    if so_far < baseline.throws as u64 {
        return Ok(Vec::new());
    }
    let throws = u32::try_from(baseline.throws).unwrap_or(u32::MAX);
    reader.throws_in(machine, direction, ThrowSelection::Until(baseline.taken_at, throws)).await
}

fn maintenance(state: MachineState, windows: &[Window]) -> Option<String> {
    let window = windows.iter().find(|window| window.cause.is_none());
    (state == MachineState::Maintenance).then(|| window.map_or_else(|| "in maintenance".to_owned(), page::window))
}

fn last_in(latest: &[Health], direction: Direction) -> Option<&Health> {
    latest.iter().find(|throw| throw.direction == Some(direction))
}

/// The last throw of each direction: baseline, changes, and scatter of the machine.
fn last_throws(latest: &[Health], baselines: &[BaselineRecord]) -> Vec<LastThrow> {
    let last_throw = |direction: Direction| {
        let last = last_in(latest, direction);
        let scatter = trend::scatter_pct(baselines, direction);
        let change = last.and_then(|last| last.change_pct);
        let text = |at: usize, change: [f64; 3]| {
            let own = scatter.map(|scatter| format!("± {:.1}", scatter[at])).unwrap_or_default();
            (state::signed(change[at], 1), own)
        };
        // A baseline with a trend has all its throws.
        let is_provisional = trend::newest(baselines, direction).is_some_and(|newest| !newest.complete);
        let baseline = match last.and_then(|last| last.baseline) {
            Some(baseline) if baseline.is_complete() && is_provisional => "provisional".to_owned(),
            Some(baseline) if baseline.is_complete() => "complete".to_owned(),
            Some(BaselineProgress { so_far, needed }) => format!("{so_far} of {needed} throws"),
            None => "none yet".to_owned(),
        };
        LastThrow {
            direction,
            baseline,
            changes: change.map(|change| [text(0, change), text(1, change), text(2, change)]),
            without: last.map(without).unwrap_or_default(),
        }
    };
    Direction::BOTH.into_iter().map(last_throw).collect()
}

/// Text for a throw without changes of the coefficients: the changes of the ratios, or the reason.
fn without(row: &Health) -> String {
    if let Some((friction, stiffness)) = row.a1_per_b0_pct.zip(row.a0_per_b0_pct) {
        let [friction, stiffness] = [friction, stiffness].map(|change| state::signed(change, 1));
        let ratios = format!("friction per motor {friction} %, stiffness per motor {stiffness} %");
        return if row.coefficients.is_some() { ratios } else { format!("{ratios}; {}", quality(row)) };
    }
    match row.grade() {
        _ if row.coefficients.is_some() => "not compared with a baseline".to_owned(),
        Some(Grade::Rough) => {
            format!("{}; it has only the ratios of the coefficients, in the charts below", quality(row))
        }
        Some(Grade::CurrentOnly) => "features only: there is no position, or the motor is three-phase".to_owned(),
        _ => quality(row),
    }
}

/// The quality of a throw in words, with the reason if the throw is rejected or rough.
pub(super) fn quality(row: &Health) -> String {
    let word = row.quality.replace('_', " ");
    match &row.detail {
        detail if row.is_rejected() => format!("rejected: {}", detail.as_ref().unwrap_or(&word)),
        Some(detail) => format!("{word}: {detail}"),
        None => word,
    }
}

/// The direction of a throw in words.
pub(super) fn direction(row: &Health) -> String {
    row.direction.map_or_else(|| "unknown".to_owned(), |direction| direction.to_string())
}

fn changes(row: &Health) -> Option<[String; 3]> {
    row.change_pct.map(|change| change.map(|change| state::signed(change, 1)))
}

/// "2026-05-04 … to 2026-05-06 …; drawn are 250 throws normal to reverse and 250 back."
fn drawn(directions: &Directions) -> String {
    let times = || trend::all(directions).map(|row| row.started_at);
    let (Some(first), Some(last)) = (times().min(), times().max()) else {
        return "No throw with a known direction.".to_owned();
    };
    let [there, back] = directions.each_ref().map(|(_, rows)| rows.len());
    format!(
        "{} to {}; drawn are {} normal to reverse and {back} back.",
        utc(&first),
        utc(&last),
        counted(there, "throw")
    )
}

/// Sentence about throws that are left out of the charts because of their dates.
fn left_out(misdated: usize) -> String {
    let are = if misdated == 1 { "is" } else { "are" };
    let throws = counted(misdated, "throw");
    if misdated == 0 { String::new() } else { format!("{throws} dated before 2001 or a day ahead {are} left out.") }
}

fn drawn_throws(directions: &Directions) -> String {
    let rows = trend::all(directions);
    page::data(&rows.map(|row| (trend::x(row.started_at), page::throw_path(&row.throw))).collect::<Vec<_>>())
}

/// "Rejected among these: 12 supply sagged, 3 no movement."
fn rejected(directions: &Directions) -> String {
    let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
    for row in trend::all(directions).filter(|row| row.is_rejected()) {
        *reasons.entry(&row.quality).or_default() += 1;
    }
    let reasons: Vec<String> =
        reasons.into_iter().map(|(reason, count)| format!("{count} {}", reason.replace('_', " "))).collect();
    if reasons.is_empty() { String::new() } else { format!("Rejected among these: {}.", reasons.join(", ")) }
}

/// The marks in the charts: raised alarms, complete baselines and commands since the first throw in the charts, oldest
/// first.
fn marks(
    directions: &Directions,
    events: &[Alarm],
    baselines: &[BaselineRecord],
    commands: &[CommandRow],
) -> Vec<Mark> {
    let Some(first) = directions.iter().filter_map(|(_, rows)| rows.first()).map(|row| row.started_at).min() else {
        return Vec::new();
    };
    let raised = events.iter().filter(|alarm| alarm.event_no == 1 && alarm.state == AlarmState::ActiveUnacknowledged);
    let raised =
        raised.map(|alarm| Mark { at: alarm.event_at, label: format!("{}, {}", alarm.cause, alarm.severity.as_str()) });
    let complete = baselines.iter().filter(|baseline| baseline.complete);
    let complete = complete.map(|baseline| Mark { at: baseline.taken_at, label: "baseline".to_owned() });
    let shown = ["maintenance_start", "maintenance_end", "rebaseline", "retire"];
    let commands = commands.iter().filter(|command| shown.contains(&command.command.as_str()));
    let commands = commands.map(|command| Mark { at: command.at, label: command.command.replace('_', " ") });
    let mut marks: Vec<Mark> = raised.chain(complete).chain(commands).filter(|mark| mark.at >= first).collect();
    marks.sort_by_key(|mark| mark.at);
    marks.dedup_by(|one, before| {
        let is_near = one.at.duration_since(before.at) < ONE_BASELINE;
        is_near && one.label == before.label && one.label == "baseline"
    });
    marks
}
