//! `pointsd status`: the daemons, their machines and their alarms.

use std::{
    collections::{BTreeMap, BTreeSet, HashSet},
    io::{self, IsTerminal as _},
    time::Duration,
};

use comfy_table::ColumnConstraint;
use jiff::SignedDuration;
use serde::Deserialize as _;
use serde_json::{Value, json};

use super::{
    Exit, Failure, Outcome, alarms, argument,
    operator::{self, Client, Connection},
    output,
    runtime::Signals,
    terminal,
};
use crate::{
    bus::{self, OperatorError},
    daemon::{StatusReport, clock},
    diagnose::{Cause, MachineState},
    store::{WORST_FIRST, Window},
    throw::{Direction, MachineId, Name, counted},
    wire::{self, Alarm, EVERY_MONITOR_STATUS, Health, Kind, Scope},
};

/// Largest fleet of which every machine is listed by default: one screen.
const MAX_LISTED: usize = 40;
/// Largest number of machines for which the daemons that serve them are named; each needs a query.
const MAX_ASKED: usize = 10;
/// Least width of a column in the wrapped table of machines \[characters\]; "not monitored" then needs two lines.
const LEAST_WIDTH: usize = 10;
/// Time between two updates with `--watch`.
const WATCH_INTERVAL: Duration = Duration::from_secs(5);

/// Shows all running daemons, the state of each machine with its last throws, and the open alarms. In a large fleet
/// healthy and learning machines are listed only with --all, --site or --state.
///
/// Exit codes: 0 no problem; 1 a daemon has a problem (the lines in capitals below its name), a machine or all machines
/// of a site have an alarm, a machine is not monitored, in maintenance or served by several daemons, or an alarm is
/// shelved; 64 an option is wrong; 69 no daemon answers, or no machine of --site is known; 78 the file of --config is
/// invalid.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  pointsd status\n  pointsd status --watch\n  \
                        pointsd status --connect tcp/cabinet-7:7447 --json")]
pub(super) struct Arguments {
    #[command(flatten)]
    connection: Connection,
    /// List only machines of this site.
    #[arg(long)]
    site: Option<Name>,
    /// List only machines in this state, and their alarms: learning, healthy, warning, critical, `not_monitored` or
    /// maintenance.
    #[arg(long, value_parser = argument::machine_state)]
    state: Option<MachineState>,
    /// List every machine.
    #[arg(long)]
    all: bool,
    /// Repeat every five seconds until Ctrl-C.
    #[arg(long, conflicts_with = "json")]
    watch: bool,
    /// Print one JSON object with daemons, health and alarms.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    arguments.connection.with(async |client| {
        let mut signals = Signals::listen()?;
        loop {
            if arguments.watch && io::stdout().is_terminal() {
                output::clear()?;
            }
            let fleet = gather(client, arguments.site.as_ref()).await;
            if !arguments.watch {
                return fleet.and_then(|fleet| output::after(fleet.print(arguments), fleet.verdict()));
            }
            match fleet.and_then(|fleet| fleet.print(arguments)) {
                Err(Failure::ClosedPipe) => return Err(Failure::ClosedPipe),
                // Not the end: a daemon may be restarting, for example.
                Err(Failure::Error { error, .. }) => terminal::complain(format_args!("{error:#}")),
                Ok(()) => {}
            }
            tokio::select! {
                () = tokio::time::sleep(WATCH_INTERVAL) => {}
                () = signals.stop() => return Ok(Exit::Ok),
            }
        }
    })
}

/// The answers of all daemons.
struct Fleet {
    daemons: bus::Answers,
    of_machines: bus::Answers,
    events: bus::Answers,
    /// The readable reports of `daemons`, with their keys.
    reports: Vec<(String, StatusReport)>,
    /// The readable messages of `of_machines`.
    health: Vec<Health>,
    /// The readable messages of `events`.
    alarms: Vec<Alarm>,
    /// Running daemons that did not answer.
    silent: Vec<MachineId>,
    /// Sentences about machines that several daemons serve.
    twice: Vec<String>,
    /// Number of daemons without an answer, and of unreadable messages.
    problems: usize,
}

