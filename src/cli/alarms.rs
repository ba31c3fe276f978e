//! `pointsd alarms`: open alarms, or the history of alarm events.

use std::{cmp::Reverse, collections::BTreeMap};

use anyhow::anyhow;
use jiff::Timestamp;

use super::{
    Exit, Failure, Outcome, ResultExt as _, argument,
    operator::{self, Connection},
    output, terminal,
};
use crate::{
    bus,
    daemon::StatusReport,
    diagnose::{AlarmState, Cause, Severity},
    store::Window,
    throw::{MachineId, utc},
    web,
    wire::{self, Alarm, EVERY_MONITOR_STATUS, Health, Kind, MAX_HISTORY, Scope},
};

/// Least number of similar open alarms about machines not monitored or lost data that are printed as one entry. A cut
/// link can raise hundreds of them.
const GROUP_SIZE: usize = 5;

/// Shows the open alarms of all running daemons, the most severe first; with --since or --limit, the events of all
/// alarms.
///
/// Exit codes: 0 shown; 1 the answer of a daemon is missing or unreadable, or with --check an alarm is open and neither
/// shelved nor in maintenance; 64 an option is wrong; 69 no usable answer, or unknown machine; 78 the file of --config
/// is invalid.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  pointsd alarms\n  pointsd alarms north/21B --since 2026-05-01 --json\n  \
                        pointsd alarms --severity critical --check || mail -s 'points' duty@example.org")]
pub(super) struct Arguments {
    /// Show only this machine.
    #[arg(value_name = "SITE/MACHINE", value_parser = argument::machine)]
    machine: Option<MachineId>,
    /// Show only alarms with this cause.
    #[arg(long, value_parser = argument::cause)]
    cause: Option<Cause>,
    /// Show only alarms of this severity: warning or critical.
    #[arg(long, value_parser = argument::severity)]
    severity: Option<Severity>,
    /// Show events from this time on: a date (its midnight in UTC), or a time as 2026-05-04T06:00:00Z.
    #[arg(long, value_name = "TIME", value_parser = argument::moment)]
    since: Option<Timestamp>,
    /// Show only the newest N events; without it, the newest 10,000 of each daemon.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_HISTORY)))]
    limit: Option<u32>,
    /// Print every alarm; do not combine similar alarms into one entry.
    #[arg(long)]
    all: bool,
    /// Exit with 1 if an alarm is open that is neither shelved nor in maintenance, or if the answer of a daemon is
    /// missing or unreadable.
    #[arg(long, conflicts_with_all = ["since", "limit"])]
    check: bool,
    #[command(flatten)]
    connection: Connection,
    /// Print the messages as JSON, one on each line.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    arguments.connection.with(async |client| {
        let present = bus::monitors(&client.session).await?;
        let answers = client.ask(&selector(arguments)).await?;
        if answers.is_empty() {
            bus::require_monitored(&client.session, arguments.machine.as_ref()).await?;
        }
        let daemons = client.ask(EVERY_MONITOR_STATUS).await?;
        let is_history = arguments.since.is_some() || arguments.limit.is_some();
        let shows_open = !arguments.json && !is_history;
        let health = if shows_open {
            client.ask(&key(arguments.machine.as_ref(), Kind::Health)).await?
        } else {
            bus::Answers::default()
        };
        let (found, problems) = operator::read::<Alarm>(&answers);
        let problems = problems + operator::silent(&present, &daemons).len();
        if is_history && (arguments.limit.is_none() || selects(arguments)) && found.len() >= MAX_HISTORY as usize {
            terminal::complain(format_args!(
                "{} events, and a daemon sends only its newest {MAX_HISTORY}: older ones may be missing; ask for one machine",
                found.len()
            ));
        }
        let mut found: Vec<_> = found.into_iter().filter(|(_, alarm)| is_requested(alarm, arguments)).collect();
        if is_history {
            found.sort_by_key(|(_, alarm)| alarm.event_at);
            let newest = arguments.limit.map_or(usize::MAX, |limit| limit as usize);
            found.drain(..found.len().saturating_sub(newest));
        }
        if found.is_empty() && problems > 0 {
            let exit = if arguments.check { Exit::Negative } else { Exit::Unavailable };
            return Err(anyhow!("no daemon gave a usable answer, which is not the same as no alarms")).or_exit(exit);
        }
        let is_negative =
            problems > 0 || (arguments.check && found.iter().any(|(_, alarm)| !alarm.state.is_silenced()));
        let print = || {
            if arguments.json {
                return found.iter().try_for_each(|((_, payload), _)| output::line(String::from_utf8_lossy(payload)));
            }
            let alarms: Vec<Alarm> = found.into_iter().map(|(_, alarm)| alarm).collect();
            if shows_open {
                let (reports, _) = operator::values::<StatusReport>(&daemons);
                let windows: Vec<Window> = reports.into_iter().flat_map(|report| report.windows).collect();
                let (health, _) = operator::values(&health);
                let none = if selects(arguments) { "no alarms with this cause and severity" } else { "no alarms" };
                print_open(&alarms, &operator::answered(&daemons), &health, &windows, arguments.all, none)?;
            } else {
                print_events(&alarms)?;
            }
            let names = daemons.messages.iter().map(|(key, _)| operator::monitor_name(key));
            output::line(format_args!("answered by {}", names.collect::<Vec<_>>().join(", ")))
        };
        output::after(print(), if is_negative { Exit::Negative } else { Exit::Ok })
    })
}

