//! `pointsd replay`: stored throws with other settings, into a separate database.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use jiff::{SignedDuration, Timestamp};
use pointsd::{
    daemon::{Offline, config::Config},
    simulate::{Fault, FleetFault, FleetSettings, Part, Shape},
    throw::{MachineId, Throw},
};
use sqlx::Connection as _;

/// Throws of the baseline in both directions, and throws with the fault.
const THROWS: (u64, u64) = (24, 16);
/// Throws after these, dated by a wrong clock: the alarm about it has the time of reception.
const MISDATED: u64 = 6;

fn configuration(folder: &Path, name: &str, diagnosis: &str) -> std::path::PathBuf {
    let file = folder.join(name);
    let database = folder.join("pointsd.db");
    let baseline = "baseline_throws = 12\nbaseline_usable_throws = 12";
    let text = format!("[store]\npath = '{}'\n\n[diagnosis]\n{baseline}\n{diagnosis}\n", database.display());
    fs::write(&file, text).unwrap();
    file
}

/// Writes a life to the database in which the motor loses a quarter of its torque after the baseline.
async fn record(config: &Path) {
    let fault = Fault { part: Part::Kt, shape: Shape::Step, size_pct: -25.0, from_throw: THROWS.0 };
    let fleet =
        FleetSettings { machines: 1, faults: vec![FleetFault { machine: 0, fault }], ..FleetSettings::default() };
    let mut machine = fleet.build(3).unwrap().pop().unwrap();
    let mut pipeline = Offline::open(Config::load(Some(config)).unwrap()).await.unwrap();
    let id = MachineId::new("north", "21B").unwrap();
    for throw_no in 1..=THROWS.0 + THROWS.1 + MISDATED {
        let hours = SignedDuration::from_hours(i64::try_from(throw_no).unwrap());
        let at = "2026-01-01T00:00:00Z".parse::<Timestamp>().unwrap() + hours;
        let simulated = machine.next_throw("a", at).unwrap();
        let is_misdated = throw_no > THROWS.0 + THROWS.1;
        let started_at = if is_misdated { at + SignedDuration::from_hours(200 * 24) } else { at };
        let throw = Throw { temperature_c: None, supply_v: None, started_at, ..simulated };
        pipeline.take(&id, &throw, at).await.unwrap();
    }
    pipeline.judge().await.unwrap();
    pipeline.close().await.unwrap();
}

/// The recorded database, to change its rows.
async fn recorded(folder: &Path) -> sqlx::SqliteConnection {
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(folder.join("pointsd.db")).foreign_keys(false);
    sqlx::SqliteConnection::connect_with(&options).await.unwrap()
}

