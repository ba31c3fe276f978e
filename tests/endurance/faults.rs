//! A disk that fails during operation: the nth write or sync, once or permanently.
//!
//! The daemon continues, or reports the fault, or ends with an exit code other than 0. It loses no acknowledged data,
//! which the test checks in the database after a `kill -9`. Only during the start may a temporary fault need a restart.

use std::{
    path::Path,
    sync::Mutex,
    thread,
    time::{Duration, Instant},
};

use tokio::runtime::Runtime;

use crate::{
    database::inspect,
    logger::{Logger, Plan, QUICK_ALARMS},
    rig::{NotStarted, PATIENCE, Rig, size},
    shim,
    verdict::Verdict,
    witness::{Received, Witness},
};

const ERRNOS: [u32; 2] = [5, 28]; // EIO, ENOSPC
/// Published throws of each of two machines.
const THROWS: u64 = 8;
/// Time for further acknowledgements after the daemon has reported a fault.
const AFTERMATH: Duration = Duration::from_millis(300);
/// Parallel daemons; they mostly wait.
const AT_ONCE: usize = 4;

/// Outcome of a run with a fault.
#[derive(Debug, PartialEq, Eq, Clone, Copy)]
enum Outcome {
    /// The witness received all published throws.
    Continued,
    /// The daemon reported the fault in its log, and the test killed it.
    Reported,
    /// The daemon ended with an exit code other than 0, and the witness received everything from the next one.
    Restarted,
}

fn is_all(received: &Received) -> bool {
    received.health.len() as u64 == 2 * THROWS
}

fn plan() -> Plan {
    Plan { throws: THROWS, machines: 2, pace: Duration::from_millis(2), ..Plan::default() }
}

/// Runs a daemon with a fault; an error is a defect of the daemon.
async fn run(library: &Path, fault: &str) -> Result<Outcome, String> {
    let mut rig = Rig::with(QUICK_ALARMS).same_port();
    rig.set("LD_PRELOAD", library);
    rig.set("SHIM_MATCH", rig.database());
    rig.set("SHIM_FAIL", fault);
    let mut daemon = match rig.try_start() {
        Ok(daemon) => daemon,
        Err(NotStarted { status, .. }) if !status.success() => return restarted(rig).await,
        Err(NotStarted { log, .. }) => return Err(format!("exit code 0 in spite of the fault: {log:?}")),
    };
    let witness = Witness::listen(&daemon.endpoint, None).await;
    let logger = Logger::start(&daemon.endpoint, plan()).await;
    let deadline = Instant::now() + PATIENCE;
    let outcome = loop {
        if is_all(&witness.received()) {
            break Outcome::Continued;
        }
        if let Some(status) = daemon.ended() {
            if status.success() {
                return Err(format!("exit code 0 in spite of the fault: {:?}", daemon.log()));
            }
            break Outcome::Restarted;
        }
        if daemon.log().iter().any(|line| line.contains("ERROR")) && fault.ends_with("forever") {
            tokio::time::sleep(AFTERMATH).await;
            break Outcome::Reported;
        }
        if Instant::now() > deadline {
            return Err(format!("{} received: {:?}", witness.received().health.len(), daemon.log()));
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    };
    daemon.kill();
    let mut verdict = Verdict::default();
    let acknowledged = witness.received().acknowledged();
    inspect(rig.folder(), &acknowledged, &mut verdict).await;
    if verdict.lost + verdict.duplicated + verdict.unreadable > 0 {
        return Err(format!("{verdict:?}"));
    }
    if outcome == Outcome::Restarted {
        rig.set("SHIM_FAIL", "");
        let daemon = rig.start();
        witness.until("everything after the restart", is_all).await;
        daemon.kill();
    }
    drop(logger);
    Ok(outcome)
}

/// Starts the daemon again without the fault; the witness must receive everything.
async fn restarted(mut rig: Rig) -> Result<Outcome, String> {
    rig.set("SHIM_FAIL", "");
    let daemon = rig.start();
    let witness = Witness::listen(&daemon.endpoint, None).await;
    let _logger = Logger::start(&daemon.endpoint, plan()).await;
    witness.until("everything after the restart", is_all).await;
    Ok(Outcome::Restarted)
}

/// The faults of the run, each at one write or sync.
fn faults() -> Vec<String> {
    let which = match size("POINTSD_FAULTS", 0) {
        0 => vec![3, 60],
        all => (1..=all).collect(),
    };
    let mut faults = Vec::new();
    for nth in which {
        for what in ["write", "sync"] {
            for errno in ERRNOS {
                faults.extend(["once", "forever"].map(|times| format!("{what}:{nth}:{errno}:{times}")));
            }
        }
    }
    faults
}

#[test]
fn a_failing_write_or_sync_drops_nothing_silently() {
    let Some(library) = shim::library() else { return };
    let runtime = Runtime::new().unwrap();
    let (faults, outcomes) = (Mutex::new(faults()), Mutex::new(Vec::new()));
    let work = || {
        while let Some(fault) = { faults.lock().unwrap().pop() } {
            let outcome = runtime.block_on(run(library, &fault));
            outcomes.lock().unwrap().push(outcome.map_err(|defect| format!("{fault}: {defect}")));
        }
    };
    thread::scope(|scope| (0..AT_ONCE).for_each(|_| drop(scope.spawn(work))));
    let outcomes = outcomes.into_inner().unwrap();
    let wrong: Vec<&String> = outcomes.iter().filter_map(|outcome| outcome.as_ref().err()).collect();
    let count = |outcome| outcomes.iter().filter(|one| one.as_ref() == Ok(&outcome)).count();
    println!(
        "{} faults: {} daemons continued, {} reported, {} ended and continued after a restart; {} wrong",
        outcomes.len(),
        count(Outcome::Continued),
        count(Outcome::Reported),
        count(Outcome::Restarted),
        wrong.len()
    );
    assert!(wrong.is_empty(), "{wrong:#?}");
}
