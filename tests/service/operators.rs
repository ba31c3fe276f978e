//! Logger, daemon and operators as separate processes.

use std::process::Stdio;

use pointsd::{diagnose::Cause, wire::Alarm};

use crate::rig::{PATIENCE, Rig, pointsd, pointsim};

fn logger(endpoint: &str, arguments: &[&str]) {
    let mut child = pointsim(&["run", "--connect", endpoint, "--time-scale", "100000"])
        .args(arguments)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    assert!(child.wait().unwrap().success());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_fault_becomes_an_alarm_that_operators_see_and_handle() {
    let rig = Rig::new();
    let daemon = rig.start();
    let session = daemon.client().await;
    let alarms = session.declare_subscriber("points/v1/**/alarm").await.unwrap();
    logger(&daemon.endpoint, &["--machines", "2", "--throws", "50", "--fault", "1:kt:-25:36"]);

    let sample = tokio::time::timeout(PATIENCE, alarms.recv_async()).await.unwrap().unwrap();
    assert_eq!(sample.key_expr().as_str(), "points/v1/north/machine-1/alarm");
    assert_eq!(sample.encoding(), &zenoh::bytes::Encoding::APPLICATION_JSON);
    let alarm: Alarm = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
    assert_eq!((alarm.cause, alarm.event_no), (Cause::Kt, 1));

    let (code, text) = daemon.operate(&["alarms", "--json"]);
    assert_eq!(code, Some(0), "{text}");
    let open: Alarm = serde_json::from_str(text.lines().next().unwrap()).unwrap();
    assert_eq!(open.alarm_id, alarm.alarm_id);

    let (code, text) = daemon.operate(&["ack", "north/machine-1", "kt", "--by", "tester"]);
    assert_eq!(code, Some(0), "{text}");
    let (code, text) = daemon.operate(&["ack", "north/machine-1", "kt", "--by", "another"]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("tester"), "{text}");
    let (code, text) = daemon.operate(&["ack", "north/machine-2", "kt", "--by", "tester"]);
    assert_eq!(code, Some(1), "{text}");
    let (code, text) =
        daemon.operate(&["shelve", "north/machine-1", "kt", "--for", "8h", "--why", "at work", "--by", "tester"]);
    assert_eq!(code, Some(0), "{text}");
    let (code, text) = daemon.operate(&["rebaseline", "north/machine-1", "--why", "new motor", "--by", "tester"]);
    assert_eq!(code, Some(0), "{text}");
    let (code, text) = daemon.operate(&["alarms", "--limit", "100", "--json"]);
    assert_eq!(code, Some(0), "{text}");
    let states: Vec<String> = text
        .lines()
        .map(|line| serde_json::from_str::<Alarm>(line).unwrap())
        .filter(|event| event.alarm_id == alarm.alarm_id)
        .map(|event| event.state.as_str().to_owned())
        .collect();
    for state in ["active_unacknowledged", "active_acknowledged", "shelved", "normal"] {
        assert!(states.iter().any(|seen| seen == state), "{state}: {states:?}");
    }

    let kept = rig.sql("SELECT command, cause, by_whom, why FROM operator_commands ORDER BY carried_out_at");
    let of = |key: &str| kept.iter().map(|row| row[key].as_str().unwrap_or("-").to_owned()).collect::<Vec<_>>();
    assert_eq!(of("command"), ["ack", "shelve", "rebaseline"], "what was refused is not there: {kept:?}");
    assert_eq!(of("cause"), ["kt", "kt", "-"]);
    assert_eq!(of("why"), ["-", "at work", "new motor"]);
    assert_eq!(of("by_whom"), ["tester"; 3]);

    let (code, text) = daemon.operate(&["status", "--json"]);
    assert_eq!(code, Some(0), "{text}");
    let status: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(status["daemons"][0]["stored"], 100);
    assert_eq!(status["health"].as_array().unwrap().len(), 4, "two machines, two directions");
    assert!(daemon.terminate().success());
    let rows = rig.sql("SELECT machine, count(*) AS n FROM health_history WHERE quality = 'good' GROUP BY machine");
    assert_eq!(rows.iter().map(|row| row["n"].as_i64().unwrap()).collect::<Vec<_>>(), [50, 50]);
}

/// Every command of an operator, for a machine.
const COMMANDS: [&[&str]; 9] = [
    &["status"],
    &["status", "--json"],
    &["alarms"],
    &["alarms", "north/21B", "--limit", "10", "--json"],
    &["ack", "north/21B", "kt", "--by", "tester"],
    &["shelve", "north/21B", "kt", "--for", "8h", "--why", "at work", "--by", "tester"],
    &["maintenance", "north/21B", "--why", "at work", "--by", "tester"],
    &["maintenance", "north/21B", "--end", "--by", "tester"],
    &["rebaseline", "north/21B", "--why", "new motor", "--by", "tester"],
];

/// Runs every command at once; returns their exit codes, and what they say on stderr. Nothing may be on stdout.
fn all_commands(endpoint: &str) -> Vec<(Option<i32>, String)> {
    let start = |arguments: &[&str]| {
        pointsd(arguments).args(["--connect", endpoint]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let running: Vec<_> = COMMANDS.into_iter().map(start).collect();
    let end = |child: std::process::Child| {
        let output = child.wait_with_output().unwrap();
        assert!(output.stdout.is_empty(), "{}", String::from_utf8_lossy(&output.stdout));
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    running.into_iter().map(end).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_a_daemon_operators_are_told_so() {
    for (arguments, (code, said)) in COMMANDS.iter().zip(all_commands("tcp/127.0.0.1:1")) {
        assert_eq!(code, Some(69), "{arguments:?}: {said}");
        assert!(said.starts_with("error: ") && said.contains("Is pointsd running?"), "{arguments:?}: {said}");
    }
    // A router without a daemon behind it.
    let mut config = zenoh::Config::default();
    for (key, value) in
        [("mode", "\"router\""), ("listen/endpoints", "[\"tcp/127.0.0.1:0\"]"), ("scouting/multicast/enabled", "false")]
    {
        config.insert_json5(key, value).unwrap();
    }
    let router = zenoh::open(config).await.unwrap();
    let endpoint = router.info().locators().await.first().unwrap().to_string();
    for (arguments, (code, said)) in COMMANDS.iter().zip(all_commands(&endpoint)) {
        assert_eq!(code, Some(69), "{arguments:?}: {said}");
        assert!(said.starts_with("error: no daemon answers"), "{arguments:?}: {said}");
        assert_eq!(said.lines().count(), 1, "{arguments:?}: {said}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_machine_that_no_daemon_serves_is_told_apart_from_no_daemon() {
    let rig = Rig::with("[subscribe]\nkey = \"points/v1/south/**\"\n");
    let daemon = rig.start();
    let (code, said) = daemon.operate(&["ack", "north/21B", "kt", "--by", "tester"]);
    assert_eq!(code, Some(69), "{said}");
    assert!(said.contains("no daemon serves north/21B"), "{said}");
    let (code, said) = daemon.operate(&["ack", "south/21B", "kt", "--by", "tester"]);
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("no machine south/21B is known here"), "{said}");
    // Silence is not health.
    let (code, said) = daemon.operate(&["alarms", "north/21B"]);
    assert_eq!(code, Some(69), "{said}");
    assert!(said.contains("no daemon knows north/21B"), "{said}");
    assert!(daemon.terminate().success());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sighup_takes_over_what_is_safe() {
    let rig = Rig::new();
    let daemon = rig.start();
    daemon.signal("-HUP");
    daemon.until_log("was read again");
    assert!(daemon.terminate().success());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_alarms_is_not_said_of_a_machine_that_nobody_knows() {
    let rig = Rig::new();
    let daemon = rig.start();
    logger(&daemon.endpoint, &["--machines", "1", "--throws", "2"]);
    for (machine, code, says) in [
        ("north/machine-1", 0, "no alarms"),
        ("fleet/pointsd", 0, "no alarms"),
        ("north/machine-7", 69, "no daemon knows north/machine-7"),
    ] {
        let (exit, text) = daemon.operate(&["alarms", machine]);
        assert_eq!(exit, Some(code), "{machine}: {text}");
        assert!(text.contains(says), "{machine}: {text}");
    }
    assert!(daemon.terminate().success());
}
