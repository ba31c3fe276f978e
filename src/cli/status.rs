//! `pointsd status`: how the daemons, their machines and their alarms stand.

use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use serde_json::{Value, json};

use super::{
    Exit, Outcome, alarms,
    operator::{self, ANSWER_LIMIT, Connection},
    runtime,
};
use crate::{
    bus::{self, OperatorError},
    daemon::StatusReport,
    wire::{Alarm, Health},
};

/// Shows all running daemons, the latest health of each machine and direction, and the open alarms.
///
/// Exit codes: 0 all is well; 1 a daemon is in trouble (disk, a loop that hangs, lost messages); 69 no daemon answers.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  pointsd status\n  pointsd status --connect tcp/cabinet-7:7447 --json")]
pub(super) struct Arguments {
    #[command(flatten)]
    connection: Connection,
    /// Print one JSON object with daemons, health and alarms.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    runtime::block_on(async {
        let session = arguments.connection.open().await?;
        let daemons = bus::ask(&session, "points/v1/*/monitor/*/status", None, ANSWER_LIMIT).await;
        let health = bus::ask(&session, "points/v1/*/*/health", None, ANSWER_LIMIT).await;
        let alarms = bus::ask(&session, "points/v1/*/*/alarm", None, ANSWER_LIMIT).await;
        operator::close(session).await;
        let daemons = daemons.map_err(operator::failure)?;
        if daemons.is_empty() {
            return Err(operator::failure(OperatorError::NoDaemon));
        }
        let (health, alarms) = (health.map_err(operator::failure)?, alarms.map_err(operator::failure)?);
        if arguments.json {
            let values = |replies: &[(String, Vec<u8>)]| -> Vec<Value> {
                replies.iter().filter_map(|(_, payload)| serde_json::from_slice(payload).ok()).collect()
            };
            println!("{}", json!({"daemons": values(&daemons), "health": values(&health), "alarms": values(&alarms)}));
        }
        let reports: Vec<(String, StatusReport)> = read(&daemons);
        if !arguments.json {
            print(&reports, &read(&health), &read(&alarms));
        }
        let well = reports.iter().all(|(_, report)| report.is_well());
        Ok(if well { Exit::Ok } else { Exit::Negative })
    })
}

fn read<T: serde::de::DeserializeOwned>(replies: &[(String, Vec<u8>)]) -> Vec<(String, T)> {
    let read = |(key, payload): &(String, Vec<u8>)| Some((key.clone(), serde_json::from_slice(payload).ok()?));
    replies.iter().filter_map(read).collect()
}

fn print(daemons: &[(String, StatusReport)], health: &[(String, Health)], alarms: &[(String, Alarm)]) {
    for (key, report) in daemons {
        let name = key.trim_start_matches("points/v1/").trim_end_matches("/status");
        println!("{name}: version {}, up {} s, database {}", report.version, report.uptime_s, report.database);
        println!("  {}", report.line());
    }
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header(["machine", "direction", "last throw", "quality", "b0", "a1", "a0", "fit"]);
    let change = |pct: Option<f64>| pct.map(|pct| format!("{pct:+.1} %")).unwrap_or_default();
    for (_, health) in health {
        table.add_row([
            format!("{}/{}", health.site, health.machine),
            health.direction.clone(),
            format!("{} at {:.0}", health.throw_no, health.started_at),
            health.quality.clone(),
            change(health.b0_pct),
            change(health.a1_pct),
            change(health.a0_pct),
            health.fit_pct.map(|fit| format!("{fit:.2} %")).unwrap_or_default(),
        ]);
    }
    println!("{table}");
    if alarms.is_empty() {
        println!("no alarms");
    } else {
        let alarms: Vec<Alarm> = alarms.iter().map(|(_, alarm)| alarm.clone()).collect();
        println!("{}", alarms::table(&alarms));
    }
}
