//! `/`: all machines, the worst first, and the daemon's own state.

use std::{collections::HashSet, sync::Arc};

use askama::Template;
use axum::{extract::State, response::Response};

use super::{
    Web,
    overview::{MACHINES, Overview},
    page::{self, Failure},
    standing::{self, Standing},
    trouble,
};
use crate::{
    daemon::{View, clock},
    store::HealthRow,
    throw::{Direction, MachineId},
    wire::{self, Alarm},
};

/// Open alarms on the page, the worst ones where there are more.
const ALARMS: usize = 200;

#[derive(Template)]
#[template(path = "fleet.html", config = "src/web/askama.toml")]
struct Page {
    trouble: Vec<String>,
    daemon: Vec<(&'static str, String)>,
    tally: Vec<(Standing, usize)>,
    machines: Vec<Tile>,
    machines_not_shown: String,
    never_heard: Vec<String>,
    alarms: Vec<AlarmLine>,
    alarms_not_shown: String,
    now: String,
}

/// One machine.
struct Tile {
    machine: MachineId,
    standing: Standing,
    ways: Vec<Way>,
    last_throw: String,
    /// Why the last throw gave no estimate.
    refused: Option<String>,
}

/// One direction of a machine.
pub(super) struct Way {
    pub(super) direction: &'static str,
    pub(super) standing: Standing,
    pub(super) progress: Option<String>,
    pub(super) changes: Option<[String; 3]>,
}

/// One alarm.
pub(super) struct AlarmLine {
    pub(super) machine: MachineId,
    pub(super) standing: Standing,
    pub(super) state: String,
    pub(super) cause: String,
    pub(super) text: String,
    pub(super) raised_at: String,
}

pub(super) async fn page(State(web): State<Arc<Web>>) -> Result<Response, Failure> {
    let overview = web.overview().await?;
    let machines = tiles(&overview);
    let rank = [Standing::Critical, Standing::NotMonitored, Standing::Warning, Standing::Filling, Standing::Good];
    let tally = rank.map(|standing| (standing, machines.iter().filter(|tile| tile.standing == standing).count()));
    let open: u64 = overview.alarms_by_kind.iter().map(|(_, _, number)| number).sum();
    let shown_all = overview.machines <= u64::from(MACHINES);
    Ok(page::html(&Page {
        trouble: trouble::all(&web.view, &overview),
        daemon: daemon(&web.view, &overview),
        tally: tally.into_iter().filter(|(_, number)| *number > 0).collect(),
        never_heard: if shown_all { never_heard(&web.view, &overview) } else { Vec::new() },
        machines_not_shown: not_shown(overview.machines, u64::from(MACHINES)),
        machines,
        alarms: overview.alarms.iter().take(ALARMS).filter_map(alarm_line).collect(),
        alarms_not_shown: not_shown(open, ALARMS as u64),
        now: page::time(clock::now()),
    }))
}

/// How many of `all` are beyond `most`; empty for none.
fn not_shown(all: u64, most: u64) -> String {
    if all > most { page::count(all - most) } else { String::new() }
}

fn daemon(view: &View, overview: &Overview) -> Vec<(&'static str, String)> {
    let (report, statistics) = (view.report(), &overview.statistics);
    let space = statistics.free_disk_bytes.map(|free| format!(", {} free", page::size(free))).unwrap_or_default();
    vec![
        ("pointsd", report.version),
        ("running for", page::duration(report.uptime_s)),
        ("loggers", page::count(report.loggers as u64)),
        ("link", if report.connected { "connected" } else { "nobody is connected" }.to_owned()),
        ("disk", format!("{}{space}", report.disk)),
        ("database", page::size(statistics.data_bytes)),
        ("throws kept", page::count(statistics.throws)),
        ("wait to be judged", page::count(statistics.pending)),
        ("wait to be published", page::count(statistics.outbox)),
        ("missing", page::count(statistics.missing_throws)),
        ("in quarantine", page::count(statistics.quarantined)),
    ]
}

fn tiles(overview: &Overview) -> Vec<Tile> {
    let mut tiles: Vec<Tile> =
        overview.health.chunk_by(|one, next| one.machine == next.machine).map(|rows| tile(rows, overview)).collect();
    // The sort is stable: within a standing they stay by name.
    tiles.sort_by_key(|tile| tile.standing);
    tiles
}

fn tile(rows: &[HealthRow], overview: &Overview) -> Tile {
    let machine = rows[0].machine.clone();
    let alarms: Vec<&Alarm> = overview.alarms.iter().filter(|alarm| is_of(alarm, &machine)).collect();
    let ways = ways(rows, &alarms);
    let of_alarms = alarms.iter().map(|alarm| Standing::of_alarm(alarm)).min();
    let of_ways = ways.iter().map(|way| way.standing).min();
    let last = rows.iter().max_by_key(|row| row.started_at);
    Tile {
        standing: of_alarms.into_iter().chain(of_ways).min().unwrap_or(Standing::Filling),
        ways,
        last_throw: last.map(|row| page::time(row.started_at)).unwrap_or_default(),
        refused: last.filter(|row| row.quality != wire::GOOD).map(reason),
        machine,
    }
}

/// How each direction of a machine stands, from the latest throw of each.
pub(super) fn ways(latest: &[HealthRow], alarms: &[&Alarm]) -> Vec<Way> {
    let way = |direction: Direction| {
        let row = latest.iter().find(|row| row.direction == Some(direction));
        Way {
            direction: match direction {
                Direction::NormalToReverse => "normal to reverse",
                Direction::ReverseToNormal => "reverse to normal",
            },
            standing: Standing::of_direction(row, alarms.iter().copied()),
            progress: standing::progress(row),
            changes: row.and_then(standing::changes),
        }
    };
    Direction::BOTH.map(way).into()
}

/// Why a throw was not evaluated, as a sentence where there is one.
pub(super) fn reason(row: &HealthRow) -> String {
    row.detail.clone().unwrap_or_else(|| row.quality.replace('_', " "))
}

fn is_of(alarm: &Alarm, machine: &MachineId) -> bool {
    alarm.site == machine.site.as_str() && alarm.machine == machine.machine.as_str()
}

pub(super) fn alarm_line(alarm: &Alarm) -> Option<AlarmLine> {
    Some(AlarmLine {
        machine: MachineId::new(&alarm.site, &alarm.machine).ok()?,
        standing: Standing::of_alarm(alarm),
        state: alarm.state.as_str().replace('_', ", "),
        cause: alarm.cause.to_string(),
        text: alarm.text.clone(),
        raised_at: page::time(alarm.raised_at),
    })
}

/// Machines that the configuration names and nobody ever heard.
fn never_heard(view: &View, overview: &Overview) -> Vec<String> {
    let heard: HashSet<&MachineId> = overview.health.iter().map(|row| &row.machine).collect();
    let config = view.config();
    let mut silent: Vec<String> =
        config.machines.named().filter(|machine| !heard.contains(machine)).map(ToString::to_string).collect();
    silent.sort();
    silent
}
