//! A failing disk: the nth write or sync fails, once or permanently.

use std::{fs, path::Path};

use super::{
    inspect, shim,
    verdict::Verdict,
    worker::{self, HOLDER, THROWS},
};

const EIO: u32 = 5;
const ENOSPC: u32 = 28;

/// The numbers n of the calls that fail: three of them, or all from 1 to `POINTSD_FAULTS`.
fn which() -> Vec<u32> {
    match std::env::var("POINTSD_FAULTS") {
        Ok(all) => (1..=all.parse().expect("POINTSD_FAULTS is a number")).collect(),
        Err(_) => vec![3, 40, 90],
    }
}

/// Kinds and numbers of the calls that fail while a reader keeps an old state open.
fn which_late() -> Vec<(&'static str, u32)> {
    let all = std::env::var_os("POINTSD_FAULTS").is_some();
    let (writes, syncs) = if all { (25, 10) } else { (1200, 400) };
    let writes = (1000..5000).step_by(writes).map(|nth| ("write", nth));
    writes.chain((200..1000).step_by(syncs).map(|nth| ("sync", nth))).collect()
}

/// Runs the worker with a fault; returns the number of stored throws, and texts about errors of the store.
async fn run(library: &Path, fault: &str, variables: &[(&str, &str)]) -> (usize, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let variables: Vec<_> = variables.iter().copied().chain([("SHIM_FAIL", fault)]).collect();
    let output = worker::run_below(library, folder.path(), &variables);
    let mut wrong = Vec::new();
    if !output.status.success() {
        wrong.push(format!("{fault}: the worker died: {}", String::from_utf8_lossy(&output.stderr)));
    }
    let acknowledged = fs::read_to_string(folder.path().join("points.db.ack")).unwrap_or_default();
    let mut verdict = Verdict::default();
    inspect(folder.path(), &acknowledged, &mut verdict).await;
    // While the disk is full, the trace of a judged throw is dropped.
    let given_up = if fault.contains(&format!(":{ENOSPC}:")) { 0 } else { verdict.given_up };
    if verdict.lost + verdict.duplicated + verdict.unreadable + given_up > 0 {
        wrong.push(format!("{fault}: {verdict:?}"));
    }
    (acknowledged.lines().filter(|line| line.starts_with("stored")).count(), wrong)
}

#[tokio::test]
async fn a_failing_write_or_sync_loses_nothing_that_was_acknowledged() {
    let Some(library) = shim::library() else { return };
    let (mut wrong, mut runs) = (Vec::new(), 0);
    for nth in which() {
        for what in ["write", "sync"] {
            for errno in [EIO, ENOSPC] {
                for times in ["once", "forever"] {
                    let (stored, faults) =
                        run(library, &format!("{what}:{nth}:{errno}:{times}"), &[(THROWS, "12")]).await;
                    wrong.extend(faults);
                    runs += 1;
                    // After a temporary fault all throws are stored without a restart.
                    if times == "once" && stored < 4 * 12 {
                        wrong.push(format!("{what}:{nth}:{errno}: only {stored} throws stored"));
                    }
                }
            }
        }
    }
    // These calls belong to checkpoints, and to the move of the database to a new file because of a reader.
    for (what, nth) in which_late() {
        let fault = format!("{what}:{nth}:{ENOSPC}:once");
        let (stored, faults) = run(library, &fault, &[(THROWS, "60"), (HOLDER, "1")]).await;
        wrong.extend(faults);
        runs += 1;
        if stored < 4 * 60 {
            wrong.push(format!("{fault}: only {stored} throws stored"));
        }
    }
    println!("{runs} faults, {} with a fault of ours", wrong.len());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
