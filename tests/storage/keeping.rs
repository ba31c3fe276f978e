//! Long operation: limits of rows, bytes, age and log; broken files; clock jumps.

use std::{collections::BTreeMap, fs, path::Path, time::Duration};

use jiff::{SignedDuration, Timestamp};
use pointsd::{
    diagnose::AlarmState,
    store::{Dropped, Found, Settings, Spooled, Store, StoreError, ThrowRow},
};
use sqlx::Connection;

use crate::given::{
    self, PAGE, alarm, at, change, files_with, fresh, fresh_with, judge, judgement, machine, open, outsider, overwrite,
    query, reading, received, settings, spooled, throw,
};

/// Stores and judges the throws `first` to `last`, received one minute after another.
async fn judged(store: &Store, first: u64, last: u64) {
    for throw_no in first..=last {
        judged_at(store, throw_no, at(60 * i64::try_from(throw_no).unwrap())).await;
    }
}

async fn judged_at(store: &Store, throw_no: u64, received_at: Timestamp) {
    let answer = store.spool(&machine("21B"), &throw("b1", throw_no), received_at).await.unwrap();
    let Spooled::New(row) = answer else { panic!("{throw_no}") };
    judge(store, judgement(row, "21B")).await.unwrap();
}

#[tokio::test]
async fn traces_are_dropped_before_throws_and_pending_throws_never() {
    let (_folder, store) = fresh_with(|settings| Settings { max_traces: 100, max_throws: 150, ..settings }).await;
    let waits = spooled(&store, "22A", "c1", 1).await;
    judged(&store, 1, 200).await;
    // The pending throw counts for both limits.
    let done = store.keep_bounds(Some(at(0))).await.unwrap();
    assert_eq!(done, BTreeMap::from([(Dropped::Traces, 101), (Dropped::Throws, 51)]));
    let statistics = store.statistics().await.unwrap();
    assert_eq!(statistics.pending, 1);
    let (pending, _) = store.reader().to_judge(None, 9, at(0), Duration::ZERO).await.unwrap();
    assert_eq!(pending[0].row, waits);
    assert_eq!((statistics.counters()["dropped_traces"], statistics.counters()["dropped_throws"]), (101, 51));
    // A deleted throw that arrives again is a duplicate, and the deleted numbers are not a gap.
    let again = store.spool(&machine("21B"), &throw("b1", 7), at(0)).await.unwrap();
    assert_eq!(again, Spooled::Duplicate);
    assert_eq!(statistics.missing_throws, 0);
}

#[tokio::test]
async fn the_trace_of_a_throw_that_was_pending_is_dropped_after_newer_ones() {
    let (_folder, store) = fresh_with(|settings| Settings { max_traces: 100, ..settings }).await;
    let waits = spooled(&store, "21B", "b1", 1).await;
    judged(&store, 2, 150).await;
    store.keep_bounds(Some(at(0))).await.unwrap();
    judge(&store, judgement(waits, "21B")).await.unwrap();
    judged(&store, 151, 160).await;
    store.keep_bounds(Some(at(0))).await.unwrap();
    assert_eq!(query::<(i64, i64)>(&store, "SELECT count(*), min(throw_row) FROM trace").await, [(100, 61)]);
}

#[tokio::test]
async fn bytes_are_bounded_and_alarms_outlive_throws() {
    let (_folder, store) = fresh_with(|settings| Settings { max_size_mib: 1, ..settings }).await;
    store.record(alarm(1, AlarmState::Normal)).await.unwrap();
    judged(&store, 1, 400).await;
    assert!(store.statistics().await.unwrap().data_bytes > 1 << 20, "the test writes too little");
    let done = store.keep_bounds(Some(at(0))).await.unwrap();
    let statistics = store.statistics().await.unwrap();
    assert!(statistics.data_bytes <= 1 << 20, "{} bytes", statistics.data_bytes);
    assert!(done.len() == 1 && (1..400).contains(&done[&Dropped::Traces]), "{done:?}");
    assert_eq!(query::<(i64,)>(&store, "SELECT count(*) FROM alarm_history").await, [(1,)]);
    assert_eq!(query::<(i64,)>(&store, "SELECT count(*) FROM health_history").await, [(400,)]);
}

