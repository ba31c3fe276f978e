//! The documents agree with the program.

use std::{collections::HashSet, fs, path::Path};

use pointsd::{
    daemon::StatusReport,
    diagnose::MachineState,
    store::DiskLevel,
    wire::{Alarm, Health, decode_command, decode_throw},
};
use serde_json::{Value, json};

use super::site::read;

/// README and the documents of `deploy/`, with their names.
fn documents() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let deploy = fs::read_dir(root.join("deploy")).unwrap().map(|entry| entry.unwrap().path());
    let documents = deploy.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    let documents = documents.chain([root.join("README.md")]);
    documents.map(|path| (path.display().to_string(), fs::read_to_string(path).unwrap())).collect()
}

#[test]
fn no_heading_of_a_document_occurs_twice() {
    let documents = documents();
    assert!(documents.len() >= 5, "{}", documents.len());
    for (name, text) in documents {
        let mut seen = HashSet::new();
        let twice: Vec<&str> =
            text.lines().filter(|line| line.starts_with("## ")).filter(|line| !seen.insert(*line)).collect();
        assert!(twice.is_empty(), "{name}: {twice:?}");
    }
}

/// The names in backticks in the first column of the table under a heading.
fn first_cells(page: &str, heading: &str) -> Vec<String> {
    let section = page.split("\n## ").find(|section| section.starts_with(heading)).unwrap();
    first_column(section).flat_map(|cell| cell.split("`, `")).map(str::to_owned).collect()
}

/// The cells in backticks in the first column of a table.
fn first_column(table: &str) -> impl Iterator<Item = &str> {
    table.lines().filter_map(|line| Some(line.strip_prefix("| `")?.split_once("` |")?.0))
}

fn keys(value: &Value) -> HashSet<String> {
    value.as_object().unwrap().keys().cloned().collect()
}

#[test]
fn the_page_of_messages_has_every_field() {
    let page = read("MESSAGES.md");
    let alarm: Alarm = serde_json::from_value(json!({
        "schema": Alarm::SCHEMA, "alarm_id": "a", "event_no": 1, "site": "north", "machine": "21B", "cause": "sensor",
        "severity": "warning", "state": "shelved", "over": true, "raised_at": "2026-05-04T10:11:12Z", "channel": "clock",
        "event_at": "2026-05-04T10:11:12Z", "text": "what", "text_at": "2026-05-04T10:11:12Z"
    }))
    .unwrap();
    let alarm: Value = serde_json::from_slice(&alarm.into_message()).unwrap();
    assert_eq!(first_cells(&page, "Alarm").into_iter().collect::<HashSet<_>>(), keys(&alarm));

    let health: Health = serde_json::from_value(json!({
        "schema": Health::SCHEMA, "site": "north", "machine": "21B", "boot_id": "b", "throw_no": 7,
        "started_at": "2026-05-04T10:11:12Z", "direction": "unknown", "quality": "good", "caveats": ["cold"],
        "drifts": [{"cause": "kt", "change_pct": -7.0, "change_pct_sd": 0.5, "direction": null, "limit_in_throws": null}]
    }))
    .unwrap();
    let health: Value = serde_json::from_slice(&pointsd::wire::json_bytes(&health)).unwrap();
    assert_eq!(first_cells(&page, "Health").into_iter().collect::<HashSet<_>>(), keys(&health));

    let status = serde_json::to_value(StatusReport::default()).unwrap();
    assert_eq!(first_cells(&page, "Status").into_iter().collect::<HashSet<_>>(), keys(&status));
}

/// Each line that `pointsd status` prints is in the table of the page, up to its first colon and without its numbers.
#[test]
fn the_page_of_the_installation_has_every_problem_of_the_status() {
    let page = read("INSTALL.md");
    let (_, table) = page.split_once("| status | meaning |").unwrap();
    let (table, _) = table.split_once("\n\n").unwrap();
    let subject = |part: &str| -> String {
        let words = part.split(':').next().unwrap_or_default().split([' ', '(', ')', ',']);
        let words = words.filter(|word| !word.is_empty() && !word.contains(|letter: char| letter.is_ascii_digit()));
        words.collect::<Vec<_>>().join(" ")
    };
    let rows: Vec<String> = first_column(table).map(subject).collect();
    let report = |disk| {
        let mut report = StatusReport {
            disk,
            copying: true,
            silent: vec!["receive".to_owned()],
            loggers_ahead: 2,
            loggers_behind: 2,
            refused: vec!["north/x".to_owned()],
            webhook_fails: true,
            webhook_refused: 2,
            alarm_events_lost: 2,
            dropped: 3,
            lost: 3,
            backlog: 40,
            loggers: 12,
            stored: 5190,
            not_served: vec!["north/x".to_owned()],
            without_throw: vec!["north/x".to_owned()],
            ..StatusReport::default()
        };
        report.fleet_counts.own_alarms = 2;
        report.fleet_counts.shelved_alarms = 2;
        report.fleet_counts.machines = [(MachineState::Critical, 1), (MachineState::Maintenance, 2)].into();
        report
    };
    let parts: Vec<String> = [DiskLevel::Low, DiskLevel::Full, DiskLevel::Failing]
        .into_iter()
        .flat_map(|disk| report(disk).parts())
        .collect();
    assert!(parts.len() > 30, "{parts:?}");
    for part in &parts {
        assert!(rows.contains(&subject(part)), "{part}: {rows:?}");
    }
}

#[test]
fn a_throw_of_the_fields_on_the_page_of_messages_is_valid() {
    let mut throw = json!({
        "schema": "points.throw/1", "boot_id": "b", "throw_no": 7, "started_at": "2026-05-04T10:11:12+02:00",
        "direction": "unknown", "sample_rate_hz": 1000, "current_a": [0.1, null], "position_mm": [0.0, 0.0],
        "temperature_c": 4.0, "supply_v": [110.0, 110.0], "anti_alias_hz": 400
    });
    let documented: HashSet<String> = first_cells(&read("MESSAGES.md"), "Throw").into_iter().collect();
    assert_eq!(documented, keys(&throw));
    let decode = |throw: &Value| decode_throw(pointsd::wire::Encoding::Json, throw.to_string().as_bytes());
    assert!(decode(&throw).is_ok());
    for optional in ["position_mm", "temperature_c", "supply_v", "anti_alias_hz"] {
        throw.as_object_mut().unwrap().remove(optional);
    }
    assert!(decode(&throw).is_ok());
    for required in ["schema", "boot_id", "throw_no", "started_at", "sample_rate_hz", "current_a"] {
        let mut incomplete = throw.clone();
        incomplete.as_object_mut().unwrap().remove(required);
        assert!(decode(&incomplete).is_err(), "{required}");
    }
}

#[test]
fn the_commands_on_the_page_of_messages_are_valid() {
    let commands = first_cells(&read("MESSAGES.md"), "Command");
    let names: HashSet<&str> = commands
        .iter()
        .map(|text| decode_command(text.as_bytes()).unwrap_or_else(|error| panic!("{text}: {error}")).name())
        .collect();
    let all = ["ack", "shelve", "unshelve", "maintenance_start", "maintenance_end", "rebaseline", "retire"];
    assert_eq!(names, all.into());
}
