//! The real daemon with the shipped cabinet configuration: a logger sends a throw over TLS, an alarm is raised, an
//! operator acknowledges it, and a viewer cannot.

use std::{fs, path::Path, process::Stdio};

use serde_json::Value;
use zenoh::Session;

use super::{
    rig::{Program, ends, free_address, has, matched, pointsd},
    site::*,
};

const ALARM: &str = "points/v1/north/21A/alarm";
const COMMAND: &str = "points/v1/north/21A/command";
const STATUS: &str = "points/v1/north/monitor/cabinet/status";

/// The shipped configuration with the database in `folder` and the listener at `address`.
fn configured(folder: &Path, address: &str) -> String {
    let text = cabinet_toml(&format!("tls/{address}"), None);
    let text = replaced(&text, "/var/lib/pointsd/", &format!("{}/", folder.display()));
    // One throw without an estimate raises an alarm.
    format!("{text}\n[diagnosis]\nnot_monitored_throws = 1\n")
}

/// The JSON replies to a query.
async fn ask_json(session: &Session, selector: &str, payload: Option<Value>) -> Vec<Value> {
    // All open alarms of a machine have the same key. Without `None`, zenoh returns only the last reply of a key.
    let mut get = session
        .get(selector)
        .consolidation(zenoh::query::ConsolidationMode::None)
        .timeout(std::time::Duration::from_secs(2));
    if let Some(payload) = payload {
        get = get.payload(payload.to_string());
    }
    let replies = get.await.unwrap();
    let mut values = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        if let Ok(sample) = reply.result() {
            values.push(serde_json::from_slice(&sample.payload().to_bytes()).unwrap());
        }
    }
    values
}

async fn until_answered(session: &Session, selector: &str) -> Vec<Value> {
    let mut values = Vec::new();
    until(selector, async || {
        values = ask_json(session, selector, None).await;
        !values.is_empty()
    })
    .await;
    values
}

#[tokio::test(flavor = "multi_thread")]
async fn the_real_daemon_takes_commands_from_operators_only() {
    if !has("openssl") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("pointsd.toml");
    let address = free_address().to_string();
    fs::write(&config, configured(folder.path(), &address)).unwrap();
    let daemon = pointsd(&["run", "--config"]).arg(&config).stderr(Stdio::inherit()).spawn();
    let _daemon = Program(daemon.unwrap());
    let endpoint = format!("tls/{address}");

    let viewer = client("viewer", &endpoint).await;
    let operator = client("operator", &endpoint).await;
    assert_eq!(until_answered(&viewer, STATUS).await[0]["stored"], 0);
    // The daemon declares its liveliness token after its queryables.
    until("the daemon is alive", async || {
        alive(&viewer, "points/v1/**/alive").await == ["points/v1/north/monitor/cabinet/alive"]
    })
    .await;

    let logger = client("logger.north.21A", &endpoint).await;
    let publisher = matched(&logger, THROW_A).await;
    until("the daemon knows that it is connected", async || {
        until_answered(&viewer, STATUS).await[0]["connected"] == true
    })
    .await;
    publisher.put(still_machine().to_string()).await.unwrap();

    let not_monitored = |alarms: Vec<Value>| alarms.into_iter().find(|alarm| alarm["cause"] == "not_monitored");
    let raised = not_monitored(until_answered(&viewer, ALARM).await).expect("the alarm is open");
    assert_eq!(raised["state"], "active_unacknowledged");
    let ack = serde_json::json!({"command": "ack", "cause": "not_monitored", "by": "test"});
    for (name, session) in [("viewer", &viewer), ("logger", &logger)] {
        assert!(ask_json(session, COMMAND, Some(ack.clone())).await.is_empty(), "the {name}'s command was answered");
    }
    let unchanged = not_monitored(until_answered(&viewer, ALARM).await);
    assert_eq!(unchanged.as_ref(), Some(&raised), "a command without permission changed the alarm");

    acknowledge(folder.path(), &endpoint);
    let reply = ask_json(&operator, COMMAND, Some(ack)).await;
    assert_eq!(reply[0]["done"], false, "acknowledged a moment before: {reply:?}");
    let acknowledged = not_monitored(until_answered(&viewer, ALARM).await).expect("the alarm is open");
    let question = "SELECT state, by_whom FROM alarm_events WHERE by_whom IS NOT NULL";
    let kept = ends(0, pointsd(&["sql", "--json", question, "--database"]).arg(folder.path().join("points.db")));
    let kept: Value = serde_json::from_str(&kept).unwrap();
    assert_eq!(kept, serde_json::json!([{"state": "active_acknowledged", "by_whom": "test"}]));
    assert_eq!(
        (&acknowledged["alarm_id"], &acknowledged["state"]),
        (&raised["alarm_id"], &"active_acknowledged".into())
    );
}