/// Pending throws count too, so that a flood does not make the database larger than its limit.
#[tokio::test]
async fn pending_throws_are_bounded_too_and_an_alarm_reports_dropped_ones() {
    let (_folder, store) = fresh_with(|settings| Settings { max_size_mib: 1, ..settings }).await;
    let flood: Vec<_> = (1..=1000).map(|no| received("loud", "b1", no, 0)).collect();
    store.spool_all(&flood).await.unwrap();
    assert!(store.statistics().await.unwrap().data_bytes > 2 << 20, "the test writes too little");
    store.keep_bounds(Some(at(0))).await.unwrap();
    let statistics = store.statistics().await.unwrap();
    assert!(statistics.data_bytes <= 1 << 20, "{} bytes", statistics.data_bytes);
    let dropped = statistics.counters()["dropped_pending_throws"];
    assert_eq!((statistics.throws + dropped, statistics.pending), (1000, statistics.throws));
    let (severity, said) = store.trouble(None).unwrap();
    assert!(severity == pointsd::diagnose::Severity::Critical && said.contains("throws before judging"), "{said}");
    // The numbers of the deleted throws are kept: they are not a gap, and a throw that arrives again is a duplicate.
    assert_eq!(statistics.missing_throws, 0);
    let again = store.spool(&machine("loud"), &throw("b1", 3), at(0)).await.unwrap();
    assert_eq!(again, Spooled::Duplicate);
}

/// The alarm also reports rows that retention did not drop itself: a trigger drops notifications for the webhook. Rows
/// that were dropped before the start of the daemon are not reported.
#[tokio::test]
async fn dropped_alarm_events_are_a_problem_of_the_daemon() {
    let (_folder, store) = fresh().await;
    let count = "INSERT INTO counter (name, value) VALUES ('dropped_notifications', 3), ('dropped_messages', 2) \
                 ON CONFLICT DO UPDATE SET value = value + excluded.value";
    change(store.path(), [count]).await;
    store.keep_bounds(Some(at(0))).await.unwrap();
    assert_eq!(store.trouble(None), None, "dropped before the start");
    change(store.path(), [count]).await;
    store.keep_bounds(Some(at(0))).await.unwrap();
    let (_, said) = store.trouble(None).unwrap();
    assert!(said.contains("it dropped 3 alarm events before the webhook accepted them"), "{said}");
    assert!(said.contains("it dropped 2 alarm events before publishing"), "{said}");
}

/// A burst after long operation: retention drops pending throws of the burst, and keeps the estimates of old throws,
/// whose traces were dropped before.
#[tokio::test]
async fn a_burst_of_pending_throws_costs_no_history() {
    let (_folder, store) = fresh_with(|settings| Settings { max_traces: 100, ..settings }).await;
    judged(&store, 1, 150).await;
    store.keep_bounds(Some(at(0))).await.unwrap();
    let burst: Vec<_> = (151..=400).map(|no| received("21B", "b1", no, 0)).collect();
    store.spool_all(&burst).await.unwrap();
    store.keep_bounds(Some(at(0))).await.unwrap();
    let statistics = store.statistics().await.unwrap();
    assert_eq!((statistics.pending, statistics.counters()["dropped_pending_throws"]), (100, 150));
    assert_eq!(query::<(i64,)>(&store, "SELECT count(*) FROM health_history").await, [(150,)]);
}

/// Other programs fill the disk, and no trace is left to drop: the other limits still hold.
#[tokio::test]
async fn a_disk_that_others_fill_does_not_end_the_retention() {
    let (_folder, store) = fresh_with(|settings| Settings { low_disk_mib: 1 << 20, max_throws: 150, ..settings }).await;
    judged(&store, 1, 200).await;
    store.keep_bounds(Some(at(0))).await.unwrap();
    let statistics = store.statistics().await.unwrap();
    assert_eq!((statistics.traces, statistics.throws), (0, 150));
}

