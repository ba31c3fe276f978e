//! Logger, daemon and operators as separate processes.

use std::{io::Read, process::Stdio};

use pointsd::{
    bus,
    diagnose::{Cause, Command},
    throw::{Throw, Trace},
    wire::{Alarm, HistoryQuery},
};
use zenoh::Wait;

use crate::{
    http::KEY,
    region::router,
    rig::{Daemon, PATIENCE, Rig, ends, listen, next, pointsd, pointsim, run_with_closed_pipe, stub, throws},
};

/// Publishes the throws of simulated machines with `pointsim run`, and waits until all are sent.
pub(crate) fn logger(endpoint: &str, arguments: &[&str]) {
    let mut child = pointsim(&["run", "--connect", endpoint, "--time-scale", "100000"])
        .args(arguments)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    assert!(child.wait().unwrap().success());
}

/// The report of `pointsd status`, which ends with this exit code.
#[track_caller]
fn status(daemon: &Daemon, exit: i32) -> serde_json::Value {
    serde_json::from_str(&daemon.says(exit, &["status", "--json"])).unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_fault_becomes_an_alarm_that_operators_see_and_handle() {
    let (rig, daemon) = Rig::running();
    let session = daemon.client().await;
    let alarms = listen(&session).await;
    logger(&daemon.endpoint, &["--machines", "2", "--throws", "50", "--fault", "1:kt:-25:36", "--seed", "1"]);

    let (key, alarm) = next(&alarms).await;
    assert_eq!((key.as_str(), alarm.cause, alarm.event_no), ("points/v1/north/machine-1/alarm", Cause::Kt, 1));

    let text = daemon.says(0, &["alarms", "--json"]);
    let open: Alarm = serde_json::from_str(text.lines().next().unwrap()).unwrap();
    assert_eq!(open.alarm_id, alarm.alarm_id);
    let text = daemon.says(1, &["status", "--json", "--site", "north", "--state", "critical"]);
    let status_of: serde_json::Value = serde_json::from_str(&text).unwrap();
    for of in ["health", "alarms"] {
        let of_one = |values: &Vec<serde_json::Value>| values.iter().all(|value| value["machine"] == "machine-1");
        assert!(status_of[of].as_array().is_some_and(|values| !values.is_empty() && of_one(values)), "{of}: {text}");
    }
    daemon.says(69, &["status", "--json", "--site", "south"]);

    daemon.says(0, &["ack", "north/machine-1", "kt", "--by", "tester"]);
    let text = daemon.says(1, &["ack", "north/machine-1", "kt", "--by", "another"]);
    assert!(text.contains("tester"), "{text}");
    daemon.says(1, &["ack", "north/machine-2", "kt", "--by", "tester"]);
    daemon.says(0, &["shelve", "north/machine-1", "kt", "--for", "8h", "--why", "at work", "--by", "tester"]);
    daemon.says(0, &["rebaseline", "north/machine-1", "--why", "new motor", "--by", "tester"]);
    let text = daemon.says(0, &["alarms", "--limit", "100", "--json"]);
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
    assert_eq!(of("command"), ["ack", "shelve", "rebaseline"], "rejected commands are not stored: {kept:?}");
    assert_eq!(of("cause"), ["kt", "kt", "-"]);
    assert_eq!(of("why"), ["-", "at work", "new motor"]);
    assert_eq!(of("by_whom"), ["tester"; 3]);

    let status = status(&daemon, 0);
    assert_eq!(status["daemons"][0]["stored"], 100);
    assert_eq!(status["health"].as_array().unwrap().len(), 4, "two machines, two directions");
    // The changes from the discarded baseline are history.
    let health = status["health"].as_array().unwrap().iter();
    let known = health.map(|row| (row["machine"].as_str().unwrap(), row["b0_pct"].is_number())).collect::<Vec<_>>();
    assert_eq!(known, [("machine-1", false), ("machine-1", false), ("machine-2", true), ("machine-2", true)]);
    let count = |view: &str| rig.number(&format!("SELECT count(b0_pct) FROM {view} WHERE machine = 'machine-1'"));
    assert!(count("machine_health") == 0 && count("health_history") > 0);
    maintenance_is_visible(&rig, &daemon);
    daemon.terminate();
    let rows = rig.sql("SELECT machine, count(*) AS n FROM health_history WHERE quality = 'good' GROUP BY machine");
    let others = rig.sql("SELECT machine, throw_no, quality FROM health_history WHERE quality <> 'good'");
    assert_eq!(rows.iter().map(|row| row["n"].as_i64().unwrap()).collect::<Vec<_>>(), [50, 50], "{others:?}");
}

/// A machine in maintenance is visible in `status` and its exit code, in health and in SQL, and its window has an end.
fn maintenance_is_visible(rig: &Rig, daemon: &Daemon) {
    daemon.says(0, &["maintenance", "north/machine-2", "--why", "new chairs", "--by", "tester"]);
    // A machine in maintenance needs attention.
    let status = status(daemon, 1);
    assert_eq!(status["daemons"][0]["machines"]["maintenance"], 1, "{status}");
    let states = |machine: &str| -> Vec<serde_json::Value> {
        let health = status["health"].as_array().unwrap().iter();
        health.filter(|health| health["machine"] == machine).map(|health| health["state"].clone()).collect()
    };
    assert_eq!(states("machine-2"), ["maintenance", "maintenance"]);
    assert_eq!(states("machine-1"), ["learning", "learning"]);
    // A name is not wrapped in a pipe.
    let (_, text) = daemon.operate(&["status"]);
    assert!(text.lines().any(|line| line.contains("north/machine-2") && line.contains(" reverse ")), "{text}");
    let rows = rig.sql("SELECT DISTINCT state FROM machine_health WHERE machine = 'machine-2'");
    assert_eq!(rows[0]["state"], "maintenance");
    let commands = rig.sql("SELECT until FROM operator_commands WHERE command = 'maintenance_start'");
    assert!(commands[0]["until"].is_string(), "the window has no end: {commands:?}");
}

/// A machine that was removed from the track sends no more throws. That is no alarm once the machine is retired.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_retired_machine_is_left_out_until_its_next_throw() {
    let (rig, daemon) = Rig::running();
    logger(&daemon.endpoint, &["--machines", "2", "--throws", "50", "--fault", "1:kt:-25:36", "--seed", "1"]);
    daemon.says(0, &["maintenance", "north/machine-1", "--why", "removal", "--by", "tester"]);
    let session = daemon.client().await;
    let token = session.liveliness().declare_token("points/v1/north/machine-1/alive").await.unwrap();
    daemon.until_status("the logger", |status| status["loggers"] == 1).await;
    let retire = ["retire", "north/machine-1", "--why", "replaced", "--by", "tester"];
    let said = daemon.says(1, &retire);
    assert!(said.contains("the logger of north/machine-1 is connected"), "{said}");
    token.undeclare().await.unwrap();
    daemon.until_status("no logger", |status| status["loggers"] == 0).await;
    let said = daemon.says(0, &retire);
    assert!(said.contains("no longer monitored, retired by tester: replaced") && said.contains("motor"), "{said}");
    let said = daemon.says(1, &retire);
    assert!(said.contains("no machine north/machine-1 is known here"), "{said}");

    let is_left_out = |daemon: &Daemon| {
        let status = status(daemon, 0);
        let machines = status["health"].as_array().unwrap().iter().map(|row| row["machine"].as_str().unwrap());
        assert_eq!(machines.collect::<Vec<_>>(), ["machine-2"; 2], "{status}");
        assert_eq!(status["daemons"][0]["machines"], serde_json::json!({"healthy": 1}), "{status}");
        daemon.says(0, &["alarms", "--check"]);
    };
    is_left_out(&daemon);
    let count = |view: &str| rig.number(&format!("SELECT count(*) FROM {view} WHERE machine = 'machine-1'"));
    assert_eq!(["machine_health", "active_alarms", "health_history"].map(count), [0, 0, 50]);
    let last = &rig.sql("SELECT state, text FROM alarm_events WHERE machine = 'machine-1' ORDER BY event_at DESC")[0];
    let text = last["text"].as_str().unwrap();
    assert!(last["state"] == "normal" && text.ends_with("is no longer monitored (tester: replaced)."), "{last}");
    let page = ends(0, pointsd(&["report", "north/machine-1", "--out", "-", "--database"]).arg(rig.database()));
    assert!(
        page.contains("it is not monitored, as it was retired at") && page.contains("by tester: replaced."),
        "{page}"
    );
    daemon.terminate();

    let daemon = rig.start();
    is_left_out(&daemon);
    let again = daemon.logger("points/v1/north/machine-1/throw").await;
    again.send([&throws("new boot", 1)[0]]).await;
    rig.judged(101).await;
    assert_eq!(count("machine_health"), 1, "a new machine");
    let text = daemon.says(0, &["status"]);
    assert!(text.contains("2 machines: ") && text.contains("north/machine-1  learning"), "{text}");
}