/// Queries all daemons, of which one must know a machine of `site`. Problems of single daemons are printed on stderr.
async fn gather(client: &Client, site: Option<&Name>) -> Result<Fleet, Failure> {
    let session = &client.session;
    let present = bus::monitors(session).await?;
    let daemons = client.ask(EVERY_MONITOR_STATUS).await?;
    let of_machines = client.ask(&Scope::default().key_expression(Kind::Health)).await?;
    let events = client.ask(&Scope::default().key_expression(Kind::Alarm)).await?;
    if daemons.is_empty() {
        return Err(OperatorError::NoDaemon.into());
    }
    let (reports, daemon_problems) = operator::read::<StatusReport>(&daemons);
    let reports: Vec<_> = reports.into_iter().map(|((key, _), report)| (key.clone(), report)).collect();
    let (health, health_problems) = operator::values::<Health>(&of_machines);
    let (alarms, alarm_problems) = operator::values::<Alarm>(&events);
    let mut twice = served_twice(session, &health, &reports).await;
    if twice.is_empty() {
        twice = overlaps(&reports);
    }
    let silent: Vec<MachineId> = operator::silent(&present, &daemons).into_iter().cloned().collect();
    let problems = daemon_problems + health_problems + alarm_problems + silent.len();
    let fleet = Fleet { daemons, of_machines, events, reports, health, alarms, silent, twice, problems };
    if let Some(site) = site.filter(|site| !fleet.has_site(site)) {
        let problem = unknown_site(site, &operator::answered(&fleet.daemons), &fleet.silent, &fleet.alarms);
        return Err(Failure::new(Exit::Unavailable, anyhow::anyhow!(problem)));
    }
    Ok(fleet)
}

impl Fleet {
    /// The exit code: whether the daemons and their machines are well.
    fn verdict(&self) -> Exit {
        // The health messages count too: a daemon updates the counts in its report only every few seconds.
        let is_well = |report: &StatusReport| report.problems().is_empty() && report.fleet_counts.is_well();
        let are_well = self.problems + self.twice.len() == 0
            && self.reports.iter().all(|(_, report)| is_well(report))
            && !self.alarms.iter().any(|alarm| alarm.state.is_active())
            && self.health.iter().all(|health| health.state.is_none_or(MachineState::is_well));
        if are_well { Exit::Ok } else { Exit::Negative }
    }

    /// Whether a machine of the site has health, an alarm or an open window.
    fn has_site(&self, site: &Name) -> bool {
        let of_health = self.health.iter().map(|health| &health.machine);
        let of_alarms = self.alarms.iter().map(|alarm| &alarm.machine);
        of_health.chain(of_alarms).chain(self.windows().map(|window| &window.machine)).any(|id| id.site == *site)
    }

    fn windows(&self) -> impl Iterator<Item = &Window> {
        self.reports.iter().flat_map(|(_, report)| &report.windows)
    }

