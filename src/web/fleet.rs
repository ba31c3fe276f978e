//! `/`: the open alarms, all machines with the worst first, and the daemon.

use std::{
    cmp::Reverse,
    collections::{BTreeMap, HashSet},
    fmt::Write as _,
    sync::Arc,
};

use askama::Template;
use axum::{
    extract::{RawQuery, State},
    response::Response,
};
use indicatif::HumanBytes;
use strum::VariantArray as _;

use super::{
    alarm::AlarmLine,
    overview::{Overview, Web},
    page::{self, Failure},
    state::{self, Badge},
    trouble,
};
use crate::{
    daemon::{StatusReport, View, clock},
    diagnose::{AlarmState, Cause, MachineState, Settings, Severity},
    store::{CommonAlarm, Fault, FleetQuery, FleetRow, Reader, StateCounts, WORST_FIRST, Window},
    throw::{MachineId, Name, counted, utc},
    wire::{self, BaselineProgress},
};

/// Number of machines on one page.
const MACHINES: u32 = 100;
/// Number of throws in the small chart of a machine: usually those of the last weeks.
const SPARK: u32 = 40;
/// Bound of the page number, far above the last page of the largest fleet.
const PAGES: u32 = 10_000;
/// Longest search text \[characters\]: a site, a slash and a machine.
const SEARCH: usize = 129;
/// Largest number of names in a sentence; further ones are only counted.
const NAMED: usize = 20;