/// Retention deletes the history of the largest machine first; the history of the other machines stays complete.
#[tokio::test]
async fn a_machine_that_floods_loses_its_own_history_and_no_others() {
    for bounds in [
        Settings { max_size_mib: 1, ..Settings::default() },
        Settings { max_traces: 100, ..Settings::default() },
        Settings { max_throws: 100, ..Settings::default() },
    ] {
        let with_bounds = |Settings { path, .. }| Settings { ballast_mib: 1, low_disk_mib: 0, path, ..bounds.clone() };
        let (_folder, store) = fresh_with(with_bounds).await;
        judged(&store, 1, 40).await;
        let flood: Vec<_> = (1..=1000).map(|no| received("loud", "b1", no, 0)).collect();
        for answer in store.spool_all(&flood).await.unwrap() {
            let Spooled::New(row) = answer else { panic!() };
            judge(&store, judgement(row, "loud")).await.unwrap();
        }
        for _ in 0..20 {
            store.keep_bounds(Some(at(0))).await.unwrap();
        }
        let count = "SELECT count(*) FROM trace JOIN throw USING (throw_row) JOIN machine USING (machine_row) WHERE machine = '21B'";
        assert_eq!(query::<(i64,)>(&store, count).await, [(40,)], "{bounds:?}");
        let statistics = store.statistics().await.unwrap();
        assert!(statistics.data_bytes <= bounds.max_size_mib << 20 && statistics.traces <= bounds.max_traces);
        assert!(statistics.throws <= bounds.max_throws, "{} throws", statistics.throws);
        let really: Vec<(i64, i64)> =
            query(&store, "SELECT (SELECT count(*) FROM throw), (SELECT count(*) FROM trace)").await;
        assert_eq!(
            really,
            [(statistics.throws.cast_signed(), statistics.traces.cast_signed())],
            "the counters are correct"
        );
    }
}

#[tokio::test]
async fn age_counts_only_while_the_clock_is_trusted() {
    let (_folder, store) = fresh().await;
    judged(&store, 1, 20).await;
    let in_eleven_years: Timestamp = at(0) + SignedDuration::from_hours(24 * 365 * 11);
    assert!(store.keep_bounds(None).await.unwrap().is_empty());
    assert!(store.keep_bounds(Some(at(0) - SignedDuration::from_hours(24))).await.unwrap().is_empty());
    let done = store.keep_bounds(Some(in_eleven_years)).await.unwrap();
    assert_eq!(done, BTreeMap::from([(Dropped::Traces, 20)]));
}

/// Two throws were received while the daemon's clock was years ahead, two while it was not set after a loss of power.
#[tokio::test]
async fn a_trace_received_with_a_wrong_clock_is_as_old_as_the_next_one() {
    let (_folder, store) = fresh_with(|settings| Settings { trace_days: 30, ..settings }).await;
    let day = |days: i64| at(86_400 * days);
    let times = [day(4000), day(0), Timestamp::UNIX_EPOCH, day(10), day(4000), Timestamp::UNIX_EPOCH, day(50)];
    for (throw_no, received_at) in (1..).zip(times) {
        judged_at(&store, throw_no, received_at).await;
    }
    let mut left = Vec::new();
    for now in [day(29), day(35), day(45), day(79), day(81)] {
        store.keep_bounds(Some(now)).await.unwrap();
        left.push(query::<(i64,)>(&store, "SELECT count(*) FROM trace").await[0].0);
    }
    assert_eq!(left, [7, 5, 3, 3, 0]);
}

#[tokio::test]
async fn a_broken_database_is_set_aside_and_a_fresh_one_begins() {
    for pages in [8..40, 0..1] {
        let folder = tempfile::tempdir().unwrap();
        let opened = open(folder.path()).await;
        judged(&opened.store, 1, 100).await;
        opened.store.close().await.unwrap();
        let path = folder.path().join("points.db");
        // Clears the mark of the clean stop, then overwrites pages in the middle, or the first page.
        change(&path, ["UPDATE shutdown SET clean = 0", "PRAGMA wal_checkpoint(TRUNCATE)"]).await;
        overwrite(&path, pages);
        let bytes = fs::read(&path).unwrap();

        let opened = open(folder.path()).await;
        let Found::SetAside { to, why, .. } = &opened.report.found else { panic!("{:?}", opened.report) };
        assert!(!why.is_empty());
        assert_eq!(fs::read(to).unwrap(), bytes, "the broken file is kept as it was");
        spooled(&opened.store, "21B", "b1", 101).await;
        opened.store.close().await.unwrap();
        assert_eq!(open(folder.path()).await.report.found, Found::Clean);
    }
}