/// Whether only some causes or severities are requested. A query cannot select them: the daemon then sends all events,
/// up to its own limit, and this command selects and limits.
fn selects(arguments: &Arguments) -> bool {
    arguments.cause.is_some() || arguments.severity.is_some()
}

fn is_requested(alarm: &Alarm, arguments: &Arguments) -> bool {
    arguments.cause.is_none_or(|cause| cause == alarm.cause)
        && arguments.severity.is_none_or(|severity| severity == alarm.severity)
}

/// The key of a machine, or of all machines.
fn key(machine: Option<&MachineId>, kind: Kind) -> String {
    machine.map_or_else(|| Scope::default().key_expression(kind), |machine| wire::machine_key(machine, kind))
}

fn selector(arguments: &Arguments) -> String {
    let key = key(arguments.machine.as_ref(), Kind::Alarm);
    let since = arguments.since.map(|since| format!("since={since}"));
    let limit = arguments.limit.filter(|_| !selects(arguments)).unwrap_or(MAX_HISTORY);
    match (since, arguments.limit) {
        (None, None) => key,
        (Some(since), _) => format!("{key}?{since};limit={limit}"),
        (None, Some(_)) => format!("{key}?limit={limit}"),
    }
}

/// Prints the open alarms. `daemons` are the names of the daemons, to recognise alarms about them; with `all` no alarms
/// are combined; `none` is printed if there is no alarm.
pub(super) fn print_open(
    alarms: &[Alarm],
    daemons: &[MachineId],
    health: &[Health],
    windows: &[Window],
    all: bool,
    none: &str,
) -> Result<(), Failure> {
    if alarms.is_empty() {
        return output::line(none);
    }
    entries(alarms, daemons, all).into_iter().try_for_each(|entry| match entry[..] {
        [alarm] => print_alarm(alarm, health, windows),
        _ => print_group(&entry),
    })
}

