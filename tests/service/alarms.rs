//! Alarms about the monitoring itself: a missing logger, throws that never arrive, a damaged database. Each problem has
//! one alarm, also after a restart.

use std::{os::unix::net::UnixDatagram, process::Stdio};

use pointsd::{
    diagnose::{AlarmState, Cause, Severity},
    wire::Alarm,
};

use crate::{
    http::{ALIVE, KEY},
    rig::{PATIENCE, Program, Rig, listen, next, pointsd, stub, throws},
};

/// Configuration with an alarm 1.2 s after a logger is gone.
const HASTY: &str = "[diagnosis]\nlogger_gone_minutes = 0.02\n";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_logger_that_goes_is_an_alarm_until_it_is_back() {
    let (rig, daemon) = Rig::running_with(HASTY);
    let session = daemon.client().await;
    let alarms = listen(&session).await;
    let logger = daemon.logger(KEY).await;
    let token = logger.session.liveliness().declare_token(ALIVE).await.unwrap();
    logger.send([stub("boot", 1)]).await;
    rig.judged(1).await;
    // The presence of the logger is in the stored snapshot, so it outlives a kill.
    rig.until_sql("SELECT 1 AS n FROM monitor WHERE snapshot LIKE '%\"logger\":\"there\"%'").await;

    drop(token);
    logger.close().await;
    let raised = next(&alarms).await.1;
    assert_eq!((raised.cause, raised.state), (Cause::NotMonitored, AlarmState::ActiveUnacknowledged));
    assert!(raised.text.contains("logger has been gone"), "{}", raised.text);
    // Its throws from before a repair may arrive after it.
    let said = daemon.says(0, &["rebaseline", "north/21B", "--why", "repair", "--by", "tester"]);
    assert!(said.contains("Throws that the logger made before this command"), "{said}");

    let logger = daemon.client().await;
    let token = logger.liveliness().declare_token(ALIVE).await.unwrap();
    let cleared = next(&alarms).await.1;
    assert_eq!((&cleared.alarm_id, cleared.state), (&raised.alarm_id, AlarmState::ClearedUnacknowledged));

    // The logger ends while the daemon is down.
    daemon.kill();
    drop((token, logger, alarms));
    drop(session);
    let daemon = rig.start();
    let session = daemon.client().await;
    let alarms = listen(&session).await;
    // An event from just before the kill may be published again.
    let again = loop {
        let alarm = next(&alarms).await.1;
        if (&alarm.alarm_id, alarm.event_no) > (&cleared.alarm_id, cleared.event_no) {
            break alarm;
        }
    };
    assert_eq!((again.cause, again.state), (Cause::NotMonitored, AlarmState::ActiveUnacknowledged));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_logger_that_is_gone_before_its_first_throw_is_judged_is_an_alarm() {
    let (rig, daemon) = Rig::running_with(HASTY);
    let session = daemon.client().await;
    let alarms = listen(&session).await;
    let logger = daemon.client().await;
    let token = logger.liveliness().declare_token(ALIVE).await.unwrap();
    daemon.until_status("a logger", |status| status["loggers"] == 1).await;
    drop((token, logger));
    daemon.until_status("no logger", |status| status["loggers"] == 0).await;
    let logger = daemon.logger(KEY).await;
    logger.send([stub("boot", 1)]).await;
    rig.judged(1).await;
    let raised = next(&alarms).await.1;
    assert!(raised.text.contains("logger has been gone"), "{}", raised.text);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn throws_that_were_missing_before_a_restart_are_an_alarm_after_it_and_only_once() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    logger.send([1, 5].map(|number| stub("boot", number))).await;
    rig.judged(2).await;
    daemon.terminate();
    logger.close().await;
    // The minute for late throws passes while the daemon is down.
    rig.change("UPDATE gap SET detected_at_us = detected_at_us - 61000000").await;

    let daemon = rig.start();
    rig.until_sql("SELECT 1 AS n FROM active_alarms WHERE cause = 'data_loss'").await;
    daemon.terminate();
    let daemon = rig.start();
    let logger = daemon.logger(KEY).await;
    logger.send([&stub("boot", 6)]).await;
    rig.judged(3).await;
    daemon.terminate();
    let events = rig.sql("SELECT machine, event_no, text FROM alarm_events WHERE cause = 'data_loss'");
    assert_eq!(events.len(), 1, "{events:?}");
    assert!(events[0]["text"].as_str().unwrap().contains("3 throws never arrived"), "{events:?}");
}

/// Each repetition would add up the same throws. A trigger stands for a schema that another program has changed.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn missing_throws_whose_alarm_the_database_rejects_are_reported_once() {
    let (rig, daemon) = Rig::running();
    rig.change(
        "CREATE TRIGGER reject BEFORE INSERT ON alarm \
         WHEN NEW.machine_row = (SELECT machine_row FROM machine WHERE machine = '21B') \
         BEGIN SELECT RAISE(ABORT, 'no such machine'); END",
    )
    .await;
    let logger = daemon.logger(KEY).await;
    logger.send([1, 5].map(|number| stub("boot", number))).await;
    daemon.until_status("the rejection", |status| status["alarm_events_lost"] == 1).await;
    rig.until_sql("SELECT 1 AS n FROM gap WHERE told_at_us IS NOT NULL").await;
    assert_eq!(daemon.status()["alarm_events_lost"], 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_broken_database_is_set_aside_with_an_alarm_that_operators_can_answer() {
    // A daemon with its own name outside its part of the fleet.
    let (rig, daemon) =
        Rig::running_with("[subscribe]\nkey = \"points/v1/north/**\"\n[monitor]\nsite = \"cabinets\"\nid = \"c7\"\n");
    daemon.terminate();
    std::fs::write(rig.database(), vec![7_u8; 100_000]).unwrap();

    for start in 0..2 {
        // A restart with the file in place does not raise the alarm again.
        let daemon = rig.start();
        let question = "SELECT 1 AS n FROM active_alarms WHERE machine = 'c7' AND cause = 'data_loss'";
        rig.until_sql(question).await;
        for selector in [&["alarms", "cabinets/c7", "--json"][..], &["alarms", "--json"]] {
            let text = daemon.says(0, selector);
            let lines: Vec<Alarm> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
            let [alarm] = &lines[..] else { panic!("{text}") };
            assert_eq!((alarm.machine.site.as_str(), alarm.machine.machine.as_str()), ("cabinets", "c7"));
            assert_eq!((alarm.cause, alarm.severity), (Cause::DataLoss, Severity::Critical));
            assert!(
                alarm.text.contains("points.db-broken-") && alarm.text.contains("Move this file elsewhere"),
                "{text}"
            );
        }
        if start == 0 {
            daemon.says(0, &["ack", "cabinets/c7", "data_loss", "--by", "tester"]);
        }
        daemon.terminate();
    }
    let events = rig.sql("SELECT state FROM alarm_events ORDER BY event_no");
    let states: Vec<&str> = events.iter().map(|event| event["state"].as_str().unwrap()).collect();
    assert_eq!(states, ["active_unacknowledged", "active_acknowledged"]);

    // Under another name its former one is no machine of the fleet.
    let renamed = Rig::with("[subscribe]\nkey = \"points/v1/north/**\"\n").in_folder(rig.folder());
    renamed.start().until_status("a new own alarm", |status| status["own_alarms"] == 1).await;
    renamed.until_sql("SELECT 1 FROM operator_commands WHERE machine = 'c7' AND command = 'retire'").await;
    let daemon = renamed.start();
    daemon.until_status("the own alarm", |status| status["own_alarms"] == 1).await;
    let status = daemon.status();
    assert_eq!(
        (&status["machines"], &status["not_served"]),
        (&serde_json::json!({}), &serde_json::json!([])),
        "{status}"
    );
    assert!(renamed.sql("SELECT * FROM active_alarms WHERE machine = 'c7'").is_empty());
}

/// Otherwise a logger with this name could clear the alarms of the daemon about itself, which are stored as alarms of a
/// machine with this name.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_logger_publishes_under_the_name_of_the_daemon() {
    let rig = Rig::new();
    std::fs::write(rig.database(), vec![7_u8; 100_000]).unwrap();
    let daemon = rig.start();
    rig.until_sql("SELECT 1 AS n FROM active_alarms WHERE machine = 'pointsd' AND cause = 'data_loss'").await;
    daemon.terminate();
    let daemon = rig.start();
    let logger = daemon.logger("points/v1/fleet/pointsd/throw").await;
    logger.send((1..=6).map(|throw_no| stub("boot", throw_no))).await;
    rig.until_sql("SELECT 1 AS n FROM quarantine WHERE reason LIKE '%the name of pointsd itself%'").await;
    daemon
        .until_status("the refused name", |status| {
            status["refused"].to_string().contains("fleet/pointsd (this is the name of pointsd itself")
        })
        .await;
}

#[test]
fn a_long_start_extends_the_timeout_of_systemd() {
    let rig = Rig::new();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    let config = rig.write_config();
    let mut command = pointsd(&["run", "--config"]);
    let child = command.arg(config).env("NOTIFY_SOCKET", &path).stderr(Stdio::null()).spawn().unwrap();
    let _program = Program(child);
    let mut said = Vec::new();
    while !said.iter().any(|text: &String| text.contains("READY=1")) {
        let mut buffer = [0; 4096];
        let count = socket.recv(&mut buffer).expect("it becomes ready");
        said.push(String::from_utf8_lossy(&buffer[..count]).into_owned());
    }
    let more: u64 = said[0]
        .lines()
        .find_map(|line| line.strip_prefix("EXTEND_TIMEOUT_USEC="))
        .expect("a request for time")
        .parse()
        .unwrap();
    assert!(more >= 30_000_000, "{said:?}");
    for step in ["opening zenoh", "opening the database"] {
        assert!(said.iter().any(|text| text.contains(&format!("STATUS={step}"))), "{said:?}");
    }
}

/// A snapshot whose counters of estimates are at their end stands for a defect of the diagnosis that nobody knows yet.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_machine_on_which_the_diagnosis_fails_is_reported_and_stops_no_other() {
    /// Throws that complete both baselines and fill the longest window.
    const LEARNED: usize = 160;
    const FAILED: usize = 30;
    let (rig, daemon) = Rig::running();
    let throws = throws("boot", (LEARNED + FAILED) as u64);
    let (before, after) = throws.split_at(LEARNED);
    let logger = daemon.logger(KEY).await;
    logger.send(before.to_vec()).await;
    rig.judged(LEARNED).await;
    logger.close().await;
    daemon.terminate();
    let full = |side: u8| format!("'$.tracks.sides[{side}].since_baseline', json('{}')", u64::MAX);
    rig.change(format!("UPDATE monitor SET snapshot = json_set(snapshot, {}, {})", full(0), full(1))).await;

    let daemon = rig.start();
    let other = daemon.logger("points/v1/north/9/throw").await;
    let logger = daemon.logger(KEY).await;
    logger.send(after.to_vec()).await;
    other.send(before[..1].to_vec()).await;
    let history = rig.judged(LEARNED + FAILED + 1).await;
    let failed = history.iter().filter(|health| health.quality == "estimator_failed");
    assert_eq!(failed.count(), FAILED, "{history:?}");
    let of_other = history.iter().find(|health| health.machine.machine.as_str() == "9").unwrap();
    assert_eq!(of_other.quality, "good");
    rig.until_sql("SELECT 1 FROM active_alarms WHERE cause = 'not_monitored'").await;
    daemon.until_log("please report it");
}
