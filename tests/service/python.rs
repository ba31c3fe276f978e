//! Clients in Python with the package `eclipse-zenoh`, among them the programs of the README. Skipped, with a message,
//! without Python or the package.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use pointsd::{
    diagnose::Cause,
    wire::{Alarm, encode_throw},
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use crate::{
    cable::Cable,
    json::json_message,
    rig::{PATIENCE, Program, Rig, matched, stub, throws, until},
};

/// Publishes throws in JSON from the lines of its input, and prints the received alarms.
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

fn has_python() -> bool {
    can("import zenoh", "pip install eclipse-zenoh")
}

/// Whether Python can run a line; if not, prints how to install the missing package.
fn can(line: &str, install: &str) -> bool {
    let probe = Command::new("python3").args(["-c", line]).output();
    let is_there = probe.is_ok_and(|output| output.status.success());
    if !is_there {
        println!("skipped: {line} fails in python3 ({install})");
    }
    is_there
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn python_publishes_throws_and_receives_the_alarm() {
    if !has_python() {
        return;
    }
    let (rig, daemon) = Rig::running();
    let client = Command::new("python3")
        .args(["-c", CLIENT, &daemon.endpoint])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut client = Program(client);
    let mut input = client.0.stdin.take().unwrap();
    for (number, throw) in throws("python", 60).iter().enumerate() {
        // A weak motor: it needs a third more current for the same torque.
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
    let mut lines = BufReader::new(client.0.stdout.take().unwrap()).lines();
    let alarm = lines.by_ref().map_while(Result::ok).find(|line| line.starts_with('{')).expect("an alarm");
    let alarm: Alarm = serde_json::from_str(&alarm).unwrap();
    assert_eq!((alarm.machine.site.as_str(), alarm.machine.machine.as_str(), alarm.cause), ("south", "7", Cause::Kt));
    let rows = rig.judged(60).await;
    assert!(rows.iter().all(|row| row.quality == "good"));
}

/// Runs the Python program under a heading of the README, with this endpoint, in the folder of the rig.
fn readme(heading: &str, endpoint: &str, rig: &Rig) -> Child {
    let text = include_str!("../../README.md");
    let (_, section) = text.split_once(&format!("### {heading}\n")).unwrap();
    let (_, code) = section.split_once("```python\n").unwrap();
    let (code, _) = code.split_once("```").unwrap();
    Command::new("python3")
        .args(["-c", &code.replace("tcp/127.0.0.1:7447", endpoint)])
        .current_dir(rig.folder())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap()
}

/// The decoder of the README reads a channel of 32-bit floats, as from CBOR, and one of 64-bit floats, as from JSON.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_readme_decodes_the_traces_in_the_database() {
    if !can("import pcodec, numpy", "pip install pcodec numpy") {
        return;
    }
    let (rig, daemon) = Rig::running();
    let session = daemon.client().await;
    let publisher = matched(&session, "points/v1/north/21B/throw").await;
    let made = throws("boot", 2);
    publisher.put(encode_throw(&made[0])).await.unwrap();
    let json = publisher.put(json_message(&made[1]));
    json.encoding(zenoh::bytes::Encoding::APPLICATION_JSON).await.unwrap();
    rig.judged(2).await;
    let codecs = rig.sql("SELECT current_codec AS codec FROM trace ORDER BY throw_row");
    assert_eq!(codecs.iter().map(|row| row["codec"].as_str().unwrap()).collect::<Vec<_>>(), ["packed-f32", "pco-f64"]);
    let output = readme("Throws and traces in other tools", "", &rig).wait_with_output().unwrap();
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{printed}");
    for (line, throw) in printed.lines().zip(&made) {
        let peak = throw.trace.current_a().iter().fold(0.0_f64, |peak, it| peak.max(it.abs()));
        let read: f64 = line.split_whitespace().rev().nth(1).unwrap().parse().unwrap();
        assert!((read - peak).abs() < 1e-5, "{line}: {peak}");
    }
    assert_eq!(printed.lines().count(), 2, "{printed}");
}

/// Boot ids and numbers in rows, sorted.
fn numbers(rows: &[Value]) -> Vec<(String, u64)> {
    let of = |row: &Value| (row["boot_id"].as_str().unwrap().to_owned(), row["throw_no"].as_u64().unwrap());
    let mut numbers: Vec<_> = rows.iter().map(of).collect();
    numbers.sort_unstable();
    numbers
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_readmes_logger_loses_nothing_when_it_or_the_daemon_is_killed() {
    const KILLS: usize = 20;
    const LONGEST: Duration = Duration::from_millis(1_200);
    if !has_python() {
        return;
    }
    let rig = Rig::new().same_port();
    let mut daemon = rig.launch().0;
    daemon.signal("-KILL");
    daemon.wait(PATIENCE);
    let mut logger = Program(readme("A first logger in Python", &daemon.endpoint, &rig));
    let mut rng = ChaCha8Rng::seed_from_u64(20);
    let mut recorded = 0;
    // The logger stores throws although no daemon runs.
    let kept =
        || fs::read_to_string(rig.folder().join("points-v1-north-21B.jsonl")).unwrap_or_default().lines().count();
    let mut write = |logger: &mut Program| {
        recorded += 1;
        let throw = json!({
            "started_at": format!("2026-01-01T06:{:02}:{:02}Z", recorded / 60 % 60, recorded % 60),
            "sample_rate_hz": 100, "current_a": [0, 0, 0, 0], "position_mm": [0, 0, 0, 0],
        });
        writeln!(logger.0.stdin.as_mut().unwrap(), "{throw}").unwrap();
    };
    (0..5).for_each(|_| write(&mut logger));
    until(PATIENCE, async || if kept() == 5 { Ok(()) } else { Err("five throws are not stored") }).await;
    for kill in 0..2 * KILLS {
        let until = Instant::now() + rng.random_range(Duration::from_millis(100)..LONGEST);
        while Instant::now() < until {
            write(&mut logger);
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        if kill % 2 == 0 {
            daemon.kill();
            daemon = rig.launch().0;
        } else {
            drop(logger);
            logger = Program(readme("A first logger in Python", &daemon.endpoint, &rig));
        }
    }
    daemon.kill();
    let daemon = rig.start();
    let kept = until(2 * PATIENCE, async || {
        let file = fs::read_to_string(rig.folder().join("points-v1-north-21B.jsonl")).unwrap();
        let kept: Vec<Value> = file.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let stored = rig.sql("SELECT boot_id, throw_no FROM throw JOIN boot USING (boot_row)");
        let is_all = numbers(&stored) == numbers(&kept);
        if is_all { Ok(kept) } else { Err(format!("{} stored of {} kept", stored.len(), kept.len())) }
    })
    .await;
    let status = daemon.status();
    daemon.terminate();
    println!(
        "{KILLS} kills each of daemon and logger: {recorded} throws recorded, {} kept and stored; {status}",
        kept.len()
    );
    assert!(kept.len() > 100, "{} throws", kept.len());
    assert_eq!(rig.sql("SELECT * FROM data_gaps WHERE missing_throws > 0"), Vec::<Value>::new());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_readmes_subscriber_gets_every_alarm_over_its_own_cut_links() {
    /// Length of a cut; zenoh closes a silent link after 10 s.
    const CUT: Duration = Duration::from_secs(12);
    const CUTS: usize = 2;
    if !has_python() {
        return;
    }
    let (rig, daemon) = Rig::running_with("[diagnosis]\nnot_monitored_throws = 1\n");
    let cable = Cable::to(&daemon.endpoint).await;
    let session = daemon.client().await;
    let mut subscriber = Program(readme("A first subscriber in Python", &cable.endpoint, &rig));
    let mut lines = BufReader::new(subscriber.0.stdout.take().unwrap()).lines().map_while(Result::ok);
    let mut alarms = 0;
    // The first throw of a new machine has no estimate, which raises an alarm.
    let raise = async |number: usize| {
        let key = format!("points/v1/north/m{number}/throw");
        let throw = json_message(&stub("b1", 1));
        crate::rig::put(&session, &key, zenoh::bytes::Encoding::APPLICATION_JSON, throw).await;
        rig.until_sql(&format!("SELECT 1 FROM alarm_events WHERE machine = 'm{number}'")).await;
    };
    for cut in 0..=CUTS {
        for is_cut in [false, true] {
            if is_cut && cut < CUTS {
                cable.cut();
            }
            raise(alarms).await;
            raise(alarms + 1).await;
            alarms += 2;
        }
        if cut < CUTS {
            tokio::time::sleep(CUT).await;
            cable.mend();
        }
    }
    let mut missing: Vec<String> = (0..alarms).map(|number| format!("Machine north/m{number}:")).collect();
    let found = tokio::task::spawn_blocking(move || {
        while !missing.is_empty() {
            let Some(line) = lines.next() else { break };
            missing.retain(|machine| !line.contains(machine.as_str()));
        }
        missing
    });
    let missing = tokio::time::timeout(PATIENCE, found).await.expect("every alarm in time").unwrap();
    assert_eq!(missing, Vec::<String>::new());
}
