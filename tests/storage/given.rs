//! Common input of the tests: stores on disk in folders of their own, throws, estimates, alarm events.

use std::{fs, ops::Range, os::unix::fs::FileExt, path::Path};

use jiff::{SignedDuration, Timestamp};
use nalgebra::Matrix3;
use pointsd::{
    diagnose::{AlarmEvent, AlarmState, Cause, Drifting, LimitForecast, MachineState, Present, Severity},
    estimate::{Estimate, Features, Fit, Grade, Identification},
    store::{Judgement, MonitorRecord, Opened, Outcome, ReceivedThrow, Settings, Spooled, Store, StoreError, ThrowRow},
    throw::{Direction, MachineId, Throw, ThrowRef, Trace},
    wire::{BaselineProgress, Health},
};
use sqlx::{Connection, SqliteConnection, sqlite::SqliteConnectOptions};
use tempfile::TempDir;

pub(crate) fn settings(folder: &Path) -> Settings {
    Settings { path: folder.join("points.db"), ballast_mib: 1, low_disk_mib: 0, ..Settings::default() }
}

pub(crate) async fn open(folder: &Path) -> Opened {
    Store::open(&settings(folder), at(0)).await.unwrap()
}

/// A new store in a new folder; dropping the returned folder removes it.
pub(crate) async fn fresh() -> (TempDir, Store) {
    fresh_with(|settings| settings).await
}

/// A new store with settings changed by `change`.
pub(crate) async fn fresh_with(change: impl FnOnce(Settings) -> Settings) -> (TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let opened = Store::open(&change(settings(folder.path())), at(0)).await.unwrap();
    (folder, opened.store)
}

pub(crate) fn machine(name: &str) -> MachineId {
    MachineId::new("north", name).unwrap()
}

/// The start time of the tests plus `seconds`.
pub(crate) fn at(seconds: i64) -> Timestamp {
    "2026-03-01T06:00:00.25Z".parse::<Timestamp>().unwrap() + SignedDuration::from_secs(seconds)
}

/// A throw of a machine that is received `seconds` after the start of the tests.
pub(crate) fn received(name: &str, boot_id: &str, throw_no: u64, seconds: i64) -> ReceivedThrow {
    ReceivedThrow { machine: machine(name), throw: throw(boot_id, throw_no), received_at: at(seconds) }
}

/// A throw with different samples for each number.
pub(crate) fn throw(boot_id: &str, throw_no: u64) -> Throw {
    let wave = |scale: f64| (0..400).map(|sample| (f64::from(sample) * scale).sin() + throw_no as f64).collect();
    Throw {
        id: ThrowRef { boot_id: boot_id.to_owned(), throw_no },
        started_at: at(60 * i64::try_from(throw_no).unwrap()),
        direction: Some(Direction::NormalToReverse),
        temperature_c: Some(12.5),
        ..Throw::recorded(Trace::new(1000.0, wave(0.01), wave(0.003)).unwrap())
    }
}

pub(crate) async fn spooled(store: &Store, name: &str, boot_id: &str, throw_no: u64) -> ThrowRow {
    match store.spool(&machine(name), &throw(boot_id, throw_no), at(0)).await.unwrap() {
        Spooled::New(row) => row,
        Spooled::Duplicate => panic!("throw {throw_no} was already stored"),
    }
}

pub(crate) fn estimate() -> Estimate {
    Estimate {
        grade: Grade::Good,
        ratios_only: false,
        running: None,
        systematic: Matrix3::zeros(),
        offset: [0.0; 3],
        reason: None,
        b0: 203.0,
        a1: 5.9,
        a0: 1.56,
        covariance: Matrix3::new(4.0, 0.1, 0.02, 0.1, 0.25, 0.01, 0.02, 0.01, 0.0625),
        fit: Some(Fit { pct: 99.7, iterations: 4 }),
        start_s: 0.1,
        end_s: 4.2,
    }
}

pub(crate) fn judgement(row: ThrowRow, name: &str) -> Judgement {
    let estimate = estimate();
    let throw = ThrowRef { boot_id: "b1".to_owned(), throw_no: row.0.cast_unsigned() };
    Judgement {
        row,
        health: Health {
            direction: Some(Direction::NormalToReverse),
            coefficients: Some(estimate.coefficients()),
            sd: Some(estimate.sd()),
            change_pct: Some([0.5, -1.0, 2.0]),
            fit_pct: estimate.fit.map(|fit| fit.pct),
            a1_per_b0: Some(estimate.ratios()[0]),
            a1_per_b0_sd: Some(estimate.ratios_sd()[0]),
            a0_per_b0: Some(estimate.ratios()[1]),
            a0_per_b0_sd: Some(estimate.ratios_sd()[1]),
            duration_s: Some(4.3),
            peak_current_a: Some(13.0),
            state: Some(MachineState::Healthy),
            baseline: Some(BaselineProgress { so_far: 50, needed: 50 }),
            throws_since_baseline: 1,
            ..Health::rejected(machine(name), throw, at(0), "good", None)
        },
        identification: Some(Identification {
            direction: Some(Direction::NormalToReverse),
            direction_contradicted: Some(false),
            features: Features { charge_as: Some(12.5), no_load_speed_rad_per_s: Some(17.0), ..Features::default() },
            unused_fields: None,
            short_of_stroke_mm: None,
            outcome: Ok(estimate),
        }),
        baselines: Vec::new(),
        outcome: outcome(name, Vec::new()),
    }
}