    fn print(&self, arguments: &Arguments) -> Result<(), Failure> {
        let mut machines: BTreeMap<&MachineId, Vec<&Health>> = BTreeMap::new();
        for row in &self.health {
            machines.entry(&row.machine).or_default().push(row);
        }
        let is_filtered = arguments.state.is_some() || arguments.site.is_some();
        let is_of_site = |machine: &MachineId| arguments.site.as_ref().is_none_or(|site| machine.site == *site);
        let is_selected = |machine: &MachineId| {
            let is_in = |state| machines.get(machine).is_some_and(|rows| state_of(rows) == state);
            is_of_site(machine) && arguments.state.is_none_or(is_in)
        };
        if arguments.json {
            let is_kept =
                |value: &Value| MachineId::deserialize(value).map_or(!is_filtered, |machine| is_selected(&machine));
            let selected = |answers: &bus::Answers| values(answers).into_iter().filter(is_kept).collect::<Vec<_>>();
            let [health, alarms] = [&self.of_machines, &self.events].map(selected);
            return output::line(json!({"daemons": values(&self.daemons), "health": health, "alarms": alarms}));
        }
        let windows: Vec<Window> = self.windows().filter(|window| is_selected(&window.machine)).cloned().collect();
        let alarms: Vec<Alarm> = self.alarms.iter().filter(|alarm| is_selected(&alarm.machine)).cloned().collect();
        let of_site: BTreeMap<_, _> =
            machines.iter().filter(|(machine, _)| is_of_site(machine)).map(|(id, rows)| (*id, rows.clone())).collect();
        self.reports.iter().try_for_each(|(key, report)| print_daemon(key, report))?;
        let caveats = print_machines(&of_site, &windows, arguments)?;
        self.twice.iter().try_for_each(output::line)?;
        let none = if is_filtered { "no alarms of these machines" } else { "no alarms" };
        alarms::print_open(&alarms, &operator::answered(&self.daemons), &self.health, &windows, false, none)?;
        caveats.iter().try_for_each(output::line)
    }
}

/// The readable values as the daemons sent them, with fields that only a newer version knows.
fn values(answers: &bus::Answers) -> Vec<Value> {
    answers.messages.iter().filter_map(|(_, payload)| serde_json::from_slice(payload).ok()).collect()
}

/// The error if the daemons that answered (`monitors`) know no machine of a site. It also says which other daemons may
/// serve the site: those that did not answer, and those that a daemon cannot reach, by its alarm.
fn unknown_site(site: &Name, monitors: &[MachineId], silent: &[MachineId], alarms: &[Alarm]) -> String {
    let names: Vec<String> = monitors.iter().map(ToString::to_string).collect();
    let mut sentences = vec![match names.join(", ").as_str() {
        "" => format!("no daemon answered, so no machine of site {site} is known"),
        names => format!("no machine of site {site} is known to {names}; without --site all are listed"),
    }];
    sentences.extend(silent.iter().map(|daemon| format!("The daemon {daemon} may serve it and does not answer")));
    let misses_daemons = |alarm: &&Alarm| {
        monitors.contains(&alarm.machine) && alarm.cause == Cause::NotMonitored && alarm.state.is_active()
    };
    sentences.extend(alarms.iter().filter(misses_daemons).map(|alarm| alarm.text.clone()));
    sentences.join(". ")
}

/// A sentence about each machine that several daemons serve: all of them publish its alarms, and commands for it fail.
async fn served_twice(session: &zenoh::Session, health: &[Health], reports: &[(String, StatusReport)]) -> Vec<String> {
    let mut seen = HashSet::new();
    let again = health.iter().filter(|row| !seen.insert((&row.machine, row.direction)));
    let mut twice: BTreeSet<&MachineId> = again.map(|row| &row.machine).collect();
    // Another daemon may have served the machine before, and still have its last health. A daemon of an earlier version
    // reports no key.
    let serves = |report: &StatusReport, machine: &MachineId| {
        report.key.is_empty() || bus::intersect(&report.key, &wire::machine_key(machine, Kind::Throw))
    };
    twice.retain(|machine| reports.iter().filter(|(_, report)| serves(report, machine)).count() > 1);
    let mut sentences = Vec::new();
    for machine in twice.iter().take(MAX_ASKED) {
        // The error of another daemon does not matter.
        let (daemons, _) = bus::targets(session, machine).await;
        if daemons.len() < 2 {
            continue;
        }
        let daemons: Vec<String> = daemons.into_iter().map(|daemon| daemon.monitor).collect();
        let names: BTreeSet<&String> = daemons.iter().collect();
        let advice = if names.len() == daemons.len() {
            "correct subscribe.key of all but one"
        } else {
            "stop all daemons of one name but one, or correct their monitor.id and subscribe.key"
        };
        sentences.push(format!("{machine} is served by {}: {advice}", daemons.join(" and ")));
    }
    if twice.len() > MAX_ASKED {
        sentences.push(format!("served by several daemons too: {}", counted(twice.len() - MAX_ASKED, "more machine")));
    }
    sentences
}

