//! Disks that fail: the nth write or sync, once or for ever.

use std::{fs, path::Path};

use super::{Acknowledged, inspect, shim, worker::THROWS};

const EIO: u32 = 5;
const ENOSPC: u32 = 28;

/// Which calls fail: the first 200 of each kind, or by default some of them.
fn which() -> Vec<u32> {
    match std::env::var("POINTSD_FAULTS") {
        Ok(all) => (1..=all.parse().expect("POINTSD_FAULTS is a number")).collect(),
        Err(_) => vec![3, 40, 90],
    }
}

async fn run(library: &Path, fault: &str) -> (Acknowledged, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let output = shim::run_worker(library, folder.path(), &[("SHIM_FAIL", fault), (THROWS, "12")]);
    let mut wrong = Vec::new();
    if !output.status.success() {
        wrong.push(format!("{fault}: the worker died: {}", String::from_utf8_lossy(&output.stderr)));
    }
    let mut acknowledged = Acknowledged::default();
    acknowledged.add_lines(&fs::read_to_string(folder.path().join("points.db.ack")).unwrap_or_default());
    let verdict = inspect(folder.path(), &acknowledged).await;
    if verdict.lost + verdict.duplicated + verdict.unreadable > 0 {
        wrong.push(format!("{fault}: {verdict:?}"));
    }
    (acknowledged, wrong)
}

#[tokio::test]
async fn a_failing_write_or_sync_loses_nothing_that_was_acknowledged() {
    let Some(library) = shim::library() else { return };
    let (mut wrong, mut runs) = (Vec::new(), 0);
    for nth in which() {
        for what in ["write", "sync"] {
            for errno in [EIO, ENOSPC] {
                for times in ["once", "forever"] {
                    let (acknowledged, faults) = run(library, &format!("{what}:{nth}:{errno}:{times}")).await;
                    wrong.extend(faults);
                    runs += 1;
                    // A fault that passes is got over without a restart.
                    if times == "once" && acknowledged.throws.len() < 4 * 12 {
                        wrong.push(format!("{what}:{nth}:{errno}: only {} throws stored", acknowledged.throws.len()));
                    }
                }
            }
        }
    }
    println!("{runs} faults, {} with a fault of ours", wrong.len());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
