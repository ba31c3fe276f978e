//! A problem that hides a fault must be visible. A motor has lost 15 % of its torque constant, and each row of the
//! table hides this in another way. Within 20 throws an alarm, the state of the machine, the exit code of `pointsd
//! status` and a metric must show the problem.

use std::{fs, os::unix::fs::FileExt, time::Instant};

use pointsd::{
    simulate::{Fault, Part, Shape},
    throw::Throw,
};

use crate::{
    http::{KEY, address, get},
    rig::{Daemon, PATIENCE, Rig, faulty_throws},
};

/// Healthy throws for the baseline.
const HEALTHY: usize = 30;
/// Throws within which the problem must be visible.
const WITHIN: usize = 20;
const CONFIG: &str = "[diagnosis]\nbaseline_throws = 12\n[web]\nlisten = \"127.0.0.1:0\"\n";

/// Event of the daemon before the motor weakens.
#[derive(Clone, Copy, PartialEq)]
enum Before {
    Nothing,
    Maintenance,
    /// A clean stop, a broken page, and a start.
    BrokenPage,
    Deleted,
}

/// A way to hide a fault.
struct Row {
    name: &'static str,
    before: Before,
    /// Changes the throws of the weak motor, which follow those of the healthy motor.
    disguise: fn(&[Throw], &[Throw]) -> Vec<Throw>,
    /// Part of the text of an open alarm, or of `pointsd status` for maintenance.
    says: &'static str,
    /// A metric with a value other than 0.
    metric: &'static str,
}

const DATA_LOSS: &str = "pointsd_alarms_open{cause=\"data_loss\",severity=\"warning\"}";
const OWN: &str = "pointsd_alarms_open{cause=\"data_loss\",severity=\"critical\"}";

const ROWS: [Row; 8] = [
    Row {
        name: "maintenance without an end",
        before: Before::Maintenance,
        disguise: unchanged,
        says: "is in maintenance until ",
        metric: "pointsd_machine_states{state=\"maintenance\"}",
    },
    Row {
        name: "numbers of earlier throws",
        before: Before::Nothing,
        disguise: |_, weak| changed(weak, |at, throw| numbered(throw, at + 1)),
        says: "without a new boot_id",
        metric: DATA_LOSS,
    },
    Row {
        name: "a recorder that repeats two old traces",
        before: Before::Nothing,
        disguise: |sound, weak| changed(weak, |at, _| numbered(&sound[10 + at % 2], HEALTHY + 1 + at)),
        says: "repeats itself",
        metric: DATA_LOSS,
    },
    Row {
        name: "a failed temperature sensor",
        before: Before::Nothing,
        disguise: |_, weak| {
            let wrong = [-242.0, -273.15, 850.0, 1e6];
            changed(weak, |at, throw| Throw { temperature_c: Some(wrong[at % 4]), ..throw.clone() })
        },
        says: "motor",
        metric: "pointsd_alarms_open{cause=\"sensor\",severity=\"warning\"}",
    },
    Row {
        name: "a failed sensor of the supply voltage",
        before: Before::Nothing,
        disguise: |_, weak| {
            let wrong = [0.0, -3.0, 5000.0, 1e6];
            changed(weak, |at, throw| Throw { supply_v: Some(wrong[at % 4]), ..throw.clone() })
        },
        says: "sensor of the supply voltage reads",
        metric: "pointsd_alarms_open{cause=\"sensor\",severity=\"warning\"}",
    },
    Row {
        name: "a broken page",
        before: Before::BrokenPage,
        disguise: unchanged,
        says: "was broken and was set aside",
        metric: OWN,
    },
    Row {
        name: "the database deleted while the daemon runs",
        before: Before::Deleted,
        disguise: unchanged,
        says: "was deleted during operation",
        metric: OWN,
    },
    Row {
        name: "each trace five times",
        before: Before::Nothing,
        disguise: |_, weak| changed(weak, |at, _| numbered(&weak[at / 5], HEALTHY + 1 + at)),
        says: "repeats itself",
        metric: DATA_LOSS,
    },
];

fn unchanged(_: &[Throw], weak: &[Throw]) -> Vec<Throw> {
    weak.to_vec()
}

fn changed(throws: &[Throw], change: impl Fn(usize, &Throw) -> Throw) -> Vec<Throw> {
    throws.iter().enumerate().map(|(at, throw)| change(at, throw)).collect()
}