/// A running daemon marks the database file itself, so a copy without its log does not count as cleanly stopped.
#[tokio::test]
async fn a_lost_log_is_no_clean_stop() {
    let folder = stopped().await;
    let running = open(folder.path()).await;
    assert_eq!(running.report.found, Found::Clean);
    // A program that reads the copy leaves an empty log.
    for is_read in [false, true] {
        let copied = tempfile::tempdir().unwrap();
        fs::copy(folder.path().join("points.db"), copied.path().join("points.db")).unwrap();
        if is_read {
            fs::write(copied.path().join("points.db-wal"), "").unwrap();
        }
        assert_eq!(open(copied.path()).await.report.found, Found::WithoutLog, "{is_read}");
    }
}

/// The last commits may be in the log only, and SQLite deletes the log if the database is missing.
#[tokio::test]
async fn a_log_without_its_database_is_set_aside() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("points.db");
    let store = open(folder.path()).await.store;
    judged(&store, 1, 10).await;
    // A log of a store that was not closed, as after a kill.
    let left = tempfile::tempdir().unwrap();
    fs::copy(folder.path().join("points.db-wal"), left.path().join("points.db-wal")).unwrap();
    let log = fs::read(left.path().join("points.db-wal")).unwrap();
    assert!(!log.is_empty() && path.exists());

    let opened = open(left.path()).await;
    let Found::SetAside { to, .. } = &opened.report.found else { panic!("{:?}", opened.report) };
    assert_eq!(fs::read(to).unwrap(), log);
    assert!(opened.store.trouble(None).unwrap().1.contains("set aside"), "no alarm would be raised");
}

#[tokio::test]
async fn the_database_of_another_program_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("points.db");
    change(&path, ["CREATE TABLE users (name TEXT)"]).await;
    let before = fs::read(&path).unwrap();
    let refused = Store::open(&settings(folder.path()), at(0)).await.err().unwrap();
    assert!(matches!(&refused, StoreError::Foreign(says) if says.contains("table users")), "{refused}");
    assert_eq!(fs::read(&path).unwrap(), before);
    assert!(!folder.path().join("points.db-wal").exists());
}

#[tokio::test]
async fn a_text_file_at_the_path_of_the_database_and_its_neighbours_are_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let files = [("points.db", "time_s,current_a\n0,0.01\n".repeat(9)), ("points.db-1", "x".to_owned())];
    for (name, text) in &files {
        fs::write(folder.path().join(name), text).unwrap();
    }
    let refused = Store::open(&settings(folder.path()), at(0)).await.err().unwrap();
    assert!(matches!(&refused, StoreError::Foreign(says) if says.contains("text file")), "{refused}");
    for (name, text) in &files {
        assert_eq!(&fs::read_to_string(folder.path().join(name)).unwrap(), text);
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}

/// A database with 1,500 throws after a clean stop.
async fn stopped() -> tempfile::TempDir {
    let (folder, store) = fresh().await;
    let batch: Vec<_> = (1..=1500).map(|no| received("21B", "b1", no, 0)).collect();
    store.spool_all(&batch).await.unwrap();
    store.close().await.unwrap();
    folder
}

/// An open database with 1,500 throws. All pages after the first 60 are broken; SQLite detects this when it reads them.
async fn broken_under_way() -> (tempfile::TempDir, Store) {
    let folder = stopped().await;
    let opened = open(folder.path()).await;
    assert_eq!(opened.report.found, Found::Clean);
    break_pages(folder.path());
    (folder, opened.store)
}

fn break_pages(folder: &Path) {
    let database = folder.join("points.db");
    let pages = fs::metadata(&database).unwrap().len() / PAGE;
    overwrite(&database, 60..pages);
}

#[tokio::test]
async fn a_database_that_breaks_under_way_ends_the_writer_and_the_next_start_sets_it_aside() {
    let (folder, store) = broken_under_way().await;
    let error = store.spool(&machine("21B"), &throw("b1", 1501), at(0)).await.unwrap_err();
    assert!(error.to_string().contains("malformed"), "{error}");
    store.stopped().await;
    let opened = open(folder.path()).await;
    assert!(matches!(opened.report.found, Found::SetAside { .. }), "{:?}", opened.report);
    opened.store.spool(&machine("21B"), &throw("b2", 1), at(0)).await.unwrap();
}