/// A flood of commands cannot displace the record of other commands.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_of_commands_is_refused_after_the_first_two_hundred() {
    let (_rig, daemon) = Rig::running();
    let session = daemon.client().await;
    let ack = serde_json::to_vec(&Command::Ack { cause: Cause::Kt, by: "tester".to_owned() }).unwrap();
    let mut carried_out = 0;
    loop {
        let replies = bus::ask(&session, "points/v1/north/21B/command", Some(ack.clone()), PATIENCE).await.unwrap();
        let said = String::from_utf8_lossy(&replies.messages[0].1).into_owned();
        if said.contains("too many commands at once") {
            break;
        }
        assert!(said.contains("it has sent no throw yet"), "{said}");
        carried_out += 1;
        assert!(carried_out < 400, "no command is refused");
    }
    assert!(carried_out >= 200, "only {carried_out} commands");
}

/// Every operator command for a machine.
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

/// Runs every command in parallel; returns their exit codes and stderr. Stdout must be empty.
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
async fn without_a_daemon_operators_get_an_error() {
    for (arguments, (code, said)) in COMMANDS.iter().zip(all_commands("tcp/127.0.0.1:1")) {
        assert_eq!(code, Some(69), "{arguments:?}: {said}");
        assert!(
            said.starts_with("error: no answer from ") && said.contains("Is pointsd running?"),
            "{arguments:?}: {said}"
        );
    }
    // A router without a daemon behind it.
    let (_router, endpoint) = router().await;
    for (arguments, (code, said)) in COMMANDS.iter().zip(all_commands(&endpoint)) {
        assert_eq!(code, Some(69), "{arguments:?}: {said}");
        assert!(said.starts_with("error: no daemon answers"), "{arguments:?}: {said}");
        assert_eq!(said.lines().count(), 1, "{arguments:?}: {said}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_machine_that_no_daemon_serves_is_distinguished_from_no_daemon() {
    let (_rig, daemon) = Rig::running_with("[subscribe]\nkey = \"points/v1/south/**\"\n");
    let said = daemon.says(69, &["ack", "north/21B", "kt", "--by", "tester"]);
    assert!(said.contains("no daemon serves north/21B"), "{said}");
    let said = daemon.says(1, &["ack", "south/21B", "kt", "--by", "tester"]);
    assert!(said.contains("no machine south/21B is known here"), "{said}");
    // The name of the common alarms of a site.
    let said = daemon.says(1, &["rebaseline", "south/all-machines", "--why", "new motor", "--by", "tester"]);
    assert!(said.contains("south/all-machines is no machine with throws"), "{said}");
    // No reply is an error, not an empty list.
    let said = daemon.says(69, &["alarms", "north/21B"]);
    assert!(said.contains("no daemon knows north/21B"), "{said}");
}

/// The answers of the other daemons are shown, and that one daemon has no answer or one of another version.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_error_or_an_unreadable_answer_of_one_daemon_is_shown_beside_the_others() {
    let (_rig, daemon) = Rig::running();
    daemon.says(0, &["status"]);
    daemon.says(0, &["alarms", "--check"]);
    let said = daemon.says(64, &["alarms", "--limit", "0"]);
    assert!(!said.contains("no alarms"), "{said}");
    let said = daemon.says(69, &["status", "--site", "nosite"]);
    assert!(
        said.contains("no machine of site nosite is known to fleet/pointsd;") && !said.contains("no alarms"),
        "{said}"
    );
    for (bogus, says) in [("bogus", "write tcp/HOST:PORT"), ("udp/[::1]:7447", "tcp and tls only"), ("tcp/a", "port")] {
        let error = ends(64, &mut pointsd(&["status", "--connect", bogus]));
        assert!(error.contains(says), "{error}");
    }
    let session = daemon.client().await;
    let other = session.declare_queryable("points/v1/east/monitor/other/status").await.unwrap();
    let broken = session.declare_queryable("points/v1/east/m1/alarm").await.unwrap();
    let answering = tokio::spawn(async move {
        loop {
            tokio::select! {
                Ok(query) = other.recv_async() => query.reply("points/v1/east/monitor/other/status", "{}").await.unwrap(),
                Ok(query) = broken.recv_async() => query.reply_err("the database does not answer").await.unwrap(),
                else => break,
            }
        }
    });
    let said = daemon.says(1, &["status"]);
    assert!(said.contains("fleet/pointsd: version"), "{said}");
    assert!(said.contains("unreadable reply of points/v1/east/monitor/other/status"), "{said}");
    assert!(said.contains("no answer of a daemon: the database does not answer"), "{said}");
    // While one daemon cannot answer, "no alarms" would be wrong.
    for (arguments, expected) in [(&["alarms", "--check"][..], 1), (&["alarms"], 69), (&["alarms", "--json"], 69)] {
        let said = daemon.says(expected, arguments);
        assert!(
            said.contains("the database does not answer") && !said.lines().any(|line| line == "no alarms"),
            "{said}"
        );
    }
    answering.abort();
}

/// An alarm event of a machine at site `east`.
fn event(machine: &str, hour: u8, severity: &str) -> String {
    let at = format!("2026-05-04T{hour}:00:00Z");
    serde_json::json!({
        "schema": "points.alarm/1", "alarm_id": at, "event_no": 1, "site": "east", "machine": machine, "cause": "kt",
        "severity": severity, "state": "active_unacknowledged", "raised_at": at, "event_at": at, "change_pct": null,
        "change_pct_sd": null, "direction": null, "runner_up": null, "correlation": null, "first_throw_no": null,
        "last_throw_no": null, "text": "weak", "limit_in_throws": null,
    })
    .to_string()
}

/// The name `all-machines` has no state, so the problem is in the list of alarms only.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_common_alarm_of_a_site_is_a_problem_in_the_status() {
    let (_rig, daemon) = Rig::running();
    daemon.says(0, &["status"]);
    let session = daemon.client().await;
    let key = "points/v1/east/all-machines/alarm";
    let alarm = event("all-machines", 10, "warning");
    let on_query = move |query: zenoh::query::Query| query.reply(key, alarm.clone()).wait().unwrap();
    session.declare_queryable(key).callback(on_query).background().await.unwrap();
    let said = daemon.says(1, &["status"]);
    assert!(said.contains("east/all-machines"), "{said}");
}