fn numbered(throw: &Throw, number: usize) -> Throw {
    let mut throw = throw.clone();
    throw.id.throw_no = number as u64;
    throw
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_problem_that_hides_faults_shows_within_twenty_throws() {
    let shown: Vec<_> = ROWS.iter().map(|row| tokio::spawn(show(row))).collect();
    for row in shown {
        row.await.unwrap();
    }
}

async fn show(row: &'static Row) {
    let fault = Fault { part: Part::Kt, shape: Shape::Step, size_pct: -15.0, from_throw: HEALTHY as u64 };
    let all = faulty_throws(fault, "boot", (HEALTHY + WITHIN) as u64);
    let (sound, weak) = all.split_at(HEALTHY);
    let (rig, daemon) = Rig::running_with(CONFIG);
    let logger = daemon.logger(KEY).await;
    logger.send(sound).await;
    rig.judged(HEALTHY).await;
    drop(logger);
    let daemon = apply_event(&rig, daemon, row.before);
    // The logger stays until the throws are judged: a session that closes may still hold some in its queue.
    let logger = daemon.logger(KEY).await;
    logger.send((row.disguise)(sound, weak)).await;
    rig.judged(HEALTHY + WITHIN).await;

    let web = address(&daemon);
    let deadline = Instant::now() + PATIENCE;
    loop {
        let unseen = unseen(row, &rig, &daemon, &web);
        if unseen.is_empty() {
            break;
        }
        assert!(Instant::now() < deadline, "{}: {unseen:#?}", row.name);
        tokio::time::sleep(std::time::Duration::from_millis(500)).await;
    }
    daemon.terminate();
}

fn apply_event(rig: &Rig, daemon: Daemon, before: Before) -> Daemon {
    match before {
        Before::Nothing => {}
        Before::Maintenance => {
            daemon.says(0, &["maintenance", "north/21B", "--why", "new chairs", "--by", "tester"]);
        }
        Before::BrokenPage => {
            daemon.terminate();
            let page = "SELECT max(pageno) AS page FROM dbstat WHERE name = 'trace' AND pagetype = 'leaf'";
            let page = rig.sql(page)[0]["page"].as_u64().unwrap();
            let file = fs::OpenOptions::new().write(true).open(rig.database()).unwrap();
            file.write_all_at(&[0x5a; 4096], (page - 1) * 4096).unwrap();
            return rig.start();
        }
        Before::Deleted => {
            for suffix in ["", "-wal", "-shm"] {
                fs::remove_file(rig.folder().join(format!("points.db{suffix}"))).unwrap();
            }
            daemon.until_log("the database moved to a new file");
        }
    }
    daemon
}

/// The signs of the problem that an operator does not see yet, each with the text seen instead.
fn unseen(row: &Row, rig: &Rig, daemon: &Daemon, web: &str) -> Vec<String> {
    let mut unseen = Vec::new();
    let mut see = |is_seen: bool, sign: &str, instead: String| {
        if !is_seen {
            unseen.push(format!("{sign}: {instead}"));
        }
    };
    let (code, text) = daemon.operate(&["status"]);
    see(code == Some(1), "exit code 1 of status", format!("{code:?} {text}"));
    let flat = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let alarms = format!("{:?}", rig.sql("SELECT text FROM active_alarms"));
    see(alarms.contains(row.says) || flat.contains(row.says), "alarm", format!("{alarms} {flat}"));
    let states = rig.sql("SELECT DISTINCT state FROM machine_health WHERE machine = '21B'");
    let is_well = states.iter().any(|state| state["state"] == "healthy" || state["state"] == "learning");
    see(states.len() == 1 && !is_well, "a state that is not healthy", format!("{states:?}"));
    let word = states.first().map(|state| state["state"].as_str().unwrap().replace('_', " ")).unwrap_or_default();
    let page = get(web, "/machines/north/21B").body;
    see(page.contains(&format!(" {word}</span>")), "the state on the page", page);
    let metrics = get(web, "/metrics").body;
    let counts = |line: &&str| line.strip_prefix(row.metric).is_some_and(|rest| rest.trim() != "0");
    see(metrics.lines().find(counts).is_some(), row.metric, metrics.clone());
    unseen
}
