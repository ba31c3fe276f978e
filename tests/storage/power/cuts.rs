//! Power cuts: no acknowledged data are lost, no row is duplicated, every database can be opened.

use std::path::Path;

use super::{
    inspect,
    replay::{Disk, Record, cut_at_random, read_log, without_commit_syncs},
    shim,
    verdict::Verdict,
    worker::{self, HOLDER, THROWS},
};

/// Runs the worker once and checks the database after a power cut at each of `cuts` points, as it would be with a weaker
/// setting of SQLite if `weaker`; `None` without a C compiler.
async fn cut(cuts: usize, seed: u64, variables: &[(&str, &str)], weaker: bool) -> Option<Verdict> {
    let library = shim::library()?;
    let folder = tempfile::tempdir().unwrap();
    let database = folder.path().join("live");
    std::fs::create_dir(&database).unwrap();
    let log = folder.path().join("log");
    let mut variables = variables.to_vec();
    variables.push(("SHIM_LOG", log.to_str().unwrap()));
    let output = worker::run_below(library, &database, &variables);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let records = if weaker { without_commit_syncs(read_log(&log)) } else { read_log(&log) };
    assert!(records.len() > 1000, "only {} records", records.len());

    let moved = records.iter().any(Record::is_move);
    assert_eq!(moved, variables.iter().any(|(name, _)| *name == HOLDER), "the database moves behind a reader, only");

    let mut total = Verdict::default();
    let check = async |disk: &Disk, folder: &Path| inspect(folder, &disk.acknowledged, &mut total).await;
    cut_at_random(&records, &database, cuts, seed, check).await;
    let Verdict { lost, duplicated, unreadable, .. } = &total;
    println!(
        "{cuts} cuts in {} writes and syncs: {lost} lost, {duplicated} duplicated, {unreadable} unreadable",
        records.len()
    );
    assert!(records.iter().any(Record::is_acknowledgement));
    Some(total)
}

fn cuts() -> usize {
    std::env::var("POINTSD_CUTS").map_or(25, |cuts| cuts.parse().expect("POINTSD_CUTS is a number"))
}

#[tokio::test]
async fn power_cuts_lose_nothing_that_was_acknowledged() {
    for (seed, variables) in [(1, &[(THROWS, "60")][..]), (2, &[(THROWS, "60"), (HOLDER, "1")])] {
        let Some(verdict) = cut(cuts(), seed, variables, false).await else { return };
        let Verdict { lost, duplicated, unreadable, given_up, notes } = verdict;
        assert_eq!((lost, duplicated, unreadable, given_up), (0, 0, 0, 0), "{notes:?}");
    }
}

#[tokio::test]
async fn the_harness_finds_the_losses_of_a_weaker_setting() {
    let Some(verdict) = cut(cuts(), 3, &[(THROWS, "60")], true).await else { return };
    assert!(verdict.lost > 0, "no loss with synchronous = NORMAL: the test cannot detect losses");
    assert_eq!(verdict.unreadable, 0, "{:?}", verdict.notes);
}