/// The entries of the list, each with one alarm or many similar ones. Alarms about a daemon itself come first, then
/// faults of machines, then machines not monitored and lost data. In each of these groups active alarms come first,
/// then the most severe, then the newest. Unless `all` is set, [`GROUP_SIZE`] or more alarms of the last group with
/// equal cause, severity and kind of text are one entry, separately for active and cleared alarms.
fn entries<'a>(alarms: &'a [Alarm], daemons: &[MachineId], all: bool) -> Vec<Vec<&'a Alarm>> {
    let is_daemon = |alarm: &Alarm| daemons.contains(&alarm.machine);
    let common = |alarm: &Alarm| !is_daemon(alarm) && matches!(alarm.cause, Cause::NotMonitored | Cause::DataLoss);
    let rank = |alarm: &Alarm| {
        let place = (!is_daemon(alarm), common(alarm), !alarm.state.is_active());
        (place, Reverse(alarm.severity), Reverse(alarm.raised_at))
    };
    let (grouped, mut entries): (Vec<&Alarm>, Vec<&Alarm>) = alarms.iter().partition(|alarm| !all && common(alarm));
    let mut groups: BTreeMap<_, Vec<&Alarm>> = BTreeMap::new();
    for alarm in grouped {
        let is_over = alarm.state == AlarmState::ClearedUnacknowledged;
        groups.entry((alarm.cause, alarm.severity, is_over, wire::kind_of(&alarm.text))).or_default().push(alarm);
    }
    let (mut groups, few): (Vec<_>, Vec<_>) = groups.into_values().partition(|group| group.len() >= GROUP_SIZE);
    for group in &mut groups {
        group.sort_by_key(|alarm| rank(alarm));
    }
    entries.extend(few.into_iter().flatten());
    groups.extend(entries.into_iter().map(|alarm| vec![alarm]));
    groups.sort_by_key(|entry| entry.first().map(|alarm| rank(alarm)));
    groups
}

fn print_alarm(alarm: &Alarm, health: &[Health], windows: &[Window]) -> Result<(), Failure> {
    let machine = &alarm.machine;
    output::line(format_args!("{:8}  {machine}  {}", alarm.severity.as_str().to_uppercase(), alarm.cause))?;
    let window = Window::of(alarm, windows).map(|window| format!(" {}", window.sentence())).unwrap_or_default();
    let over = if alarm.over && alarm.state.is_silenced() { "over, " } else { "" };
    indented(&format!("raised {}, {over}{}{window}", utc(&alarm.raised_at), alarm.state.words()))?;
    let of_machine = health.iter().filter(|health| health.machine == alarm.machine);
    // A daemon of an earlier version sends only the worst drift.
    let mut drifts = of_machine.flat_map(|health| health.drifts.iter().chain(&health.drift));
    if let Some(drift) = drifts.find(|drift| drift.cause == alarm.cause) {
        let limit = web::forecast(drift).map(|limit| format!("; {limit}")).unwrap_or_default();
        let size = output::size(drift.change_pct, drift.change_pct_sd);
        indented(&format!("now {size} (95 %){limit}"))?;
    }
    // A daemon of an earlier version does not publish the time of the text.
    let reported_at = alarm.text_at.unwrap_or(alarm.event_at);
    indented(&format!("report of {}: {}", utc(&reported_at), alarm.text))
}

/// Prints many alarms of one kind as one entry, the newest first.
fn print_group(alarms: &[&Alarm]) -> Result<(), Failure> {
    let Some(newest) = alarms.first() else { return Ok(()) };
    let mut sites: BTreeMap<&str, usize> = BTreeMap::new();
    for alarm in alarms {
        *sites.entry(alarm.machine.site.as_str()).or_default() += 1;
    }
    let sites: Vec<String> = sites.iter().map(|(site, count)| format!("{site} {count}")).collect();
    let raised = || alarms.iter().map(|alarm| alarm.raised_at);
    let severity = newest.severity.as_str().to_uppercase();
    output::line(format_args!("{severity:8}  {} machines  {}", alarms.len(), newest.cause))?;
    let (first, last) = (raised().min().unwrap_or(newest.raised_at), raised().max().unwrap_or(newest.raised_at));
    let over = if newest.state == AlarmState::ClearedUnacknowledged { ", over and not acknowledged" } else { "" };
    let silenced = alarms.iter().filter(|alarm| alarm.state.is_silenced()).count();
    let silenced = if silenced > 0 { format!("; {silenced} shelved or in maintenance") } else { String::new() };
    let (first, last) = (utc(&first), utc(&last));
    let last = if last == first { String::new() } else { format!(" to {last}") };
    indented(&format!("raised {first}{last}{over}; by site: {}{silenced}", sites.join(", ")))?;
    indented(&format!("for example: {}", newest.text))?;
    indented("pointsd alarms --all lists all of them")
}

