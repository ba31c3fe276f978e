//! Power cuts of the running daemon: at each moment the disk contains everything that was acknowledged.
//!
//! The daemon runs with the shim. A witness adds each message to the log of the shim, so that each cut has a list of
//! the acknowledgements before it.

use std::{path::Path, time::Duration};

use crate::{
    database::inspect,
    logger::{Logger, Plan, QUICK_ALARMS},
    replay::{Disk, Record, cut_at_random, read_log, without_commit_syncs},
    rig::{Rig, size},
    shim,
    verdict::Verdict,
    witness::Witness,
};

/// Runs the daemon with the shim, a logger and a witness; returns the log and the folder of the database.
async fn run_and_log(throws: usize) -> Option<(Vec<Record>, tempfile::TempDir)> {
    let library = shim::library()?;
    let mut rig = Rig::with(QUICK_ALARMS).same_port();
    let log = tempfile::tempdir().unwrap();
    let path = log.path().join("log");
    rig.set("LD_PRELOAD", library);
    rig.set("SHIM_MATCH", rig.database());
    rig.set("SHIM_LOG", &path);
    let daemon = rig.start();
    let witness = Witness::listen(&daemon.endpoint, Some(&path)).await;
    let plan = Plan { machines: 4, pace: Duration::from_millis(5), ..Plan::default() };
    let logger = Logger::start(&daemon.endpoint, plan).await;
    witness.until("every throw", |received| received.health.len() >= throws).await;
    let silent = logger.stop();
    let all = usize::try_from(silent.published).unwrap() * 4;
    witness.until("the last throw", |received| received.health.len() >= all).await;
    assert!(!witness.received().events.is_empty(), "no alarm was raised");
    daemon.terminate();
    Some((read_log(&path), rig.into_folder()))
}

/// Checks the disk after a power cut at `cuts` points of the log.
async fn cut(records: &[Record], original: &Path, cuts: usize, seed: u64) -> Verdict {
    let mut verdict = Verdict::default();
    let check = async |disk: &Disk, folder: &Path| inspect(folder, &disk.acknowledged, &mut verdict).await;
    cut_at_random(records, original, cuts, seed, check).await;
    verdict
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn power_cuts_lose_nothing_that_the_daemon_had_published() {
    let cuts = size("POINTSD_CUTS", 25);
    let Some((records, folder)) = run_and_log(if cuts > 100 { 1000 } else { 100 }).await else { return };
    let acknowledged = records.iter().filter(|record| record.is_acknowledgement()).count();
    println!("{} writes and syncs, {acknowledged} acknowledgements", records.len() - acknowledged);

    let verdict = cut(&records, folder.path(), cuts, 1).await;
    let Verdict { lost, duplicated, unreadable, given_up, notes } = &verdict;
    println!("{cuts} cuts: {lost} lost, {duplicated} duplicated, {unreadable} unreadable");
    assert_eq!((*lost, *duplicated, *unreadable, *given_up), (0, 0, 0, 0), "{:#?}", &notes[..notes.len().min(20)]);

    // The log of the same run, without the sync at each commit: now the test must find losses.
    let weaker = without_commit_syncs(records);
    let Verdict { lost, unreadable, notes, .. } = cut(&weaker, folder.path(), cuts, 2).await;
    println!("{cuts} cuts with synchronous = NORMAL: {lost} lost, {unreadable} unreadable");
    assert!(lost > 0, "no loss without syncs: the test cannot detect losses");
    assert_eq!(unreadable, 0, "{:#?}", &notes[..notes.len().min(20)]);
}
