//! Logger, daemon and operators as separate processes.

use std::{process::Stdio, time::Duration};

use pointsd::{diagnose::Cause, wire::Alarm};

use crate::rig::{PATIENCE, Rig, pointsim};

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

    let (code, text) = daemon.operate(&["status", "--json"]);
    assert_eq!(code, Some(0), "{text}");
    let status: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(status["daemons"][0]["stored"], 100);
    assert_eq!(status["health"].as_array().unwrap().len(), 4, "two machines, two directions");
    assert!(daemon.terminate().success());
    let rows = rig.sql("SELECT machine, count(*) AS n FROM health_history WHERE quality = 'good' GROUP BY machine");
    assert_eq!(rows.iter().map(|row| row["n"].as_i64().unwrap()).collect::<Vec<_>>(), [50, 50]);
}

#[test]
fn without_a_daemon_operators_are_told_so() {
    let output = crate::rig::pointsd(&["status", "--connect", "tcp/127.0.0.1:1"]).output().unwrap();
    assert_eq!(output.status.code(), Some(69), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stderr).contains("Is pointsd running?"));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sighup_takes_over_what_is_safe() {
    let rig = Rig::new();
    let daemon = rig.start();
    daemon.signal("-HUP");
    let read_again = async {
        while !daemon.log().iter().any(|line| line.contains("was read again")) {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(PATIENCE, read_again).await.unwrap();
    assert!(daemon.terminate().success());
}
