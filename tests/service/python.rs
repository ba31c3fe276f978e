//! Foreign clients: Python with `eclipse-zenoh`. Skipped, and said so, where Python or the package is absent.

use std::{
    io::{BufRead, BufReader, Write},
    process::{Command, Stdio},
};

use pointsd::{diagnose::Cause, wire::Alarm};
use serde_json::json;

use crate::rig::{Rig, throws};

/// Publishes throws in JSON, one a line of its input, and prints the alarms that come back.
const CLIENT: &str = r#"
import json, sys, time, zenoh
config = zenoh.Config.from_json5(json.dumps({
    "mode": "client", "connect": {"endpoints": [sys.argv[1]]}, "scouting": {"multicast": {"enabled": False}}}))
with zenoh.open(config) as session:
    def alarm(sample):
        print(sample.payload.to_string(), flush=True)
    subscriber = session.declare_subscriber("points/v1/**/alarm", alarm)
    publisher = session.declare_publisher("points/v1/south/7/throw", encoding=zenoh.Encoding.APPLICATION_JSON,
                                          congestion_control=zenoh.CongestionControl.BLOCK)
    while not publisher.matching_status.matching:
        time.sleep(0.05)
    for line in sys.stdin:
        publisher.put(line)
    print("sent", flush=True)
    sys.stdin = None
    time.sleep(600)
"#;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn python_publishes_throws_and_receives_the_alarm() {
    let probe = Command::new("python3").args(["-c", "import zenoh"]).output();
    if !probe.is_ok_and(|output| output.status.success()) {
        println!("skipped: no python3 with eclipse-zenoh here (pip install eclipse-zenoh)");
        return;
    }
    let rig = Rig::new();
    let daemon = rig.start();
    let mut client = Command::new("python3")
        .args(["-c", CLIENT, &daemon.endpoint])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = client.stdin.take().unwrap();
    for (number, throw) in throws("python", 60).iter().enumerate() {
        // The motor has weakened: it needs a third more current for the same torque.
        let more = if number < 40 { 1.0 } else { 1.33 };
        let current: Vec<f64> = throw.trace.current_a().iter().map(|current| current * more).collect();
        let message = json!({
            "schema": "points.throw/1", "boot_id": throw.id.boot_id, "throw_no": throw.id.throw_no,
            "started_at": throw.started_at.to_string().replace('Z', "+00:00"), "direction": "unknown",
            "sample_rate_hz": 1000, "current_a": current, "position_mm": throw.trace.position_mm(),
            "firmware": {"version": [1, 2]},
        });
        assert!((throw.trace.sample_rate_hz() - 1000.0).abs() < 1e-9);
        writeln!(input, "{message}").unwrap();
    }
    drop(input);
    let mut lines = BufReader::new(client.stdout.take().unwrap()).lines();
    let alarm = lines.by_ref().map_while(Result::ok).find(|line| line.starts_with('{')).expect("an alarm");
    let alarm: Alarm = serde_json::from_str(&alarm).unwrap();
    assert_eq!((alarm.site.as_str(), alarm.machine.as_str(), alarm.cause), ("south", "7", Cause::Kt));
    let rows = rig.judged(60).await;
    client.kill().unwrap();
    client.wait().unwrap();
    assert!(rows.iter().all(|row| row.quality == "good"));
    assert!(daemon.terminate().success());
}