/// A file may be damaged after a clean stop: it is checked at the start in any case.
#[tokio::test]
async fn a_file_that_was_broken_after_a_clean_stop_is_found_at_the_start() {
    let folder = stopped().await;
    break_pages(folder.path());
    assert!(matches!(open(folder.path()).await.report.found, Found::SetAside { .. }));
}

#[tokio::test]
async fn a_database_of_a_newer_version_opens_and_keeps_its_additions() {
    let folder = tempfile::tempdir().unwrap();
    let opened = open(folder.path()).await;
    spooled(&opened.store, "21B", "b1", 1).await;
    opened.store.close().await.unwrap();
    let migration = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) \
                     VALUES (9999, 'wind', 1, x'00', 1)";
    change(folder.path().join("points.db"), ["ALTER TABLE throw ADD COLUMN wind_m_s REAL", migration]).await;
    let opened = open(folder.path()).await;
    assert!(opened.report.newer_schema && opened.report.found == Found::Clean);
    spooled(&opened.store, "21B", "b1", 2).await;
}

#[tokio::test]
async fn a_database_that_an_older_program_must_not_write_to_is_refused_and_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let opened = open(folder.path()).await;
    spooled(&opened.store, "21B", "b1", 1).await;
    opened.store.close().await.unwrap();
    change(folder.path().join("points.db"), ["PRAGMA user_version = 9999", "PRAGMA wal_checkpoint(TRUNCATE)"]).await;
    let before = fs::read(folder.path().join("points.db")).unwrap();
    let error = Store::open(&settings(folder.path()), at(0)).await.err().unwrap().to_string();
    assert!(error.contains("newer version of pointsd (schema 9999)") && error.contains("backup"), "{error}");
    assert_eq!(fs::read(folder.path().join("points.db")).unwrap(), before);
}

#[tokio::test]
async fn a_database_that_a_query_finds_broken_is_set_aside_at_the_next_start() {
    let (folder, store) = broken_under_way().await;
    let error = store.reader().throws(ThrowRow::START, 10_000).await.unwrap_err();
    assert!(error.to_string().contains("malformed"), "{error}");
    store.stopped().await;
    assert!(matches!(store.close().await, Err(StoreError::Broken)));
    assert!(matches!(open(folder.path()).await.report.found, Found::SetAside { .. }));
}

fn remove_database(folder: &Path) {
    for suffix in ["", "-wal", "-shm"] {
        fs::remove_file(folder.join(format!("points.db{suffix}"))).unwrap();
    }
}

/// Writes until a problem shows. The daemon writes at least every 5 s.
pub(crate) async fn until_trouble(store: &Store) {
    let noticed = async {
        while store.trouble(None).is_none() {
            tokio::time::sleep(Duration::from_millis(100)).await;
            store.outbox_sent(&[]).await.unwrap();
        }
    };
    tokio::time::timeout(Duration::from_secs(10), noticed).await.unwrap();
}

/// The writer still has the deleted files open, with all commits, and writes the rows to a new file.
#[tokio::test]
async fn a_database_that_is_deleted_or_replaced_under_the_daemon_is_noticed_and_written_anew() {
    for replaced in [false, true] {
        let (folder, store) = fresh().await;
        judged(&store, 1, 30).await;
        store.outbox_sent(&[]).await.unwrap();
        let path = folder.path().join("points.db");
        remove_database(folder.path());
        if replaced {
            fs::write(&path, "a backup of the operator").unwrap();
        }
        until_trouble(&store).await;
        let (severity, said) = store.trouble(None).unwrap();
        let happened = if replaced { "was replaced during operation" } else { "was deleted during operation" };
        assert!(severity == pointsd::diagnose::Severity::Critical && said.contains(happened), "{said}");
        assert_eq!(said.contains("points.db-replaced-"), replaced, "{said}");
        judged(&store, 31, 40).await;
        assert_eq!(query::<(i64,)>(&store, "SELECT count(*) FROM health_history").await, [(40,)]);
        store.close().await.unwrap();
        let opened = open(folder.path()).await;
        assert_eq!(opened.report.found, Found::Clean);
        assert_eq!(opened.store.reader().throws(ThrowRow::START, 100).await.unwrap().len(), 40);
        let strangers = files_with(folder.path(), &["-replaced-"]);
        assert_eq!(strangers.len(), usize::from(replaced), "the foreign file is kept");
    }
}