/// A sentence about each two daemons that would serve the same machines.
fn overlaps(reports: &[(String, StatusReport)]) -> Vec<String> {
    let pairs =
        reports.iter().enumerate().flat_map(|(at, one)| reports[at + 1..].iter().map(move |other| (one, other)));
    let overlapping = pairs.filter(|((_, one), (_, other))| bus::intersect(&one.key, &other.key));
    let sentence = |(one, other): (&(String, StatusReport), &(String, StatusReport))| {
        let [one, other] =
            [one, other].map(|(key, report)| format!("{} ({})", operator::monitor_name(key), report.key));
        format!("{one} and {other} serve the same machines: correct monitor.id and subscribe.key of one, or stop it")
    };
    overlapping.take(MAX_ASKED).map(sentence).collect()
}

fn print_daemon(key: &str, report: &StatusReport) -> Result<(), Failure> {
    let name = operator::monitor_name(key);
    let StatusReport { version, uptime_s, database, .. } = report;
    output::line(format_args!("{name}: version {version}, up {uptime_s} s, database {database}"))?;
    // Each part on its own line: all parts together are wider than a terminal.
    report.parts().into_iter().try_for_each(|part| output::line(format_args!("  {part}")))
}

/// Prints the table of the machines, and a list of those in maintenance. Returns the caveats of the machines in the
/// table.
fn print_machines(
    machines: &BTreeMap<&MachineId, Vec<&Health>>,
    windows: &[Window],
    arguments: &Arguments,
) -> Result<Vec<String>, Failure> {
    let count = |of| machines.values().filter(|rows| state_of(rows) == of).count();
    let tally = WORST_FIRST.map(|of| (count(of), of.as_str().replace('_', " ")));
    let tally: Vec<String> =
        tally.iter().filter(|(count, _)| *count > 0).map(|(count, state)| format!("{count} {state}")).collect();
    let tally = if tally.is_empty() { String::new() } else { format!(": {}", tally.join(", ")) };
    output::line(format_args!("{}{tally}", counted(machines.len() as u64, "machine")))?;
    let is_asked = |rows: &[&Health]| arguments.state.is_none_or(|wanted| wanted == state_of(rows));
    let is_short =
        arguments.all || arguments.state.is_some() || arguments.site.is_some() || machines.len() <= MAX_LISTED;
    let mut shown: Vec<_> =
        machines.iter().filter(|(_, rows)| is_asked(rows) && (is_short || !state_of(rows).is_well())).collect();
    shown.sort_by_key(|(machine, rows)| (rank(state_of(rows)), **machine));
    let mut table = output::plain_table(["machine", "state", "to", "motor", "friction", "stiffness", "last throw"]);
    // A name is never wrapped, and in a pipe no cell is wrapped, as programs search the output.
    if let Some(name) = table.column_mut(0) {
        name.set_constraint(ColumnConstraint::ContentWidth);
    }
    for (machine, rows) in &shown {
        for row in *rows {
            let of_ratio = [None, row.a1_per_b0_pct, row.a0_per_b0_pct];
            let change = |of: usize| match (row.change_pct, of_ratio[of]) {
                (Some(pct), _) => format!("{} %", output::signed(pct[of])),
                (None, Some(pct)) => format!("{} % per motor", output::signed(pct)),
                (None, None) => String::new(),
            };
            let rejected = if row.is_rejected() { ", rejected" } else { "" };
            table.add_row([
                machine.to_string(),
                state_of(rows).as_str().replace('_', " "),
                target(row.direction).to_owned(),
                change(0),
                change(1),
                change(2),
                format!("{}{rejected}", age(clock::now().duration_since(row.started_at))),
            ]);
        }
    }
    if !shown.is_empty() {
        output::line(output::fitted(table, LEAST_WIDTH))?;
    }
    for window in windows.iter().filter(|window| window.cause.is_none()) {
        output::line(format_args!("{} is in maintenance {}", window.machine, window.sentence()))?;
    }
    Ok(caveats(shown.iter().flat_map(|(_, rows)| rows.iter().copied())))
}