fn replay(config: &Path, into: &Path, more: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_pointsd");
    Command::new(program).args(["replay", "--config"]).arg(config).arg("--into").arg(into).args(more).output().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn other_settings_show_which_alarms_differ_and_leave_the_old_database_alone() {
    let folder = tempfile::tempdir().unwrap();
    let same = configuration(folder.path(), "same.toml", "");
    record(&same).await;

    let answer = |config: &Path, into: &str| {
        let output = replay(config, &folder.path().join(into), &["--json"]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()
    };
    let unchanged = answer(&same, "same.db");
    assert_eq!(unchanged["throws"], THROWS.0 + THROWS.1 + MISDATED);
    let alarms = unchanged["alarms"].as_array().unwrap();
    for cause in ["kt", "sensor"] {
        assert!(alarms.iter().any(|alarm| alarm["cause"] == cause), "{cause}: {unchanged}");
    }
    assert!(alarms.iter().all(|alarm| alarm["difference"] == "same"), "{unchanged}");

    let tolerant = configuration(folder.path(), "tolerant.toml", "kt_limit_pct = 60.0");
    let changed = answer(&tolerant, "tolerant.db");
    let alarms = changed["alarms"].as_array().unwrap();
    let motor: Vec<_> = alarms.iter().filter(|alarm| alarm["cause"] == "kt").collect();
    assert!(!motor.is_empty() && motor.iter().all(|alarm| alarm["difference"] == "gone"), "{changed}");

    // The scatter of a healthy machine hides a change at this limit: the alarm that says so is a difference.
    let strict = configuration(
        folder.path(),
        "strict.toml",
        "friction_limit_pct = 0.01\ncritical_factor = 1.0\nnot_monitored_throws = 5",
    );
    let blind = answer(&strict, "strict.db");
    let new = |alarm: &&serde_json::Value| alarm["cause"] == "not_monitored" && alarm["difference"] == "new";
    assert!(blind["alarms"].as_array().unwrap().iter().any(|alarm| new(&alarm)), "{blind}");

    // The source database is unchanged.
    assert_eq!(answer(&same, "again.db")["alarms"], unchanged["alarms"]);
}

/// After a cut link the newest throws arrive first. The daemon waits for the backlog and judges the throws in order, and
/// so does the replay. Then its clock was set back, and the last throw is pending.
#[tokio::test(flavor = "multi_thread")]
async fn throws_from_a_backlog_are_replayed_in_the_order_in_which_they_were_judged() {
    let folder = tempfile::tempdir().unwrap();
    let same = configuration(folder.path(), "same.toml", "");
    record(&same).await;
    let mut database = recorded(folder.path()).await;
    let (first, last) = (THROWS.0 - 6, THROWS.0 + 5);
    for table in ["trace", "estimate", "throw"] {
        let late =
            format!("UPDATE {table} SET throw_row = throw_row + 1000 WHERE throw_row BETWEEN {first} AND {last}");
        sqlx::query(sqlx::AssertSqlSafe(late)).execute(&mut database).await.unwrap();
    }
    for later in [
        format!("UPDATE throw SET judged_at_us = judged_at_us - 86400000000 WHERE throw_no > {}", THROWS.0),
        format!("UPDATE throw SET judged_at_us = NULL WHERE throw_no = {}", THROWS.0 + THROWS.1 + MISDATED),
    ] {
        sqlx::query(sqlx::AssertSqlSafe(later)).execute(&mut database).await.unwrap();
    }
    database.close().await.unwrap();
    let json = replay(&same, &folder.path().join("new.db"), &["--json"]);
    let report: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    let alarms = report["alarms"].as_array().unwrap();
    assert!(alarms.len() > 1 && alarms.iter().all(|alarm| alarm["difference"] == "same"), "{report}");
}

/// The replay learns its baselines from the throws that are left. These include those with the fault.
#[tokio::test(flavor = "multi_thread")]
async fn an_alarm_from_before_the_new_baselines_are_complete_is_not_called_gone() {
    let folder = tempfile::tempdir().unwrap();
    let same = configuration(folder.path(), "same.toml", "");
    record(&same).await;
    let mut database = recorded(folder.path()).await;
    sqlx::query("DELETE FROM trace WHERE throw_row <= 20").execute(&mut database).await.unwrap();
    database.close().await.unwrap();

    let json = replay(&same, &folder.path().join("new.db"), &["--json"]);
    let report: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!((&report["without_trace"], &report["not_replayed"]), (&20.into(), &1.into()), "{report}");
    let alarms = report["alarms"].as_array().unwrap();
    assert!(alarms.iter().all(|alarm| alarm["difference"] != "gone"), "{report}");
    let text = replay(&same, &folder.path().join("text.db"), &[]);
    let text = String::from_utf8(text.stdout).unwrap();
    assert!(text.contains("not compared, as the baselines were not complete at that time: 1 alarm\n"), "{text}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_missing_source_or_an_existing_target_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let config = configuration(folder.path(), "config.toml", "");
    let into = folder.path().join("new.db");
    let nothing = replay(&config, &into, &[]);
    assert_eq!(nothing.status.code(), Some(66));
    assert!(String::from_utf8_lossy(&nothing.stderr).contains("--from"));

    Offline::open(Config::load(Some(&config)).unwrap()).await.unwrap().close().await.unwrap();
    let empty = replay(&config, &into, &[]);
    assert_eq!(empty.status.code(), Some(65), "{}", String::from_utf8_lossy(&empty.stderr));
    assert!(!into.exists(), "a database was left");

    fs::write(&into, "somebody's").unwrap();
    let taken = replay(&config, &into, &[]);
    assert_eq!(taken.status.code(), Some(73));
    assert!(String::from_utf8_lossy(&taken.stderr).contains("--into"));
}