#[derive(Template)]
#[template(path = "fleet.html", config = "src/web/askama.toml")]
struct Page {
    trouble: Vec<String>,
    /// Each state with its number of machines and the address of their list.
    tally: Vec<(Badge, String, String)>,
    /// "12 machines".
    machines: String,
    /// Active critical alarms, shown above the entries of `common`.
    urgent: Vec<AlarmLine>,
    common: Vec<Common>,
    /// The other alarms.
    alarms: Vec<AlarmLine>,
    /// "12 more alarms", which are not on this page; empty without any.
    more_alarms: String,
    search: String,
    sites: Vec<(String, bool)>,
    causes: Vec<(&'static str, String, bool)>,
    states: Vec<(&'static str, String, bool)>,
    rows: Vec<Row>,
    /// "1 to 100 of 2,345".
    shown: String,
    before: Option<String>,
    after: Option<String>,
    /// Names of configured machines without a throw, or without one since they were retired.
    silent: String,
    /// Names of machines whose loggers are connected and have sent no throw.
    without_throw: String,
    daemon: Vec<(&'static str, String)>,
    volatile: String,
}

/// An entry for all similar alarms about machines not monitored or lost data.
struct Common {
    badge: Badge,
    summary: String,
    /// Text of one of the alarms; empty for machines not monitored.
    example: String,
    sites: String,
    address: String,
}

/// A machine in the table.
struct Row {
    machine: MachineId,
    badge: Badge,
    /// Cause, size and forecast of the worst present drift.
    drift: Option<(String, String, String)>,
    /// Other drifts and alarms, maintenance, progress of the baseline, rejection of the last throw.
    notes: Vec<String>,
    /// Points of the small chart.
    spark: String,
    last_throw: String,
}

/// The filters and the page of the list, from the parameters of its address.
pub(super) fn filters(query: Option<&str>) -> Result<FleetQuery, Failure> {
    let mut filters = FleetQuery { limit: MACHINES, spark: SPARK, ..FleetQuery::default() };
    for (name, value) in form_urlencoded::parse(query.unwrap_or_default().as_bytes()) {
        let value = value.trim();
        match &*name {
            "page" => {
                let page: Option<u32> = value.parse().ok().filter(|page| *page < PAGES);
                filters.offset = MACHINES * page.ok_or_else(wrong)?;
            }
            "site" | "state" | "cause" | "q" if value.is_empty() => {}
            "site" => filters.site = Some(value.parse().map_err(|_| wrong())?),
            "state" => filters.state = Some(one_of("state", value.parse().ok(), MachineState::VARIANTS)?),
            "cause" => filters.cause = Some(one_of("cause", Cause::named(value), Cause::VARIANTS)?),
            "q" => filters.search = Some(value.chars().take(SEARCH).collect()),
            _ => return Err(wrong()),
        }
    }
    Ok(filters)
}

/// The number of the page, from 0.
pub(super) fn page_number(filters: &FleetQuery) -> u32 {
    filters.offset / MACHINES
}

/// The address of a page of the list with these filters.
fn address(filters: &FleetQuery, page: u32) -> String {
    let mut fields = form_urlencoded::Serializer::new(String::new());
    let page = (page > 0).then(|| page.to_string());
    for (name, value) in [
        ("site", filters.site.as_ref().map(Name::as_str)),
        ("state", filters.state.map(MachineState::as_str)),
        ("cause", filters.cause.map(Cause::as_str)),
        ("q", filters.search.as_deref()),
        ("page", page.as_deref()),
    ] {
        fields.extend_pairs(value.map(|value| (name, value)));
    }
    let query = fields.finish();
    if query.is_empty() { "/".to_owned() } else { format!("/?{query}") }
}

/// The address of the machines in a state, with the other filters.
fn address_of_state(filters: &FleetQuery, state: MachineState) -> String {
    address(&FleetQuery { state: Some(state), ..filters.clone() }, 0)
}

/// The `parsed` value of a filter, or the error with the words of `all` values.
fn one_of<T: Copy + Into<&'static str>>(filter: &str, parsed: Option<T>, all: &[T]) -> Result<T, Failure> {
    let words = || all.iter().map(|word| (*word).into()).collect::<Vec<&str>>().join(", ");
    parsed.ok_or_else(|| Failure::bad_request(format!("The filter {filter} must be one of {}.", words())))
}

fn wrong() -> Failure {
    Failure::bad_request("The address may only have the filters site, state, cause and q, and a page from 0.")
}

pub(super) async fn page(State(web): State<Arc<Web>>, RawQuery(query): RawQuery) -> Result<Response, Failure> {
    let query = filters(query.as_deref())?;
    let overview = web.overview().await?;
    let config = web.view.config();
    let itself = config.monitor.as_machine();
    let report = web.view.report();
    let _permit = web.read_permit().await?;
    let reader = web.reader();
    let is_filtered = query.site.is_some() || query.cause.is_some() || query.search.is_some();
    let tally = if is_filtered { reader.tally(&query, &itself).await? } else { overview.tally.clone() };
    let rows = reader.fleet(&query, &itself).await?;
    let windows = reader.windows(None).await?;
    let matching = query.state.map_or_else(|| tally.total(), |state| tally.of(state));
    let (first, last) = (u64::from(query.offset), u64::from(query.offset) + rows.len() as u64);
    // The faults are sorted, the worst first.
    let is_urgent = |Fault { alarm, .. }: &Fault| alarm.severity == Severity::Critical && alarm.state.is_active();
    let faults = &overview.faults.alarms;
    let urgent = faults.partition_point(is_urgent);
    let more_alarms = overview.faults.total.saturating_sub(faults.len() as u64);
    let page_no = page_number(&query);
    Ok(page::html(&Page {
        trouble: trouble::all(&web.view, &overview),
        tally: tally_links(&tally, &query),
        machines: counted(page::count(tally.total()), "machine"),
        urgent: AlarmLine::all(&faults[..urgent], &windows),
        common: common(&overview.common),
        alarms: AlarmLine::all(&faults[urgent..], &windows),
        more_alarms: if more_alarms > 0 { counted(page::count(more_alarms), "more alarm") } else { String::new() },
        sites: overview
            .sites
            .iter()
            .map(|site| (site.clone(), query.site.as_ref().is_some_and(|of| of.as_str() == site)))
            .collect(),
        causes: Cause::VARIANTS.iter().map(|it| (it.as_str(), it.to_string(), query.cause == Some(*it))).collect(),
        states: WORST_FIRST.iter().map(|it| (it.as_str(), Badge(*it).word(), query.state == Some(*it))).collect(),
        rows: rows.iter().map(|row| table_row(row, &windows, &config.diagnosis)).collect(),
        shown: match rows.len() {
            0 if query.offset > 0 => "This page is beyond the last one.".to_owned(),
            0 if overview.tally.total() == 0 => "No machine has sent a throw yet, or all are retired.".to_owned(),
            0 => "No machine matches these filters.".to_owned(),
            _ => format!("{} to {} of {}", page::count(first + 1), page::count(last), page::count(matching)),
        },
        before: page_no.checked_sub(1).map(|before| address(&query, before)),
        after: (last < matching).then(|| address(&query, page_no + 1)),
        silent: silent(&web.view, reader).await?,
        without_throw: report.without_throw.join(", "),
        daemon: daemon(&report, &overview),
        volatile: format!("As of {}; running for {}.", utc(&clock::now()), page::duration(report.uptime_s)),
        search: query.search.unwrap_or_default(),
    }))
}

fn tally_links(tally: &StateCounts, filters: &FleetQuery) -> Vec<(Badge, String, String)> {
    // A lost link makes a machine with a fault not monitored too. Its fault must stay in sight.
    let with_other_alarms = tally.of(MachineState::NotMonitored).saturating_sub(tally.silent);
    let number = |state| match state {
        MachineState::NotMonitored if with_other_alarms > 0 => {
            format!("{} ({} with other alarms)", page::count(tally.of(state)), page::count(with_other_alarms))
        }
        _ => page::count(tally.of(state)),
    };
    let link = |state: MachineState| (Badge(state), number(state), address_of_state(filters, state));
    WORST_FIRST.into_iter().filter(|state| tally.of(*state) > 0).map(link).collect()
}

/// Groups the alarms about machines not monitored and lost data into entries, those about lost data by their kind.
fn common(alarms: &[CommonAlarm]) -> Vec<Common> {
    let mut kinds: BTreeMap<(&str, Cause, Option<String>), Vec<&CommonAlarm>> = BTreeMap::new();
    for alarm in alarms {
        let kind = alarm.text.as_deref().map(wire::kind_of);
        let state = if alarm.state == AlarmState::ActiveUnacknowledged { "" } else { alarm.state.words() };
        kinds.entry((state, alarm.cause, kind)).or_default().push(alarm);
    }
    let entry = |((state, cause, _), alarms): ((&str, Cause, _), Vec<&CommonAlarm>)| {
        let mut sites: BTreeMap<&str, (u64, &str)> = BTreeMap::new();
        for alarm in &alarms {
            sites.entry(&alarm.site).or_insert((0, &alarm.machine)).0 += alarm.count;
        }
        let count: u64 = sites.values().map(|(count, _)| count).sum();
        let (first, last) = (alarms.iter().map(|alarm| alarm.first).min(), alarms.iter().map(|alarm| alarm.last).max());
        let times = first.zip(last).map(|(first, last)| {
            let (first_time, last_time) = (utc(&first), utc(&last));
            if first == last {
                format!("since {first_time}")
            } else {
                format!("raised from {first_time} to {last_time}")
            }
        });
        let machines = if count == 1 { "machine" } else { "machines" };
        let example = alarms.iter().find_map(|alarm| Some((alarm, wire::without_subject(alarm.text.as_deref()?))));
        let (what, example) = match example {
            None => ("not monitored", String::new()),
            Some((_, text)) if count == 1 => ("with data loss", format!(": {text}")),
            // The numbers in the text are those of one machine, so it is named.
            Some((CommonAlarm { site, machine, .. }, text)) => {
                ("with data loss", format!(", for example {site}/{machine}: {text}"))
            }
        };
        let state = if state.is_empty() { String::new() } else { format!(" ({state})") };
        let at_site = |(site, (count, machine)): (&str, (u64, &str))| match count {
            1 => format!("{site}/{machine}"),
            count => format!("{site} {}", page::count(count)),
        };
        let mut sites: Vec<_> = sites.into_iter().collect();
        sites.sort_by_key(|(_, (count, _))| Reverse(*count));
        Common {
            badge: Badge(if cause == Cause::NotMonitored { MachineState::NotMonitored } else { MachineState::Warning }),
            summary: format!("{} {machines} {what}{state}, {}", page::count(count), times.unwrap_or_default()),
            example,
            sites: named(sites.into_iter().map(at_site).collect()),
            address: address(&FleetQuery { cause: Some(cause), ..FleetQuery::default() }, 0),
        }
    };
    kinds.into_iter().map(entry).collect()
}

fn table_row(row: &FleetRow, windows: &[Window], settings: &Settings) -> Row {
    let drift = row.drifts.first().map(|drift| {
        let forecast = state::forecast(drift).unwrap_or_default();
        (drift.cause.to_string(), state::size(drift.change_pct, drift.change_pct_sd), forecast)
    });
    let mut notes = Vec::new();
    if row.state == MachineState::Maintenance {
        let window = windows.iter().find(|window| window.machine == row.machine && window.cause.is_none());
        notes.extend(window.map(page::window));
    }
    notes.extend(
        row.drifts
            .iter()
            .skip(1)
            .map(|drift| format!("{} {}", drift.cause, state::size(drift.change_pct, drift.change_pct_sd))),
    );
    let is_shown = |cause: &&Cause| row.drifts.iter().any(|drift| drift.cause == **cause);
    let is_state = |cause: &&Cause| **cause == Cause::NotMonitored && row.state == MachineState::NotMonitored;
    let other = row.causes.iter().filter(|cause| !is_shown(cause) && !is_state(cause));
    let over = |cause: &Cause| if row.causes_over.contains(cause) { " (over)" } else { "" };
    let other: Vec<String> = other.map(|cause| format!("{cause}{}", over(cause))).collect();
    if !other.is_empty() {
        notes.push(other.join(", "));
    }
    if let Some(BaselineProgress { so_far, needed }) = row.baseline.filter(|baseline| !baseline.is_complete()) {
        notes.push(format!("baseline {so_far} of {needed}"));
    }
    if let Some(quality) = row.quality.as_deref().filter(|quality| wire::is_rejection(quality)) {
        notes.push(format!("last throw rejected: {}", quality.replace('_', " ")));
    }
    let cause = row.drifts.first().map_or(Cause::Friction, |drift| drift.cause);
    let limit_pct = settings.limit_pct(cause).unwrap_or(settings.friction_limit_pct);
    let (coefficient, sign) = match cause {
        Cause::Kt => (0, 1.0),
        // All coefficients fall when inertia rises.
        Cause::Inertia => (0, -1.0),
        Cause::Stiffness => (2, 1.0),
        _ => (1, 1.0),
    };
    Row {
        badge: Badge(row.state),
        drift,
        notes,
        spark: spark(row.spark.iter().map(|change| sign * change[coefficient]), limit_pct),
        last_throw: row.started_at.as_ref().map(utc).unwrap_or_default(),
        machine: row.machine.clone(),
    }
}

/// Points of the small chart of the newest changes \[%\]. Its scale includes the warning limit on both sides, so that
/// mere scatter looks small.
fn spark(changes: impl Iterator<Item = f64> + Clone, limit_pct: f64) -> String {
    let count = changes.clone().count();
    if count < 2 {
        return String::new();
    }
    let reach = changes.clone().fold(limit_pct, |reach, change| reach.max(change.abs()));
    let mut points = String::new();
    for (at, change) in changes.enumerate() {
        let (x, y) = (100.0 * at as f64 / (count - 1) as f64, 12.0 - 11.0 * change / reach);
        let _ = write!(points, "{x:.0},{y:.1} ");
    }
    points
}

fn daemon(report: &StatusReport, overview: &Overview) -> Vec<(&'static str, String)> {
    let statistics = &overview.statistics;
    let space = statistics.free_disk_bytes.map(|free| format!(", {} free", HumanBytes(free))).unwrap_or_default();
    vec![
        ("version", report.version.clone()),
        ("loggers", page::count(report.loggers as u64)),
        ("link", if report.connected { "connected" } else { "not connected" }.to_owned()),
        ("disk", format!("{}{space}", report.disk.as_ref())),
        ("database", HumanBytes(statistics.data_bytes).to_string()),
        ("throws kept", page::count(statistics.throws)),
        ("pending", page::count(statistics.pending)),
        ("to publish", page::count(statistics.outbox)),
        ("in gaps", page::count(statistics.missing_throws)),
        ("quarantined", page::count(statistics.quarantined)),
    ]
}

/// Names of configured machines without a throw, or without one since they were retired.
async fn silent(view: &View, reader: &Reader) -> Result<String, Failure> {
    let config = view.config();
    let configured: Vec<&MachineId> = config.machines.named().collect();
    if configured.is_empty() {
        return Ok(String::new());
    }
    let known: HashSet<MachineId> = reader.machines().await?.into_iter().collect();
    let mut names: Vec<String> =
        configured.into_iter().filter(|machine| !known.contains(machine)).map(ToString::to_string).collect();
    names.sort();
    Ok(named(names))
}

/// The first names, and the number of the others.
fn named(mut names: Vec<String>) -> String {
    let more = names.len().saturating_sub(NAMED);
    names.truncate(NAMED);
    let list = names.join(", ");
    if more > 0 { format!("{list} and {} more", page::count(more as u64)) } else { list }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters_come_from_the_address_and_go_back_into_it() {
        let some = filters(Some("site=north&state=not_monitored&q=21%2F&page=2")).unwrap();
        assert_eq!((some.offset, page_number(&some)), (2 * MACHINES, 2));
        assert_eq!(address(&some, 2), "/?site=north&state=not_monitored&q=21%2F&page=2");
        assert_eq!(address_of_state(&some, MachineState::Critical), "/?site=north&state=critical&q=21%2F");
        assert_eq!(address(&filters(None).unwrap(), 0), "/");
        for wrong in ["state=good", "cause=magnet", "site=a%20b", "page=-1", "page=99999", "x=1"] {
            assert!(filters(Some(wrong)).is_err(), "{wrong}");
        }
    }

    #[test]
    fn each_kind_of_data_loss_is_an_entry_with_its_text() {
        let alarm = |cause: Cause, machine: &str, count: u64, text: Option<&str>| CommonAlarm {
            cause,
            site: "north".to_owned(),
            machine: machine.to_owned(),
            count,
            first: jiff::Timestamp::UNIX_EPOCH,
            last: jiff::Timestamp::UNIX_EPOCH,
            text: text.map(str::to_owned),
            state: match machine {
                "e" => AlarmState::ClearedUnacknowledged,
                "f" => AlarmState::Shelved,
                _ => AlarmState::ActiveUnacknowledged,
            },
        };
        let alarms = [
            alarm(Cause::NotMonitored, "a", 12, None),
            alarm(Cause::DataLoss, "b", 1, Some("Machine b: 2 throws never arrived.")),
            alarm(Cause::DataLoss, "c", 1, Some("Machine c: 9 throws never arrived.")),
            alarm(Cause::DataLoss, "e", 1, Some("Machine e: 7 throws never arrived.")),
            alarm(Cause::NotMonitored, "f", 2, None),
            alarm(Cause::DataLoss, "d", 1, Some("Machine d: the clock of the logger is wrong.")),
        ];
        let shown: Vec<_> = common(&alarms).into_iter().map(|it| [it.summary, it.example, it.sites]).collect();
        let since = "since 1970-01-01 00:00:00 UTC";
        let expected = [
            ("12 machines not monitored", "", "north 12"),
            ("2 machines with data loss", ", for example north/b: 2 throws never arrived.", "north 2"),
            ("1 machine with data loss", ": the clock of the logger is wrong.", "north/d"),
            ("1 machine with data loss (over, not acknowledged)", ": 7 throws never arrived.", "north/e"),
            ("2 machines not monitored (shelved)", "", "north 2"),
        ];
        let expected =
            expected.map(|(summary, example, sites)| [format!("{summary}, {since}"), example.into(), sites.into()]);
        assert_eq!(shown, expected);
    }

    #[test]
    fn an_alarm_that_is_over_is_noted_as_such_and_the_small_chart_has_the_limit_of_the_part_that_drifts() {
        let row = FleetRow {
            machine: MachineId::new("north", "21B").unwrap(),
            state: MachineState::Healthy,
            drifts: serde_json::from_str(r#"[{"cause": "kt", "change_pct": -5.0, "change_pct_sd": 0.5}]"#).unwrap(),
            causes: vec![Cause::NotMonitored, Cause::DataLoss],
            causes_over: vec![Cause::NotMonitored],
            started_at: None,
            quality: None,
            baseline: None,
            spark: vec![[0.0; 3], [-5.0, 9.0, 9.0]],
        };
        let shown = table_row(&row, &[], &Settings { kt_limit_pct: 5.0, ..Settings::default() });
        assert_eq!(shown.notes, ["not monitored (over), data loss"]);
        assert_eq!(shown.spark, "0,12.0 100,23.0 ");
    }

    #[test]
    fn a_small_picture_shows_scatter_small_and_a_drift_large() {
        assert_eq!(spark([0.0, 15.0].into_iter(), 15.0), "0,12.0 100,1.0 ");
        assert_eq!(spark([0.0, -30.0].into_iter(), 15.0), "0,12.0 100,23.0 ");
        assert_eq!(spark([1.0].into_iter(), 15.0), "");
    }
}
