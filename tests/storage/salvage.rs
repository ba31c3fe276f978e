//! Copying the readable rows of a database with broken pages: first the baselines and open alarms.

use std::{fs, os::unix::fs::FileExt, path::Path, time::Duration};

use pointsd::{
    diagnose::AlarmState,
    store::{Found, Judgement, MonitorRecord, Outcome, Salvaged, Selector, Store, StoreError},
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sqlx::Connection;
use tokio::time::timeout;

use crate::{
    given::{
        PAGE, alarm, at, change, event, files_with, fresh, judge, judged, judgement, machine, open, outcome, outsider,
        overwrite, query, settings, spooled,
    },
    small_disk::SmallDisk,
};

const MACHINES: [&str; 10] = ["21B", "22", "23", "24", "25", "26", "27", "28", "29", "30"];
const THROWS: u64 = 100;

/// A database with ten machines, each with a monitor of usual size, an open alarm and 100 judged throws.
async fn database(folder: &Path) {
    let store = open(folder).await.store;
    for name in MACHINES {
        for throw_no in 1..=THROWS {
            let row = spooled(&store, name, "b1", throw_no).await;
            let snapshot = format!("{{\"events\":{:?}}}", "x".repeat(9_000));
            let monitor = MonitorRecord { snapshot, ..alarm(1, AlarmState::ActiveUnacknowledged).monitor.unwrap() };
            let events = if throw_no == 80 { vec![event(1, AlarmState::ActiveUnacknowledged)] } else { Vec::new() };
            let outcome = Outcome { monitor: Some(monitor), ..outcome(name, events) };
            judge(&store, Judgement { outcome, ..judgement(row, name) }).await.unwrap();
        }
    }
    store.close().await.unwrap();
    // Clears the mark of the clean stop, so that the next start checks the whole file.
    change(folder.join("points.db"), ["UPDATE shutdown SET clean = 0"]).await;
}

/// Overwrites `number` random pages, but never the first page.
fn break_pages(file: &Path, number: u64, seed: u64) {
    let file = fs::OpenOptions::new().write(true).open(file).unwrap();
    let pages = file.metadata().unwrap().len() / PAGE;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    for _ in 0..number {
        let garbage: Vec<u8> = (0..PAGE).map(|_| random.random()).collect();
        file.write_all_at(&garbage, random.random_range(1..pages) * PAGE).unwrap();
    }
}

async fn salvaged(folder: &Path) -> (Store, Salvaged) {
    let opened = open(folder).await;
    let Found::SetAside { salvaged, .. } = opened.report.found else { panic!("{:?}", opened.report) };
    (opened.store, salvaged)
}

/// The unfinished files of a recovery.
fn leftovers(folder: &Path) -> Vec<String> {
    files_with(folder, &["salvage", "grafted", "layout"])
}

#[tokio::test]
async fn readable_rows_of_a_broken_database_are_kept() {
    let whole = tempfile::tempdir().unwrap();
    database(whole.path()).await;
    let all = THROWS * MACHINES.len() as u64;
    let pages = fs::metadata(whole.path().join("points.db")).unwrap().len() / PAGE;
    for (broken, seeds, least_machines, least_throws) in [(1, 10, 9.0, 0.95), (10, 5, 8.0, 0.9), (100, 8, 5.0, 0.6)] {
        let (mut machines, mut alarms, mut throws, mut traces, mut no_schema) = (0, 0, 0, 0, 0);
        for seed in 0..seeds {
            let folder = tempfile::tempdir().unwrap();
            let file = folder.path().join("points.db");
            fs::copy(whole.path().join("points.db"), &file).unwrap();
            break_pages(&file, broken, seed);
            if matches!(fs::read(&file), Ok(bytes) if bytes == fs::read(whole.path().join("points.db")).unwrap()) {
                continue;
            }
            let opened = open(folder.path()).await;
            let Found::SetAside { salvaged, .. } = &opened.report.found else {
                // No damage was found: the page was not in use, or the check does not read it.
                (machines, alarms, throws, traces) = (machines + 10, alarms + 10, throws + all, traces + all);
                continue;
            };
            assert_eq!(
                salvaged.saved("throw"),
                opened.store.reader().throws(pointsd::store::ThrowRow::START, 10_000).await.unwrap().len() as u64
            );
            no_schema += u32::from(salvaged.saved("machine") == 0);
            machines += salvaged.saved("monitor");
            alarms += opened.store.reader().open_alarms(&Selector::default()).await.unwrap().len() as u64;
            (throws, traces) = (throws + salvaged.saved("throw"), traces + salvaged.saved("trace"));
            let (_, said) = opened.store.trouble(None).unwrap();
            assert!(
                said.contains("set aside") && (said.contains("baselines") || said.contains("nothing of it")),
                "{said}"
            );
            opened.store.close().await.unwrap();
        }
        let mean = |count: u64| count as f64 / seeds as f64;
        println!(
            "{broken} of {pages} pages broken: of {} monitors {:.1}, of {} open alarms {:.1}, of {all} throws {:.0}, \
             traces {:.0}; of {no_schema} of {seeds} files nothing",
            MACHINES.len(),
            mean(machines),
            MACHINES.len(),
            mean(alarms),
            mean(throws),
            mean(traces)
        );
        assert!(mean(machines) >= least_machines && mean(throws) >= least_throws * all as f64);
    }
}

/// The copy skips the 2^40 keys between the last valid row and a garbage row, as no row has them. A garbage row with
/// the largest key of SQLite is not copied: it would let no other throw be added.
#[tokio::test]
async fn keys_of_garbage_far_above_all_others_cost_no_time_and_no_later_throw() {
    let folder = tempfile::tempdir().unwrap();
    database(folder.path()).await;
    let garbage = [
        "CREATE TEMP TABLE garbage AS SELECT * FROM throw WHERE throw_row = 1",
        "UPDATE garbage SET throw_row = 1 << 40, throw_no = 998",
        "INSERT INTO throw SELECT * FROM garbage",
        "UPDATE garbage SET throw_row = 9223372036854775807, throw_no = 999",
        "INSERT INTO throw SELECT * FROM garbage",
    ];
    change(folder.path().join("points.db"), garbage).await;
    break_pages(&folder.path().join("points.db"), 3, 1);
    let (store, salvaged) = timeout(Duration::from_mins(1), salvaged(folder.path())).await.unwrap();
    assert!(salvaged.saved("throw") > 900, "{salvaged:?}");
    judged(&store, "21B", "b2", 1).await;
}

#[tokio::test]
async fn an_open_alarm_and_its_monitor_outlive_a_broken_page() {
    let (folder, store) = fresh().await;
    for throw_no in 1..=200 {
        judged(&store, "21B", "b1", throw_no).await;
    }
    store.record(alarm(1, AlarmState::ActiveUnacknowledged)).await.unwrap();
    let mut outsider = outsider(store.path()).await;
    let page: i64 = sqlx::query_scalar("SELECT max(pageno) FROM dbstat WHERE name = 'trace' AND pagetype = 'leaf'")
        .fetch_one(&mut outsider)
        .await
        .unwrap();
    outsider.close().await.unwrap();
    store.close().await.unwrap();
    let page = page.cast_unsigned();
    overwrite(&folder.path().join("points.db"), page - 1..page);

    // The stop was clean, but the file is broken.
    let (store, salvaged) = salvaged(folder.path()).await;
    assert_eq!((salvaged.saved("monitor"), salvaged.saved("alarm"), salvaged.saved("throw")), (1, 1, 200));
    assert!(salvaged.lost("trace") > 0 && salvaged.saved("trace") > 150, "{salvaged:?}");
    let reader = store.reader();
    assert_eq!(
        reader.open_alarms(&Selector::default()).await.unwrap()[0].event,
        event(1, AlarmState::ActiveUnacknowledged)
    );
    assert_eq!(reader.monitors(None, 10).await.unwrap()[0].machine, machine("21B"));
    // A saved throw that arrives again is a duplicate.
    let again = store.spool(&machine("21B"), &crate::given::throw("b1", 7), at(0)).await.unwrap();
    assert_eq!(again, pointsd::store::Spooled::Duplicate);
}

/// A machine from the index is copied after its throws, whose triggers count the rows and note the latest throw. Throw 3
/// arrived last, from the backlog.
#[tokio::test]
async fn a_machine_from_the_index_has_its_counters_and_its_latest_throw() {
    const COUNTERS: &str = "SELECT throws, traces, stored_bytes, throw_no FROM machine \
                            JOIN latest USING (machine_row) JOIN throw USING (throw_row)";
    let (folder, store) = fresh().await;
    for throw_no in [1, 2, 4, 3] {
        judged(&store, "21B", "b1", throw_no).await;
    }
    let before = query::<(i64, i64, i64, i64)>(&store, COUNTERS).await;
    assert!(matches!(before[..], [(4, 4, _, 4)]), "{before:?}");
    let root = query::<(i64,)>(&store, "SELECT rootpage FROM sqlite_schema WHERE name = 'machine'").await[0].0;
    store.close().await.unwrap();
    let root = root.cast_unsigned();
    overwrite(&folder.path().join("points.db"), root - 1..root);
    let (store, salvaged) = salvaged(folder.path()).await;
    assert!(salvaged.lost("machine") > 0, "{salvaged:?}");
    assert_eq!(query::<(i64, i64, i64, i64)>(&store, COUNTERS).await, before);
}

/// A kill or a full disk interrupted the copy: the broken file is renamed, and there is no new database yet.
#[tokio::test]
async fn an_interrupted_salvage_begins_again_at_the_next_start() {
    let folder = tempfile::tempdir().unwrap();
    database(folder.path()).await;
    let path = folder.path().join("points.db");
    break_pages(&path, 3, 7);
    fs::rename(&path, folder.path().join("points.db-broken-20260301T060000Z")).unwrap();
    fs::write(folder.path().join("points.db-salvage"), "the start of a copy").unwrap();
    fs::write(folder.path().join("points.db-salvage-wal"), "and its log").unwrap();

    let (store, salvaged) = salvaged(folder.path()).await;
    assert!(salvaged.saved("monitor") >= 7 && salvaged.saved("throw") >= 900, "{salvaged:?}");
    let (_, said) = store.trouble(None).unwrap();
    assert!(said.contains("points.db-broken-20260301T060000Z") && said.contains("baselines"), "{said}");
    store.close().await.unwrap();
    let opened = open(folder.path()).await;
    assert_eq!(opened.report.found, Found::Clean, "the copy is complete");
    let monitors = opened.store.reader().monitors(None, 100).await.unwrap().len();
    assert_eq!(monitors as u64, salvaged.saved("monitor"));
    assert_eq!(leftovers(folder.path()), Vec::<String>::new());
}

/// The first page holds the start of the schema: without it SQLite cannot read any table.
#[tokio::test]
async fn without_its_schema_a_database_is_read_where_this_program_puts_its_tables() {
    for moved in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        database(folder.path()).await;
        let path = folder.path().join("points.db");
        if moved {
            let copy = folder.path().join("copy.db");
            let mut connection = outsider(&path).await;
            let to = format!("VACUUM INTO '{}'", copy.display());
            sqlx::query(sqlx::AssertSqlSafe(to)).execute(&mut connection).await.unwrap();
            connection.close().await.unwrap();
            fs::rename(copy, &path).unwrap();
        }
        overwrite(&path, 0..1);
        let (store, salvaged) = salvaged(folder.path()).await;
        let saved = ["monitor", "alarm", "throw", "estimate", "trace"].map(|table| salvaged.saved(table));
        assert_eq!(saved, [10, 10, 1000, 1000, 1000], "moved: {moved}, {salvaged:?}");
        assert_eq!(store.reader().open_alarms(&Selector::default()).await.unwrap().len(), 10);
        assert_eq!(leftovers(folder.path()), Vec::<String>::new());
    }
}