/// After a move the configured path is a link. The log of a deleted file behind it belongs to no other file.
#[tokio::test]
async fn a_moved_database_that_is_deleted_is_written_anew_or_its_log_set_aside() {
    for is_running in [true, false] {
        let (folder, store) = fresh_with(|settings| Settings { max_wal_mib: 1, ..settings }).await;
        let holder = reading(&store).await;
        let mut last = 0;
        while !store.path().is_symlink() {
            judged(&store, last + 1, last + 20).await;
            last += 20;
        }
        holder.close().await.unwrap();
        judged(&store, last + 1, last + 5).await;
        let moved = fs::canonicalize(store.path()).unwrap();
        if is_running {
            fs::remove_file(&moved).unwrap();
            until_trouble(&store).await;
            assert!(store.trouble(None).unwrap().1.contains("was deleted during operation"));
            judged(&store, last + 6, last + 10).await;
            store.close().await.unwrap();
            let opened = open(folder.path()).await;
            assert_eq!(opened.report.found, Found::Clean);
            assert_eq!(
                query::<(i64,)>(&opened.store, "SELECT count(*) FROM throw").await,
                [(i64::try_from(last).unwrap() + 10,)]
            );
        } else {
            let log = moved.with_file_name("points.db-moved-1-wal");
            let written = fs::read(&log).unwrap();
            assert!(!written.is_empty());
            store.close().await.unwrap();
            fs::remove_file(&moved).unwrap();
            fs::write(&log, &written).unwrap();
            let opened = open(folder.path()).await;
            let Found::SetAside { to, .. } = &opened.report.found else { panic!("{:?}", opened.report) };
            assert_eq!(fs::read(to).unwrap(), written);
            let (_, said) = opened.store.trouble(None).unwrap();
            assert!(said.contains("its database was missing; its write-ahead log was set aside as"), "{said}");
        }
    }
}

/// The open connection has the rows of a deleted file until a write fails. Then the connection is closed, and the rows
/// are lost.
#[tokio::test]
async fn a_failed_write_after_the_deletion_of_the_database_ends_the_writer() {
    for replaced in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let (path, old) = (folder.path().join("points.db"), folder.path().join("old.db"));
        open(folder.path()).await.store.close().await.unwrap();
        fs::copy(&path, &old).unwrap();
        let store = open(folder.path()).await.store;
        judged(&store, 1, 5).await;
        let refuse = "CREATE TRIGGER refuse BEFORE INSERT ON throw WHEN NEW.throw_no = 99 \
                      BEGIN SELECT RAISE(ABORT, 'refused'); END";
        change(&path, [refuse]).await;
        // The writer checks its files at most once per second.
        tokio::time::sleep(Duration::from_millis(1_100)).await;
        store.outbox_sent(&[]).await.unwrap();
        remove_database(folder.path());
        if replaced {
            fs::rename(&old, &path).unwrap();
        }
        store.spool(&machine("21B"), &throw("b1", 99), at(0)).await.unwrap_err();
        tokio::time::timeout(Duration::from_secs(5), store.stopped())
            .await
            .expect("the writer goes on without its rows");
        assert_eq!(path.exists(), replaced, "no empty database takes its place");
    }
}