/// Stores a judgement.
pub(crate) async fn judge(store: &Store, judgement: Judgement) -> Result<(), StoreError> {
    store.judge_all([judgement].into()).await
}

/// Number of pending throws.
pub(crate) async fn pending(store: &Store) -> u64 {
    store.statistics().await.unwrap().pending
}

/// Boot, first and last number of the open gaps, oldest first.
pub(crate) async fn gaps(store: &Store) -> Vec<(String, i64, i64)> {
    query(store, "SELECT boot_id, first_throw_no, last_throw_no FROM data_gaps WHERE filled_at IS NULL").await
}

/// The outcome of a machine with these alarm events and without a monitor.
pub(crate) fn outcome(name: &str, events: Vec<AlarmEvent>) -> Outcome {
    Outcome { machine: machine(name), at: at(1), monitor: None, events, reported_gaps: Vec::new(), command: None }
}

pub(crate) fn event(event_no: u32, state: AlarmState) -> AlarmEvent {
    AlarmEvent {
        cause: Cause::Friction,
        raised_at: at(10),
        event_no,
        severity: Severity::Warning,
        state,
        event_at: at(10 * i64::from(event_no)),
        change_pct: Some(18.0),
        change_pct_sd: Some(2.0),
        direction: Some(Direction::NormalToReverse),
        channel: None,
        runner_up: None,
        correlation: None,
        first_throw: Some(ThrowRef { boot_id: "b1".to_owned(), throw_no: 40 }),
        last_throw: Some(ThrowRef { boot_id: "b1".to_owned(), throw_no: 80 }),
        text: "friction up 18 %".to_owned(),
        limit_in_throws: None,
        by: (state == AlarmState::ActiveAcknowledged).then(|| "mia".to_owned()),
        why: None,
        text_at: None,
        over: false,
        acknowledged_by: None,
    }
}

/// The outcome of an alarm event (warning) of machine 21B, whose present drift is larger than the change in the event.
pub(crate) fn alarm(event_no: u32, state: AlarmState) -> Outcome {
    let monitor = MonitorRecord {
        snapshot: format!("{{\"events\":{event_no}}}"),
        present: Present {
            state: MachineState::Warning,
            drifts: vec![Drifting {
                cause: Cause::Friction,
                change_pct: 23.0,
                change_pct_sd: 1.0,
                direction: Some(Direction::NormalToReverse),
                limit_in_throws: Some(LimitForecast { low: 30.0, mid: 40.0, high: 60.0 }),
            }],
            caveats: vec!["the baseline has a trend".to_owned()],
        },
    };
    Outcome { monitor: Some(monitor), at: at(10 * i64::from(event_no)), ..outcome("21B", vec![event(event_no, state)]) }
}

/// Stores and judges a throw.
pub(crate) async fn judged(store: &Store, name: &str, boot_id: &str, throw_no: u64) {
    let row = spooled(store, name, boot_id, throw_no).await;
    judge(store, judgement(row, name)).await.unwrap();
}

/// The connection of another program to the database.
pub(crate) async fn outsider(database: impl AsRef<Path>) -> SqliteConnection {
    let options = SqliteConnectOptions::new().filename(database).create_if_missing(true);
    SqliteConnection::connect_with(&options).await.unwrap()
}

/// A connection of another program that keeps the present state open: the log cannot be truncated meanwhile.
pub(crate) async fn reading(store: &Store) -> SqliteConnection {
    let options = SqliteConnectOptions::new().filename(store.path()).read_only(true);
    let mut holder = SqliteConnection::connect_with(&options).await.unwrap();
    sqlx::query("BEGIN").execute(&mut holder).await.unwrap();
    sqlx::query("SELECT count(*) FROM throw").execute(&mut holder).await.unwrap();
    holder
}

/// Size of a page of the database.
pub(crate) const PAGE: u64 = 4096;

/// Overwrites pages of a database, counted from 0.
pub(crate) fn overwrite(database: &Path, pages: Range<u64>) {
    let file = fs::OpenOptions::new().write(true).open(database).unwrap();
    let garbage = vec![0x5a; usize::try_from((pages.end - pages.start) * PAGE).unwrap()];
    file.write_all_at(&garbage, pages.start * PAGE).unwrap();
}

/// The names of the files in a folder that contain one of these parts.
pub(crate) fn files_with(folder: &Path, parts: &[&str]) -> Vec<String> {
    let names = fs::read_dir(folder).unwrap().map(|file| file.unwrap().file_name().into_string().unwrap());
    names.filter(|name| parts.iter().any(|part| name.contains(part))).collect()
}

/// Changes the database as another program.
pub(crate) async fn change<const N: usize>(database: impl AsRef<Path>, statements: [&'static str; N]) {
    let mut outsider = outsider(database).await;
    for statement in statements {
        sqlx::query(statement).execute(&mut outsider).await.unwrap();
    }
    outsider.close().await.unwrap();
}

/// Reads a view as another program.
pub(crate) async fn query<T>(store: &Store, sql: &'static str) -> Vec<T>
where
    T: for<'r> sqlx::FromRow<'r, sqlx::sqlite::SqliteRow> + Send + Unpin,
{
    let mut outsider = outsider(store.path()).await;
    let rows = sqlx::query_as(sql).fetch_all(&mut outsider).await.unwrap();
    outsider.close().await.unwrap();
    rows
}