/// Prints the events, oldest first.
fn print_events(alarms: &[Alarm]) -> Result<(), Failure> {
    if alarms.is_empty() {
        return output::line("no alarm events");
    }
    for alarm in alarms {
        output::line(format_args!(
            "{}  {}  {}, {}: {}",
            utc(&alarm.event_at),
            alarm.machine,
            alarm.cause,
            alarm.severity.as_str(),
            alarm.state.words()
        ))?;
        indented(&alarm.text)?;
    }
    Ok(())
}

/// Prints an indented text, wrapped to the width of the terminal.
fn indented(text: &str) -> Result<(), Failure> {
    let width = usize::from(output::width());
    let mut line = String::new();
    for word in text.split_whitespace() {
        if !line.is_empty() && line.chars().count() + word.chars().count() + 3 > width {
            output::line(format_args!("  {line}"))?;
            line.clear();
        }
        if !line.is_empty() {
            line.push(' ');
        }
        line.push_str(word);
    }
    output::line(format_args!("  {line}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{diagnose::AlarmEvent, throw::MachineId};

    fn alarm(machine: &str, cause: Cause, severity: Severity, text: &str) -> Alarm {
        let event = serde_json::json!({
            "cause": cause, "severity": severity, "text": text, "event_no": 1, "state": "active_unacknowledged",
            "raised_at": Timestamp::UNIX_EPOCH, "event_at": Timestamp::UNIX_EPOCH,
        });
        let event: AlarmEvent = serde_json::from_value(event).unwrap();
        Alarm::new(&MachineId::new("north", machine).unwrap(), &event)
    }

    #[test]
    fn only_alarms_of_one_kind_are_one_entry_and_those_of_the_daemon_come_first() {
        let lost = |at: usize| {
            let name = format!("m{at}");
            alarm(
                &name,
                Cause::DataLoss,
                Severity::Warning,
                &format!("Machine {name}: {} throws never arrived.", 2 + at),
            )
        };
        let mut alarms: Vec<Alarm> = (0..GROUP_SIZE).map(lost).collect();
        alarms.push(alarm("clock", Cause::DataLoss, Severity::Warning, "Machine clock: the clock is wrong."));
        alarms.push(alarm("worn", Cause::Friction, Severity::Critical, "Machine worn: friction up 40 %."));
        alarms.push(alarm("pointsd", Cause::DataLoss, Severity::Critical, "pointsd loses data: the disk is full."));
        let daemons = [MachineId::new("north", "pointsd").unwrap()];
        let names = |all| {
            let entries = entries(&alarms, &daemons, all);
            let name = |alarm: &&Alarm| alarm.machine.machine.to_string();
            entries.iter().map(|entry| entry.iter().map(name).collect::<Vec<_>>().join(" ")).collect::<Vec<_>>()
        };
        assert_eq!(names(false), ["pointsd", "worn", "m0 m1 m2 m3 m4", "clock"]);
        assert_eq!(names(true).len(), alarms.len());
        // A cleared alarm does not join the active ones.
        alarms[0].event.state = AlarmState::ClearedUnacknowledged;
        alarms.push(lost(GROUP_SIZE));
        let entries = entries(&alarms, &daemons, false);
        let group = entries.iter().find(|entry| entry.len() > 1).unwrap();
        assert!(group.len() == GROUP_SIZE && group.iter().all(|alarm| alarm.state.is_active()));
    }
}