/// The database could not move to a new file while a slow reader kept an old state. After the end of this reader the
/// log is limited again.
#[tokio::test]
async fn the_bound_of_the_log_holds_again_after_failed_moves() {
    const BOUND_MIB: u64 = 20;
    let (folder, store) = fresh_with(|settings| Settings { max_wal_mib: BOUND_MIB, ..settings }).await;
    let mut outsider = outsider(store.path()).await;
    let mut write_mib = async |mib: u64| {
        for _ in 0..mib {
            let large = "INSERT INTO quarantine (received_at_us, key, reason, payload_bytes, payload_start) \
                         VALUES (0, '', '', 0, zeroblob(1 << 20))";
            sqlx::query(large).execute(&mut outsider).await.unwrap();
        }
        store.outbox_sent(&[]).await.unwrap();
        // The writer limits the log after its answer, so a second write waits for this.
        store.outbox_sent(&[]).await.unwrap();
    };
    // A folder has the name of the copy, so the move fails.
    let blocked = folder.path().join("points.db-copy");
    fs::create_dir_all(blocked.join("in the way")).unwrap();
    let holder = reading(&store).await;
    write_mib(BOUND_MIB + 1).await;
    write_mib(BOUND_MIB / 2).await;
    assert!(store.wal_bytes() > (BOUND_MIB * 5 / 4) << 20, "{} bytes", store.wal_bytes());
    holder.close().await.unwrap();
    change(store.path(), ["PRAGMA wal_checkpoint(TRUNCATE)"]).await;
    write_mib(0).await;
    assert!(store.wal_bytes() < BOUND_MIB << 20, "{} bytes", store.wal_bytes());

    fs::remove_dir_all(&blocked).unwrap();
    let _holder = reading(&store).await;
    write_mib(BOUND_MIB + 1).await;
    let moved = folder.path().join("points.db-moved-1");
    assert!(moved.exists(), "the database did not move; the log has {} bytes", store.wal_bytes());
}

/// After a move the configured path is a link. If a backup replaces the link, the history behind the link must stay.
#[tokio::test]
async fn a_backup_restored_in_place_of_the_link_and_files_with_a_number_delete_nothing() {
    const MIB: u64 = 1;
    let (folder, store) = fresh_with(|settings| Settings { max_wal_mib: MIB, ..settings }).await;
    let path = store.path().to_owned();
    let holder = reading(&store).await;
    for round in 0..30 {
        judged(&store, 1 + 20 * round, 20 + 20 * round).await;
    }
    assert!(path.is_symlink());
    holder.close().await.unwrap();
    store.close().await.unwrap();
    let moved = fs::canonicalize(&path).unwrap();
    let history = fs::read(&moved).unwrap();
    let numbered = [1, 2].map(|number| folder.path().join(format!("points.db-{number}")));
    for copy in &numbered {
        fs::copy(&moved, copy).unwrap();
    }
    fs::remove_file(&path).unwrap();
    fs::copy(&moved, &path).unwrap();

    for _ in 0..2 {
        open(folder.path()).await.store.close().await.unwrap();
    }
    assert!(numbered.iter().all(|copy| fs::read(copy).unwrap() == history));
    let unused = files_with(folder.path(), &["points.db-unused-"]);
    let [unused] = &unused[..] else { panic!("{unused:?}") };
    assert_eq!(fs::read(folder.path().join(unused)).unwrap(), history);
}

#[tokio::test]
async fn a_reader_that_never_closes_bounds_neither_the_writer_nor_the_log() {
    let (folder, store) = fresh_with(|settings| Settings { max_wal_mib: 1, ..settings }).await;
    judged(&store, 1, 5).await;
    let mut holder = reading(&store).await;
    let count = "SELECT count(*) FROM throw";
    assert_eq!(sqlx::query_scalar::<_, i64>(count).fetch_one(&mut holder).await.unwrap(), 5);

    let mut largest = 0;
    for round in 0..30u64 {
        judged(&store, 6 + 20 * round, 25 + 20 * round).await;
        largest = largest.max(store.wal_bytes());
    }
    assert!(largest < 3 << 20, "the log grew to {largest} bytes");
    // The reader keeps its old state; other connections get the new file.
    assert_eq!(sqlx::query_scalar::<_, i64>(count).fetch_one(&mut holder).await.unwrap(), 5);
    assert_eq!(query::<(i64,)>(&store, "SELECT count(*) FROM health_history").await, [(605,)]);
    assert_eq!(store.reader().throws(ThrowRow::START, 1000).await.unwrap().len(), 605);
    holder.close().await.unwrap();
    store.close().await.unwrap();

    let opened = open(folder.path()).await;
    assert_eq!(opened.report.found, Found::Clean);
    assert_eq!(opened.store.reader().throws(ThrowRow::START, 1000).await.unwrap().len(), 605);
    let databases = fs::read_dir(folder.path()).unwrap().filter(|entry| {
        let name = entry.as_ref().unwrap().file_name().into_string().unwrap();
        !(name.ends_with("-wal") || name.ends_with("-shm") || name.ends_with("-ballast"))
    });
    assert_eq!(databases.count(), 2, "the link and its file");
}

