//! The files of the database: broken, foreign, missing, deleted and replaced ones; links; moves to a new file.

use std::{fs, os::unix::fs::symlink, path::Path, process::Command, time::Duration};

use pointsd::store::{Found, Settings, Store, StoreError, ThrowRow};
use sqlx::Connection;

use crate::{
    given::{
        PAGE, at, change, files_with, fresh, fresh_with, machine, open, outsider, overwrite, query, reading, received,
        settings, spooled, throw,
    },
    keeping::judged,
    small_disk::SmallDisk,
};

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
    let folder = stopped().await;
    let migration = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) \
                     VALUES (9999, 'wind', 1, x'00', 1)";
    change(folder.path().join("points.db"), ["ALTER TABLE throw ADD COLUMN wind_m_s REAL", migration]).await;
    let opened = open(folder.path()).await;
    assert!(opened.report.newer_schema && opened.report.found == Found::Clean);
    spooled(&opened.store, "21B", "b1", 1501).await;
}

#[tokio::test]
async fn a_database_that_an_older_program_must_not_write_to_is_refused_and_left_as_it_is() {
    let folder = stopped().await;
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

/// Removes the files of the database with these suffixes.
fn remove(folder: &Path, suffixes: &[&str]) {
    for suffix in suffixes {
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
    for (deleted, replaced) in [(&["", "-wal", "-shm"][..], false), (&["", "-wal", "-shm"], true), (&["-wal"], false)] {
        let (folder, store) = fresh().await;
        judged(&store, 1, 30).await;
        store.outbox_sent(&[]).await.unwrap();
        let path = folder.path().join("points.db");
        remove(folder.path(), deleted);
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
        remove(folder.path(), &["", "-wal", "-shm"]);
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

/// The configured path is a mount point, which no other file can replace: the last step of each move fails.
#[tokio::test]
async fn a_failed_move_leaves_no_file() {
    let Some(disk) = SmallDisk::of_mib(64) else { return };
    let settings = Settings { max_wal_mib: 1, ..settings(disk.folder()) };
    let store = Store::open(&settings, at(0)).await.unwrap().store;
    let mounted = Command::new("mount").arg("--bind").args([&settings.path, &settings.path]).status().unwrap();
    assert!(mounted.success());
    let holder = reading(&store).await;
    let mut last = 0;
    while store.wal_bytes() < 3 << 20 {
        judged(&store, last + 1, last + 20).await;
        last += 20;
    }
    assert!(!settings.path.is_symlink());
    assert_eq!(files_with(disk.folder(), &["-moved-", "-copy", "-link"]), Vec::<String>::new());
    holder.close().await.unwrap();
    store.close().await.unwrap();
}

/// The configured path is an administrator's link to another disk. The database stays there.
#[tokio::test]
async fn a_link_into_another_folder_stays() {
    let (folder, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let target = other.path().join("large.db");
    symlink(&target, folder.path().join("points.db")).unwrap();
    let settings = Settings { max_wal_mib: 1, ..settings(folder.path()) };
    let store = Store::open(&settings, at(0)).await.unwrap().store;
    let holder = reading(&store).await;
    judged(&store, 1, 100).await;
    holder.close().await.unwrap();
    store.close().await.unwrap();
    assert!(target.is_symlink(), "the database did not move");
    let moved = fs::canonicalize(&target).unwrap();
    overwrite(&moved, 8..fs::metadata(&moved).unwrap().len() / PAGE);

    let opened = Store::open(&settings, at(0)).await.unwrap();
    let Found::SetAside { to, .. } = &opened.report.found else { panic!("{:?}", opened.report) };
    assert_eq!(to.parent(), Some(other.path()));
    judged(&opened.store, 101, 101).await;
    opened.store.close().await.unwrap();
    assert_eq!(Store::open(&settings, at(0)).await.unwrap().report.found, Found::Clean);
    assert_eq!(fs::read_link(&settings.path).unwrap(), target);
    assert_eq!(files_with(folder.path(), &["points.db"]), ["points.db"]);
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