/// There is space for the machines with their alarms and boots, but not for the 20,000 throws. The boots keep their
/// highest numbers, so the backlogs of the loggers are not fetched again.
#[tokio::test]
async fn with_little_space_the_boots_are_kept_without_their_throws() {
    let Some(disk) = SmallDisk::of_mib(32) else { return };
    let path = disk.folder().join("points.db");
    database(disk.folder()).await;
    let throws = [
        "WITH RECURSIVE n(i) AS (SELECT 1001 UNION ALL SELECT i + 1 FROM n WHERE i < 21000) \
         INSERT INTO throw (throw_row, machine_row, boot_row, throw_no, started_at_us, received_at_us, sample_rate_hz, \
         samples, content_crc32, judged_at_us) SELECT i, 1, 1, i, i, 0, 1000, 1, 0, 1 FROM n",
        "UPDATE boot SET highest_no = 21000 WHERE boot_row = 1",
        "PRAGMA wal_checkpoint(TRUNCATE)",
    ];
    change(&path, throws).await;
    let mut outsider = outsider(&path).await;
    let page: i64 = sqlx::query_scalar("SELECT max(pageno) FROM dbstat WHERE name = 'trace' AND pagetype = 'leaf'")
        .fetch_one(&mut outsider)
        .await
        .unwrap();
    outsider.close().await.unwrap();
    let page = page.cast_unsigned();
    overwrite(&path, page - 1..page);
    disk.fill();
    let filler = disk.folder().join("filler");
    let left = fs::metadata(&filler).unwrap().len() - (3 << 20);
    fs::OpenOptions::new().write(true).open(filler).unwrap().set_len(left).unwrap();

    let (store, salvaged) = salvaged(disk.folder()).await;
    assert_eq!((salvaged.saved("monitor"), salvaged.saved("alarm"), salvaged.saved("throw")), (10, 10, 0));
    let boots = "SELECT boot_row, highest_no FROM boot ORDER BY boot_row LIMIT 2";
    assert_eq!(query::<(i64, i64)>(&store, boots).await, [(1, 21_000), (2, 100)]);
    let said = salvaged.text();
    assert!(said.contains("Its throws, estimates and traces were not copied"), "{said}");
}

