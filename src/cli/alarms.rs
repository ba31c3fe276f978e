//! `pointsd alarms`: the open alarms, or the history of their events.

use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use jiff::Timestamp;

use super::{
    Exit, Outcome,
    operator::{self, ANSWER_LIMIT, Connection, MachineArgument},
    runtime,
};
use crate::{
    bus,
    wire::{self, Alarm, Kind},
};

/// Shows the open alarms of all running daemons; with --since or --limit the events of all alarms.
///
/// Exit codes: 0 shown; 69 no daemon answers, or none knows the machine.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  pointsd alarms\n  pointsd alarms north/21B --since 2026-05-01T00:00:00Z --json")]
pub(super) struct Arguments {
    /// Only this machine.
    #[arg(value_name = "SITE/MACHINE")]
    machine: Option<MachineArgument>,
    /// Events from this time on, RFC 3339.
    #[arg(long, value_name = "TIME")]
    since: Option<Timestamp>,
    /// At most so many events, the newest.
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
    #[command(flatten)]
    connection: Connection,
    /// Print the messages as JSON, one a line.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    runtime::block_on(async {
        let session = arguments.connection.open().await?;
        let answer = bus::ask(&session, &selector(arguments), None, ANSWER_LIMIT).await;
        let watched = match &answer {
            Ok(replies) if replies.is_empty() => {
                let machine = arguments.machine.as_ref().map(|MachineArgument(machine)| machine);
                bus::is_watched(&session, machine, ANSWER_LIMIT).await
            }
            _ => Ok(()),
        };
        operator::close(session).await;
        let replies = answer.map_err(operator::failure)?;
        watched.map_err(operator::failure)?;
        Ok(print(&replies, arguments.json))
    })
}

fn selector(arguments: &Arguments) -> String {
    let key = match &arguments.machine {
        Some(MachineArgument(machine)) => wire::machine_key(machine, Kind::Alarm),
        None => "points/v1/*/*/alarm".to_owned(),
    };
    let since = arguments.since.map(|since| format!("since={since}"));
    let limit = arguments.limit.map(|limit| format!("limit={limit}"));
    let parameters: Vec<String> = since.into_iter().chain(limit).collect();
    if parameters.is_empty() { key } else { format!("{key}?{}", parameters.join(";")) }
}

fn print(replies: &[(String, Vec<u8>)], json: bool) -> Exit {
    if json {
        for (_, payload) in replies {
            println!("{}", String::from_utf8_lossy(payload));
        }
        return Exit::Ok;
    }
    let alarms: Vec<Alarm> = replies.iter().filter_map(|(_, payload)| serde_json::from_slice(payload).ok()).collect();
    if alarms.is_empty() {
        println!("no alarms");
        return Exit::Ok;
    }
    println!("{}", table(&alarms));
    Exit::Ok
}

/// Alarms as a table for people.
pub(super) fn table(alarms: &[Alarm]) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header(["machine", "cause", "severity", "state", "since", "what"]);
    for alarm in alarms {
        table.add_row([
            format!("{}/{}", alarm.site, alarm.machine),
            alarm.cause.as_str().to_owned(),
            alarm.severity.as_str().to_owned(),
            alarm.state.as_str().to_owned(),
            format!("{:.0}", alarm.raised_at),
            alarm.text.clone(),
        ]);
    }
    table
}
