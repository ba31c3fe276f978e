//! The process under test: it stores and judges throws of four machines, with alarms, at full speed. A reader may keep
//! an old state open at the same time.

use std::{
    fs::{File, OpenOptions},
    io::Write,
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::{Arc, Mutex},
};

use crate::given::{at, event, judgement, machine, outcome, reading, throw};
use pointsd::{
    diagnose::{AlarmEvent, AlarmState},
    store::{Judgement, Settings, Spooled, Store, ThrowRow},
    wire::alarm_id,
};

pub(super) const FOLDER: &str = "POINTSD_WORKER_FOLDER";
/// Environment variable: number of throws of each machine.
pub(super) const THROWS: &str = "POINTSD_WORKER_THROWS";
/// Environment variable: if it is set, a reader keeps an old state open during the second half of the throws.
pub(super) const HOLDER: &str = "POINTSD_WORKER_HOLDER";

const MACHINES: [&str; 4] = ["21A", "21B", "22A", "22B"];
/// Number of tries of each call: the daemon repeats failed calls too.
const TRIES: usize = 3;

/// Writes acknowledgements to a file for the parent, each in one write, so that the log of the shim has them in order.
#[derive(Clone)]
struct Acknowledge(Arc<Mutex<File>>);

impl Acknowledge {
    fn say(&self, line: &str) {
        self.0.lock().unwrap().write_all(format!("{line}\n").as_bytes()).unwrap();
    }
}

/// Runs the worker with the shim on a database in `folder`, with these environment variables.
pub(super) fn run_below(library: &Path, folder: &Path, variables: &[(&str, &str)]) -> Output {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "power::worker::run", "--nocapture"])
        .env("LD_PRELOAD", library)
        .env("SHIM_MATCH", folder.join("points.db"))
        .env(FOLDER, folder)
        .envs(variables.iter().copied())
        .output()
        .unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn run() {
    let Some(folder) = std::env::var_os(FOLDER).map(PathBuf::from) else { return };
    let throws = std::env::var(THROWS).map_or(60, |throws| throws.parse().unwrap());
    let Some(store) = open(&folder).await else { return };
    let file = OpenOptions::new().create(true).append(true).open(folder.join("points.db.ack")).unwrap();
    let acknowledge = Acknowledge(Arc::new(Mutex::new(file)));
    let half = MACHINES.map(|name| tokio::spawn(machine_life(store.clone(), acknowledge.clone(), name, 1, throws / 2)));
    for life in half {
        life.await.unwrap();
    }
    let holder = match std::env::var_os(HOLDER) {
        Some(_) => Some(reading(&store).await),
        None => None,
    };
    let rest = MACHINES
        .map(|name| tokio::spawn(machine_life(store.clone(), acknowledge.clone(), name, throws / 2 + 1, throws)));
    for life in rest {
        life.await.unwrap();
    }
    // The close may fail on a failing disk; acknowledged data must be stored anyway.
    let _ = store.close().await;
    drop(holder);
}

async fn open(folder: &Path) -> Option<Store> {
    let settings = Settings { max_wal_mib: 1, ..crate::given::settings(folder) };
    for _ in 0..TRIES {
        if let Ok(opened) = Store::open(&settings, at(0)).await {
            return Some(opened.store);
        }
    }
    None
}

async fn machine_life(store: Store, acknowledge: Acknowledge, name: &'static str, first: u64, last: u64) {
    for throw_no in first..=last {
        let Some(row) = spool(&store, name, throw_no).await else { continue };
        acknowledge.say(&format!("stored {name} b1 {throw_no}"));
        let Some(row) = row else { continue };
        let raised = event(u32::try_from(throw_no / 5).unwrap(), AlarmState::ActiveUnacknowledged);
        let raised: Vec<_> = Some(raised).filter(|_| throw_no % 5 == 0).into_iter().collect();
        let judged = Judgement { outcome: outcome(name, raised.clone()), ..judgement(row, name) };
        if judge(&store, &judged).await {
            acknowledge.say(&format!("judged {name} b1 {throw_no}"));
            for AlarmEvent { cause, raised_at, event_no, .. } in raised {
                acknowledge.say(&format!("raised {} {event_no}", alarm_id(&machine(name), cause, raised_at)));
            }
        }
    }
}

/// Stores a throw. `None` if all tries failed; `Some(None)` if a try that returned an error had stored it.
async fn spool(store: &Store, name: &str, throw_no: u64) -> Option<Option<ThrowRow>> {
    let (machine, throw) = (machine(name), throw("b1", throw_no));
    for _ in 0..TRIES {
        match store.spool(&machine, &throw, at(0)).await {
            Ok(Spooled::New(row)) => return Some(Some(row)),
            Ok(Spooled::Duplicate) => return Some(None),
            Err(_) => {}
        }
    }
    None
}

async fn judge(store: &Store, judged: &Judgement) -> bool {
    for _ in 0..TRIES {
        if store.judge_all([judged.clone()].into()).await.is_ok() {
            return true;
        }
    }
    false
}