/// Runs `pointsd ack` with the file `operator.toml` that INSTALL.md shows.
fn acknowledge(folder: &Path, endpoint: &str) {
    let page = read("INSTALL.md");
    let (_, rest) = page.split_once("```toml\n").expect("the page shows operator.toml");
    let (text, _) = rest.split_once("```").expect("it ends");
    let text = replaced(text, "tls/cabinet-north.example:7447", endpoint);
    let text = replaced(&text, "/root/pki/operator/", &format!("{}/", railway().folder("operator").display()));
    let config = folder.join("operator.toml");
    fs::write(&config, text).unwrap();
    let ack = ["ack", "north/21A", "not_monitored", "--by", "test", "--config"];
    ends(0, pointsd(&ack).arg(config));
}

/// A throw without movement.
fn still_machine() -> Value {
    serde_json::json!({
        "schema": "points.throw/1", "boot_id": "first", "throw_no": 1, "started_at": "2026-01-01T06:00:00Z",
        "direction": "normal_to_reverse", "sample_rate_hz": 1000,
        "current_a": vec![0.0; 2000], "position_mm": vec![0.0; 2000],
    })
}

#[test]
fn every_shipped_configuration_of_pointsd_is_valid() {
    if !has("openssl") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let installed = replaced(&read("pointsd.toml"), "/var/lib/pointsd/", &format!("{}/", folder.path().display()));
    for text in [configured(folder.path(), "127.0.0.1:7447"), installed] {
        let config = folder.path().join("pointsd.toml");
        fs::write(&config, text).unwrap();
        ends(0, pointsd(&["check", "--config"]).arg(&config));
    }
}

#[test]
fn a_missing_or_damaged_key_file_is_a_wrong_configuration_and_is_named() {
    if !has("openssl") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("pointsd.toml");
    let whole = configured(folder.path(), "127.0.0.1:7447");
    let good = railway().folder("cabinet.north");
    let good = |file: &str| good.join(file).display().to_string();
    // Checks the configuration with one of its files replaced.
    let complaint = |file: &str, other: &str| {
        fs::write(&config, replaced(&whole, &good(file), other)).unwrap();
        ends(78, pointsd(&["check", "--config"]).arg(&config))
    };
    let missing = complaint("key.pem", "/nowhere/key.pem");
    assert!(missing.contains("zenoh.transport.link.tls.") && missing.contains("/nowhere/key.pem"), "{missing}");
    // Each without its last line, and each with other bytes in its first line of base64.
    for (at, file) in ["ca.pem", "cert.pem", "key.pem"].into_iter().enumerate() {
        let text = fs::read_to_string(good(file)).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let mut other = lines.clone();
        let wrong = "A".repeat(lines[1].len());
        other[1] = &wrong;
        for (kind, lines) in [("short", &lines[..lines.len() - 1]), ("other", &other)] {
            let path = folder.path().join(format!("{kind}-{file}"));
            fs::write(&path, lines.join("\n")).unwrap();
            let said = complaint(file, &path.display().to_string());
            let key = ["root_ca_certificate", "_certificate", "_private_key"][at];
            assert!(said.contains(key) && said.contains(&path.display().to_string()), "{said}");
        }
    }
    let swapped = complaint("cert.pem", &good("key.pem"));
    assert!(swapped.contains("_certificate") && swapped.contains("has no certificate in PEM"), "{swapped}");
    let swapped = complaint("key.pem", &good("cert.pem"));
    assert!(swapped.contains("_private_key") && swapped.contains("has no private key in PEM"), "{swapped}");
}