/// Without space for a copy of the broken file, an empty database would hide its baselines for ever.
#[tokio::test]
async fn without_space_a_database_without_its_schema_is_read_at_a_later_start() {
    let Some(disk) = SmallDisk::of_mib(16) else { return };
    let path = disk.folder().join("points.db");
    database(disk.folder()).await;
    overwrite(&path, 0..1);
    // Space for a new database, and none for the copy with a new schema.
    let size = fs::metadata(&path).unwrap().len();
    disk.fill();
    let filler = disk.folder().join("filler");
    let left = fs::metadata(&filler).unwrap().len() - size / 2;
    fs::OpenOptions::new().write(true).open(filler).unwrap().set_len(left).unwrap();
    for _ in 0..2 {
        let full = Store::open(&settings(disk.folder()), at(0)).await.err();
        assert!(matches!(full, Some(StoreError::Full)), "{full:?}");
        assert!(!path.exists(), "an empty database takes its place");
    }
    disk.free();
    let (store, salvaged) = salvaged(disk.folder()).await;
    assert_eq!((salvaged.saved("monitor"), salvaged.saved("alarm")), (10, 10), "{salvaged:?}");
    let (_, said) = store.trouble(None).unwrap();
    assert!(said.contains("points.db-broken-20260301T060000Z; what could be read"), "{said}");
    assert_eq!(leftovers(disk.folder()), Vec::<String>::new());
}