/// A sentence for each different caveat, with its direction, if it has one, and with the names of all its machines.
fn caveats<'a>(rows: impl Iterator<Item = &'a Health>) -> Vec<String> {
    let mut machines: BTreeMap<(&str, &str), BTreeSet<&MachineId>> = BTreeMap::new();
    for row in rows {
        for caveat in &row.caveats {
            let text = wire::without_subject(caveat);
            let subject = caveat.strip_suffix(text).unwrap_or_default();
            let direction = subject.find(", ").map_or(": ", |at| &subject[at..]);
            machines.entry((text, direction)).or_default().insert(&row.machine);
        }
    }
    let line = |((text, direction), machines): ((&str, &str), BTreeSet<&MachineId>)| {
        let noun = if machines.len() == 1 { "Machine" } else { "Machines" };
        let names: Vec<String> = machines.into_iter().map(ToString::to_string).collect();
        format!("{noun} {}{direction}{text}", names.join(", "))
    };
    machines.into_iter().map(line).collect()
}

/// The worst state in the rows of a machine, which are its directions, or the reports of several daemons.
fn state_of(rows: &[&Health]) -> MachineState {
    rows.iter().filter_map(|row| row.state).min_by_key(|state| rank(*state)).unwrap_or_default()
}

/// Sort order of the states, the worst first.
fn rank(state: MachineState) -> Option<usize> {
    WORST_FIRST.iter().position(|other| *other == state)
}

/// The position to which a throw moves the points.
fn target(direction: Option<Direction>) -> &'static str {
    match direction {
        Some(Direction::NormalToReverse) => "reverse",
        Some(Direction::ReverseToNormal) => "normal",
        None => "",
    }
}

/// An age in one unit: "12 s ago", "5 min ago", "3 h ago" or "4 d ago"; "3 h ahead" if the clock of the logger is
/// ahead.
fn age(age: SignedDuration) -> String {
    let length = match age.as_secs().unsigned_abs() {
        seconds @ ..120 => format!("{seconds} s"),
        seconds @ ..7_200 => format!("{} min", seconds / 60),
        seconds @ ..172_800 => format!("{} h", seconds / 3_600),
        seconds => format!("{} d", seconds / 86_400),
    };
    format!("{length} {}", if age.is_negative() { "ahead" } else { "ago" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_equal_caveat_of_several_machines_is_one_line() {
        let row = |machine: &str, caveat: &str| {
            let health = json!({"schema": Health::SCHEMA, "site": "north", "machine": machine, "boot_id": "b",
                "throw_no": 1, "started_at": "2026-05-04T10:11:12Z", "direction": "unknown", "quality": "rough",
                "caveats": [format!("Machine {machine}{caveat}")]});
            serde_json::from_value::<Health>(health).unwrap()
        };
        let rows =
            [row("b", ": rough."), row("a", ": rough."), row("a", ": rough."), row("c", ", to reverse: blind: a.")];
        assert_eq!(
            caveats(rows.iter()),
            ["Machine north/c, to reverse: blind: a.", "Machines north/a, north/b: rough."]
        );
    }

    #[test]
    fn the_error_about_an_unknown_site_names_the_daemons_that_may_serve_it() {
        let north = MachineId::new("north", "box").unwrap();
        assert_eq!(
            unknown_site(&"south".parse().unwrap(), &[north], &[MachineId::new("south", "box").unwrap()], &[]),
            "no machine of site south is known to north/box; without --site all are listed. The daemon south/box may \
             serve it and does not answer"
        );
    }

    #[test]
    fn an_age_has_one_unit_and_shows_when_a_clock_is_ahead() {
        let said = [0, 119, 120, 7_200, 172_800, -36_000].map(|seconds| age(SignedDuration::from_secs(seconds)));
        assert_eq!(said, ["0 s ago", "119 s ago", "2 min ago", "2 h ago", "2 d ago", "10 h ahead"]);
    }
}