/// The copy of a large database takes minutes on flash. Its progress shows that the loops that wait for the writer do
/// not hang.
#[tokio::test]
async fn a_copy_away_from_a_slow_reader_shows_its_progress() {
    let (_folder, store) = fresh_with(|settings| Settings { max_wal_mib: 1, ..settings }).await;
    judged(&store, 1, 5).await;
    assert!(!store.is_copying());
    let holder = reading(&store).await;
    let throws: Vec<_> = (6..600).map(|no| received("21B", "b1", no, 0)).collect();
    store.spool_all(&throws).await.unwrap();
    // The writer copies after its answer; the next write waits for the copy.
    store.outbox_sent(&[]).await.unwrap();
    assert!(store.is_copying(), "no progress was recorded");
    holder.close().await.unwrap();
    store.close().await.unwrap();
}

/// Three hundred alarms with two events each. All alarms but the first are closed.
const OLD_ALARMS: [&str; 3] = [
    "INSERT INTO machine (site, machine) VALUES ('north', '21B')",
    "WITH RECURSIVE number (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM number WHERE n < 300)
     INSERT INTO alarm (alarm_id, machine_row, cause, raised_at_us, last_event_no, state)
     SELECT 'north.21B.friction.' || n, 1, 'friction', n, 2, CASE n WHEN 1 THEN 'active_unacknowledged' ELSE 'normal' END
       FROM number",
    "INSERT INTO alarm_event (alarm_row, event_no, event_at_us, severity, state, payload)
     SELECT alarm_row, event_no, raised_at_us, 'warning', state, '{}'
       FROM alarm, (SELECT 1 AS event_no UNION ALL SELECT 2)",
];

#[tokio::test]
async fn closed_alarms_are_bounded_and_go_with_their_events_and_open_ones_stay() {
    let (_folder, store) = fresh_with(|settings| Settings { max_alarms: 100, ..settings }).await;
    change(store.path(), OLD_ALARMS).await;
    store.keep_bounds(Some(at(0))).await.unwrap();
    let left = "SELECT count(*), min(alarm_row), (SELECT count(*) FROM alarm_event) FROM alarm";
    assert_eq!(query::<(i64, i64, i64)>(&store, left).await, [(101, 1, 202)]);
    let oldest_closed = "SELECT min(alarm_row) FROM alarm WHERE state = 'normal'";
    assert_eq!(query::<(i64,)>(&store, oldest_closed).await, [(201,)]);
}

/// A logger restarts at each throw, in a fleet of many quiet machines. Its boots are deleted after all their throws.
#[tokio::test]
async fn empty_boots_are_deleted_also_behind_those_of_many_quiet_machines() {
    let (_folder, store) = fresh_with(|settings| Settings { max_throws: 1_000, max_traces: 1_000, ..settings }).await;
    let statements = [
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 1500) \
         INSERT INTO machine (site, machine) SELECT 'north', 'quiet-' || i FROM n",
        "INSERT INTO boot (machine_row, boot_id, first_seen_us, highest_no, position) \
         SELECT machine_row, 'b1', 0, 1, 1000000 FROM machine",
    ];
    change(store.path(), statements).await;
    for boot in 0..1_100 {
        given::judged(&store, "loud", &format!("b{boot}"), 1).await;
    }
    store.keep_bounds(Some(at(0))).await.unwrap();
    let loud = "SELECT count(*) FROM boot JOIN machine USING (machine_row) WHERE machine = 'loud'";
    // The boots with throws, and the boot at which the backlog cursor of the machine is.
    assert_eq!(query::<(i64,)>(&store, loud).await, [(1_001,)]);
    assert_eq!(query::<(i64,)>(&store, "SELECT count(*) FROM boot").await, [(2_501,)]);
}
