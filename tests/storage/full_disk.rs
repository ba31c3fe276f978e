//! The store on a real disk without free space.

use std::{fs, process::Command};

use pointsd::store::{DiskLevel, Settings, Spooled, Store, StoreError, ThrowRow};

use crate::{
    files::until_trouble,
    given::{at, change, files_with, fresh, judge, judgement, machine, open, received, settings, spooled, throw},
    small_disk::SmallDisk,
};

#[tokio::test]
async fn sql_reads_a_stopped_database_where_nothing_may_be_written() {
    let Some(disk) = SmallDisk::mount() else { return };
    let store = open(disk.folder()).await.store;
    spooled(&store, "21B", "b1", 1).await;
    let path = store.path().to_owned();
    store.close().await.unwrap();
    let remount = Command::new("mount").args(["-o", "remount,ro"]).arg(disk.folder()).status().unwrap();
    assert!(remount.success());
    let question = ["sql", "--csv", "SELECT count(*) AS throws FROM throw", "--database"];
    let output = Command::new(env!("CARGO_BIN_EXE_pointsd")).args(question).arg(&path).output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(String::from_utf8_lossy(&output.stdout), "throws\n1\n", "{error}");
}

/// Stores throws until the disk is full; returns the number of the last stored throw.
async fn spool_until_full(store: &Store, first: u64) -> u64 {
    for throw_no in first..first + 10_000 {
        match store.spool(&machine("21B"), &throw("b1", throw_no), at(0)).await {
            Ok(Spooled::New(_)) => {}
            Err(StoreError::Full) => return throw_no - 1,
            other => panic!("{other:?}"),
        }
    }
    panic!("the disk never filled");
}

#[tokio::test]
async fn a_disk_filled_and_freed_loses_nothing_and_needs_no_restart() {
    let Some(disk) = SmallDisk::mount() else { return };
    // The configured ballast is larger than the disk, so a smaller ballast is created.
    let bounds = Settings { ballast_mib: 16, ..settings(disk.folder()) };
    let store = Store::open(&bounds, at(0)).await.unwrap().store;
    let ballast = fs::metadata(disk.folder().join("points.db-ballast")).unwrap().len();
    assert_eq!(ballast, (12 << 20) / 8);
    for throw_no in 1..=20 {
        spooled(&store, "21B", "b1", throw_no).await;
    }
    disk.fill();
    // The space of the removed ballast is enough for some writes; then the disk is full.
    let last = spool_until_full(&store, 21).await;
    assert!(last > 20, "the ballast was of no use");
    assert!(!disk.folder().join("points.db-ballast").exists());
    assert_eq!(store.disk_level(), DiskLevel::Full);
    for _ in 0..3 {
        let refused = store.spool(&machine("21B"), &throw("b1", last + 1), at(0)).await;
        assert!(matches!(refused, Err(StoreError::Full)), "{refused:?}");
    }
    assert_eq!(store.reader().throws(ThrowRow::START, 100_000).await.unwrap().len() as u64, last);

    disk.free();
    spooled(&store, "21B", "b1", last + 1).await;
    assert_eq!(store.disk_level(), DiskLevel::Ample);
    store.keep_bounds(Some(at(0))).await.unwrap();
    assert!(disk.folder().join("points.db-ballast").exists(), "the ballast is back");
    assert_eq!(store.statistics().await.unwrap().missing_throws, 0);
    store.close().await.unwrap();
}

/// The open connection has the only copy. A copy that does not fit on the disk would make its next write fail.
#[tokio::test]
async fn a_deleted_database_that_cannot_be_written_again_stays_open() {
    let Some(disk) = SmallDisk::mount() else { return };
    let store = open(disk.folder()).await.store;
    let throws: Vec<_> = (1..=1000).map(|throw_no| received("21B", "b1", throw_no, 0)).collect();
    for page in throws.chunks(100) {
        store.spool_all(page).await.unwrap();
    }
    change(store.path(), ["PRAGMA wal_checkpoint(TRUNCATE)"]).await;
    store.outbox_sent(&[]).await.unwrap();
    // The free space is half of the database.
    let size = |name: &str| fs::metadata(disk.folder().join(name)).map_or(0, |file| file.len());
    let used: u64 = files_with(disk.folder(), &["points.db"]).iter().map(|name| size(name)).sum();
    let filler = (12 << 20) - used - size("points.db") / 2;
    fs::write(disk.folder().join("filler"), vec![1; usize::try_from(filler).unwrap()]).unwrap();
    for suffix in ["", "-wal", "-shm"] {
        fs::remove_file(disk.folder().join(format!("points.db{suffix}"))).unwrap();
    }
    until_trouble(&store).await;
    let (_, said) = store.trouble(None).unwrap();
    assert!(said.contains("cannot be written again"), "{said}");
    assert_eq!(files_with(disk.folder(), &["-copy"]), Vec::<String>::new());
    spooled(&store, "21B", "b1", 1001).await;
    let again = store.spool(&machine("21B"), &throw("b1", 7), at(0)).await.unwrap();
    assert_eq!(again, Spooled::Duplicate, "its rows are lost");
}

#[tokio::test]
async fn below_the_watermark_traces_go_and_estimates_stay() {
    let Some(disk) = SmallDisk::mount() else { return };
    let bounds = Settings { low_disk_mib: 4, ..settings(disk.folder()) };
    let store = Store::open(&bounds, at(0)).await.unwrap().store;
    // More throws than fit on the disk with all traces.
    for throw_no in 1..=1500 {
        let row = spooled(&store, "21B", "b1", throw_no).await;
        judge(&store, judgement(row, "21B")).await.unwrap();
        if throw_no % 50 == 0 {
            store.keep_bounds(Some(at(0))).await.unwrap();
        }
    }
    let statistics = store.statistics().await.unwrap();
    assert!(statistics.counters()["dropped_traces"] > 0, "{statistics:?}");
    let newest = "SELECT count(*) FROM trace WHERE throw_row > (SELECT max(throw_row) FROM throw) - 50";
    assert_eq!(crate::given::query::<(i64,)>(&store, newest).await, [(50,)], "the oldest traces go first");
    assert_eq!(statistics.failed_writes, 0, "the watermark acts before the disk is full");
    let estimates: Vec<(i64,)> = crate::given::query(&store, "SELECT count(*) FROM health_history").await;
    assert_eq!(estimates, [(1500,)]);
    store.close().await.unwrap();
}

#[tokio::test]
async fn a_ballast_that_is_switched_off_is_removed() {
    let (folder, store) = fresh().await;
    store.close().await.unwrap();
    let ballast = folder.path().join("points.db-ballast");
    assert!(ballast.exists());
    let without = Settings { ballast_mib: 0, ..settings(folder.path()) };
    let store = Store::open(&without, at(0)).await.unwrap().store;
    assert!(!ballast.exists());
    store.close().await.unwrap();
}