/// Two daemons with three events at 10, 11 and 12 h, of which the first is critical.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_newest_events_of_several_daemons_are_in_order_and_selected_before_they_are_cut() {
    let (_rig, daemon) = Rig::running();
    let session = daemon.client().await;
    let event = |hour: u8, severity: &str| event("m1", hour, severity);
    for (key, events) in [
        ("points/v1/east/m1/alarm", vec![event(10, "critical"), event(12, "warning")]),
        ("points/v1/east/m2/alarm", vec![event(11, "warning")]),
    ] {
        let on_query = move |query: zenoh::query::Query| {
            let Ok(HistoryQuery::History { limit, .. }) = HistoryQuery::parse(query.parameters().as_str()) else {
                return;
            };
            for event in events.iter().rev().take(limit as usize).rev() {
                query.reply(key, event.clone()).wait().unwrap();
            }
        };
        session.declare_queryable(key).callback(on_query).background().await.unwrap();
    }
    for (arguments, hours) in [
        (&["--since", "2026-05-04"][..], &["10", "11", "12"][..]),
        (&["--limit", "2"], &["11", "12"]),
        (&["--limit", "1", "--severity", "critical"], &["10"]),
    ] {
        let text = daemon.says(0, &[&["alarms", "--json"], arguments].concat());
        let shown: Vec<&str> = text.lines().map(|line| line.split("T1").nth(1).unwrap()).collect();
        let expected: Vec<&str> = hours.iter().map(|hour| &hour[1..]).collect();
        assert_eq!(shown.iter().map(|line| &line[..1]).collect::<Vec<_>>(), expected, "{arguments:?}: {text}");
    }
    // A daemon sends at most 10,000 events.
    daemon.says(64, &["alarms", "--limit", "20000"]);
    let (key, one) = ("points/v1/east/m3/alarm", event(13, "warning"));
    let on_query = move |query: zenoh::query::Query| {
        let limit = query.parameters().get("limit").map_or(0, |limit| limit.parse().unwrap());
        (0..limit).for_each(|_| query.reply(key, one.clone()).wait().unwrap());
    };
    session.declare_queryable(key).callback(on_query).background().await.unwrap();
    for (arguments, is_warned) in [(&["--severity", "critical"][..], true), (&[], false)] {
        let text = daemon.says(0, &[&["alarms", "--limit", "1"], arguments].concat());
        assert_eq!(text.contains("older ones may be missing"), is_warned, "{arguments:?}: {text}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_key_with_wildcards_selects_its_machines_before_the_limit() {
    let (rig, daemon) = Rig::running();
    let session = daemon.client().await;
    for (site, throws) in [("north", 4), ("south", 6)] {
        let logger = daemon.logger(&format!("points/v1/{site}/21B/throw")).await;
        logger.send((1..=throws).map(|throw_no| stub("boot", throw_no))).await;
        rig.until_number(&format!("SELECT count(*) FROM health_history WHERE site = '{site}'"), throws).await;
    }
    for (key, found) in [
        ("points/v1/north/*/health", 3),
        ("points/v1/north/**/health", 3),
        ("points/v1/n$*/2$*B/health", 3),
        ("points/v1/**/21B/health", 3),
        ("points/v1/**/22A/health", 0),
    ] {
        let answers = bus::ask(&session, &format!("{key}?limit=3"), None, PATIENCE).await.unwrap();
        assert_eq!(answers.messages.len(), found, "{key}: {answers:?}");
    }
    // All keys of a machine: the queryable for commands does not answer a query without a command.
    let all = bus::ask(&session, "points/v1/north/21B/*", None, PATIENCE).await.unwrap();
    assert!(all.messages.len() == 1 && all.errors.is_empty(), "{all:?}");
    // A query for the history is no wrong query for commands or for the status.
    for (selector, is_wrong) in [
        ("points/v1/north/21B/*?limit=10", false),
        ("points/v1/**?limit=10", false),
        ("points/v1/*/monitor/*/status?limit=10", true),
        ("points/v1/north/21B/command?limit=10", true),
        // The limit is applied before the keys are compared.
        ("points/**/21B/**?limit=10", true),
    ] {
        let all = bus::ask(&session, selector, None, PATIENCE).await.unwrap();
        assert_eq!((all.messages.is_empty(), !all.errors.is_empty()), (is_wrong, is_wrong), "{selector}: {all:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sighup_applies_the_settings_that_need_no_restart() {
    let (rig, daemon) = Rig::running();
    let session = daemon.client().await;
    let alarms = listen(&session).await;
    Rig::with("[monitor]\nid = \"later\"\n[machines]\nstroke_mm = 200.0\n").in_folder(rig.folder()).write_config();
    daemon.signal("-HUP");
    daemon.until_log("changes in monitor take effect at the next start");
    // The toe moves by 115 mm: a complete throw without a stroke in the configuration.
    let logger = daemon.logger(KEY).await;
    logger.send(throws("boot", 1)).await;
    assert_eq!(next(&alarms).await.1.cause, Cause::IncompleteThrow);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_unknown_machine_is_an_error_and_not_an_empty_list() {
    let (_rig, daemon) = Rig::running();
    logger(&daemon.endpoint, &["--machines", "1", "--throws", "2"]);
    for (machine, code, says) in [
        ("north/machine-1", 0, "no alarms"),
        ("fleet/pointsd", 0, "no alarms"),
        ("north/machine-7", 69, "no daemon knows north/machine-7"),
    ] {
        let text = daemon.says(code, &["alarms", machine]);
        assert!(text.contains(says), "{machine}: {text}");
    }
}

/// A daemon with this name on its own port, with an open motor alarm on north/machine-1.
pub(crate) fn daemon_with_alarm(id: &str, extra: &str) -> (Rig, Daemon) {
    let rig = Rig::with(&format!("[monitor]\nid = {id:?}\n{extra}")).same_port();
    let daemon = rig.start();
    logger(&daemon.endpoint, &["--machines", "1", "--throws", "50", "--fault", "1:kt:-25:36"]);
    (rig, daemon)
}

/// State of the alarm, and number of operator commands.
fn state(rig: &Rig) -> (String, usize) {
    let alarms = rig.sql("SELECT state FROM active_alarms WHERE cause = 'kt'");
    (alarms[0]["state"].as_str().unwrap().to_owned(), rig.sql("SELECT * FROM operator_commands").len())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_command_with_a_daemons_configuration_reaches_that_daemon_and_no_other() {
    let (rig_a, a) = daemon_with_alarm("a", "");
    let (rig_b, b) = daemon_with_alarm("b", "");
    let of_b = rig_b.write_config().display().to_string();

    let text = ends(0, &mut pointsd(&["ack", "north/machine-1", "kt", "--by", "tester", "--config", &of_b]));
    assert!(text.starts_with("fleet/b: "), "{text}");
    assert_eq!(state(&rig_b), ("active_acknowledged".to_owned(), 1));
    assert_eq!(state(&rig_a), ("active_unacknowledged".to_owned(), 0));
    let rebaseline = ["rebaseline", "north/machine-1", "--why", "x", "--by", "tester", "--json", "--config", &of_b];
    let reply: serde_json::Value = serde_json::from_str(&ends(0, &mut pointsd(&rebaseline))).unwrap();
    assert_eq!(reply["monitor"], "fleet/b", "{reply}");
    for question in ["status", "alarms"] {
        let text = ends(0, &mut pointsd(&[question, "--config", &of_b]));
        assert!(text.contains("fleet/") && !text.contains("fleet/a") && !text.contains("monitor/a"), "{text}");
    }

    // B has stopped, and A listens at its address: every command reports this and sends nothing.
    b.terminate();
    a.terminate();
    let moved = rig_a.listening_like(&rig_b);
    let a = moved.start();
    for arguments in COMMANDS {
        let text = ends(69, pointsd(arguments).args(["--config", &of_b]));
        assert!(text.contains("the configuration is that of fleet/b, but only fleet/a is connected there"), "{text}");
    }
    assert_eq!(state(&moved), ("active_unacknowledged".to_owned(), 0));
    a.terminate();
    for arguments in COMMANDS {
        let text = ends(69, pointsd(arguments).args(["--config", &of_b]));
        assert!(text.contains("no answer from tcp/127.0.0.1:"), "{text}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_machine_that_two_daemons_serve_takes_no_command() {
    let (rig_a, a) = daemon_with_alarm("a", "");
    // The second daemon is connected to the first, and serves the same machines.
    let (rig_b, _b) = daemon_with_alarm("b", &format!("[zenoh.connect]\nendpoints = [{:?}]\n", a.endpoint));
    a.until_status("link", |status| status["connected"] == true).await;
    for config in [rig_a.write_config(), rig_b.write_config()] {
        let text = ends(69, pointsd(&["ack", "north/machine-1", "kt", "--by", "tester", "--config"]).arg(config));
        assert!(text.contains("several daemons serve north/machine-1") && text.contains("fleet/a"), "{text}");
        assert!(text.contains("fleet/b"), "{text}");
    }
    for rig in [&rig_a, &rig_b] {
        assert!(rig.sql("SELECT * FROM operator_commands").is_empty(), "nothing was carried out");
    }
}

/// Zenoh closes the link of a daemon that hangs while a query waits for its reply. The query then ends without an
/// error, as if that daemon had no alarms.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_daemon_that_hangs_is_reported_and_not_taken_for_one_without_alarms() {
    let (_rig_a, a) = Rig::running_with("[monitor]\nid = \"a\"\n");
    let connect = format!("[monitor]\nid = \"b\"\n[zenoh.connect]\nendpoints = [{:?}]\n", a.endpoint);
    let (_rig_b, b) = Rig::running_with(&connect);
    a.until_status("link", |status| status["connected"] == true).await;
    let check = |exit| ends(exit, &mut pointsd(&["alarms", "--check", "--connect", &a.endpoint]));
    assert!(check(0).contains("answered by fleet/a, fleet/b"));
    b.signal("-STOP");
    let said = check(1);
    b.signal("-CONT");
    assert!(said.contains("no answer of the daemon fleet/b"), "{said}");
}

/// A closed pipe ends the command without an error, and without a change of its result.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_closed_pipe_ends_a_command_quietly_and_lines_fit_the_terminal() {
    let (rig, daemon) = daemon_with_alarm("a", "");
    daemon.until_status("the states of the machines", |status| status["machines"]["critical"] == 1).await;
    let commands: [(&[&str], i32); 5] = [
        (&["status"], 1),
        (&["alarms"], 0),
        (&["alarms", "--check"], 1),
        (&["alarms", "--json"], 0),
        (&["alarms", "--since", "2026-01-01"], 0),
    ];
    for (arguments, result) in commands {
        let output = run_with_closed_pipe(pointsd(arguments).args(["--connect", &daemon.endpoint]));
        assert!(output.stderr.is_empty(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(output.status.code(), Some(result), "{arguments:?}");
        let (_, text) = daemon.operate(arguments);
        let widest = text.lines().map(|line| line.chars().count()).max().unwrap();
        assert!(widest <= 80 || arguments.contains(&"--json"), "{arguments:?} is {widest} wide: {text}");
    }
    let mut watch = pointsd(&["status", "--watch", "--connect", &daemon.endpoint]);
    let mut watch = watch.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut start = [0; 7];
    // The pipe is closed after the first line.
    watch.stdout.take().unwrap().read_exact(&mut start).unwrap();
    let output = watch.wait_with_output().unwrap();
    assert_eq!(&start, b"fleet/a", "--watch clears terminals only");
    assert_eq!((output.status.code(), String::from_utf8_lossy(&output.stderr).as_ref()), (Some(0), ""));
    let text = daemon.says(1, &["alarms", "--check"]);
    assert!(text.contains("now -") && text.contains("(95 %)") && text.contains("not acknowledged"), "{text}");
    let arguments = ["shelve", "north/machine-1", "motor", "--for", "3d", "--why", "parts ordered", "--by", "tester"];
    let text = daemon.says(0, &arguments);
    assert!(text.starts_with("fleet/a: the motor alarm of north/machine-1 is shelved until "), "{text}");
    assert!(text.trim_end().ends_with("by tester: parts ordered"), "{text}");
    for command in ["alarms", "status"] {
        let (_, text) = daemon.operate(&[command]);
        let flat = text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(flat.contains("shelved until ") && flat.contains("by tester: parts ordered"), "{command}: {text}");
    }
    let sql =
        |exit: i32, question: &[&str]| ends(exit, pointsd(&["sql", "--database"]).arg(rig.database()).args(question));
    let text = sql(0, &["SELECT 2 AS b, 1.0/3 AS c"]);
    assert_eq!(text.split_whitespace().collect::<Vec<_>>(), ["b", "c", "2", "0.333333"], "{text}");
    let text = sql(0, &[]);
    assert!(text.contains("operator_commands") && text.contains("change_now_pct"), "{text}");
    let text = sql(65, &["SELECT b9 FROM health_history"]);
    assert_eq!(text.matches("no such column").count(), 1, "{text}");
}

/// A throw whose toe stops half way, while the motor runs on.
fn obstructed() -> Throw {
    let [whole] = &throws("boot", 1)[..] else { panic!("one throw") };
    let (current_a, mut position_mm) = (whole.trace.current_a().to_vec(), whole.trace.position_mm().to_vec());
    let half_way = position_mm.len() / 2;
    let reached = position_mm[half_way];
    // With noise: exactly equal values would be those of a stuck sensor.
    let noise_mm: Vec<f64> = position_mm[..half_way].iter().map(|mm| 1e3 * mm % 0.05).collect();
    position_mm[half_way..].iter_mut().zip(noise_mm.iter().cycle()).for_each(|(mm, noise_mm)| *mm = reached + noise_mm);
    let trace = Trace::new(whole.trace.sample_rate_hz(), current_a, position_mm).unwrap();
    Throw { trace, ..whole.clone() }
}

/// The daemon counts its machines every few seconds; an alarm counts at once.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_exit_code_of_status_includes_an_alarm_raised_just_now() {
    let (_rig, daemon) = Rig::running_with("[machines]\nstroke_mm = 115.0\n");
    let session = daemon.client().await;
    let alarms = listen(&session).await;
    let logger = daemon.logger(KEY).await;
    logger.send([obstructed()]).await;
    assert_eq!(next(&alarms).await.1.cause, Cause::IncompleteThrow);
    daemon.says(1, &["status"]);
}

/// A trigger stands for a schema that another program has changed.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_alarm_that_the_database_rejects_is_counted_and_stated() {
    let (rig, daemon) = Rig::running_with("[machines]\nstroke_mm = 115.0\n");
    rig.change(
        "CREATE TRIGGER reject BEFORE INSERT ON alarm WHEN NEW.cause = 'incomplete_throw' \
         BEGIN SELECT RAISE(ABORT, 'no such cause'); END",
    )
    .await;
    let logger = daemon.logger(KEY).await;
    logger.send([obstructed()]).await;
    daemon.until_status("the rejection", |status| status["alarm_events_lost"] == 1).await;
    daemon.until_log("an alarm event is LOST: ");
    rig.until_sql("SELECT 1 FROM active_alarms WHERE cause = 'data_loss' AND text LIKE '%rejects alarm events%'").await;
    assert!(daemon.says(1, &["status"]).contains("1 alarm event LOST"));
}
