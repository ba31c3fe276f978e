//! Times of decoding a message, judging an estimate and storing a throw.

use std::{hint::black_box, time::Duration};

use criterion::{BatchSize, Criterion};
use jiff::Timestamp;
use pointsd::{
    diagnose::{self, MachineMonitor, Observation},
    estimate::{self, Identifier},
    store::{self, ReceivedThrow, Store},
    throw::Throw,
    wire::{Encoding, decode_throw, encode_throw},
};
use sqlx::{Connection as _, SqliteConnection};

use crate::{
    fleet::{machine, throws},
    json::json_message,
};

/// Throws in a group of the store.
const GROUP: u64 = 64;

/// Decodes a message in CBOR, and in JSON.
pub(crate) fn decoding(criterion: &mut Criterion) {
    let throw = &throws(1)[0];
    let mut group = criterion.benchmark_group("decode");
    for (name, encoding, message) in
        [("cbor", Encoding::Cbor, encode_throw(throw)), ("json", Encoding::Json, json_message(throw))]
    {
        group.bench_function(name, |bencher| bencher.iter(|| decode_throw(encoding, black_box(&message))));
    }
    group.finish();
}

/// Judges an estimate with a monitor that has a complete baseline; and identifies the throw, for comparison.
pub(crate) fn diagnosis(criterion: &mut Criterion) {
    let (mut identifier, settings) = (Identifier::default(), estimate::Settings::default());
    let throws = throws(132);
    let observations: Vec<_> = throws.iter().map(|throw| observation(throw, &mut identifier, &settings)).collect();
    let (past, new) = observations.split_at(130);
    let settings_of_diagnosis = diagnose::Settings::default();
    let mut monitor = MachineMonitor::new("21B");
    for observation in past {
        monitor.observe(observation, &settings_of_diagnosis);
    }
    let mut group = criterion.benchmark_group("judge");
    group.bench_function("diagnosis", |bencher| {
        bencher.iter_batched(
            || monitor.clone(),
            |mut monitor| (monitor.observe(black_box(&new[0]), &settings_of_diagnosis), monitor),
            BatchSize::SmallInput,
        );
    });
    group.bench_function("identification", |bencher| {
        bencher.iter(|| identifier.identify(black_box(&throws[130]), &settings));
    });
    group.finish();
}

fn observation(throw: &Throw, identifier: &mut Identifier, settings: &estimate::Settings) -> Observation {
    let found = identifier.identify(throw, settings);
    Observation::of(throw, &found)
}

/// Compresses and commits a group of received throws; and, for comparison, the same samples as raw blobs in one table.
pub(crate) fn storing(criterion: &mut Criterion) {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("a runtime");
    let folder = tempfile::tempdir().expect("a folder");
    let settings = store::Settings { path: folder.path().join("points.db"), ballast_mib: 0, ..Default::default() };
    let store = runtime.block_on(Store::open(&settings, Timestamp::UNIX_EPOCH)).expect("a database").store;
    let throws = throws(GROUP);
    let mut throw_no = 0;
    // Each group has one throw of each of `GROUP` machines.
    let mut group_of = || -> Vec<ReceivedThrow> {
        throw_no += 1;
        let renamed = (1..).zip(throws.iter().cloned()).map(|(number, mut throw)| {
            throw.id.throw_no = throw_no;
            ReceivedThrow { machine: machine(number), throw, received_at: Timestamp::UNIX_EPOCH }
        });
        renamed.collect()
    };
    let mut group = criterion.benchmark_group("store a group");
    group.sample_size(20).measurement_time(Duration::from_secs(8));
    group.bench_function("compressed", |bencher| {
        bencher.iter_batched(
            &mut group_of,
            |throws| {
                runtime.block_on(store.spool_all(&throws)).expect("stored throws");
            },
            BatchSize::PerIteration,
        );
    });
    let mut raw = runtime.block_on(raw_database(&folder.path().join("raw.db")));
    group.bench_function("raw", |bencher| bencher.iter(|| runtime.block_on(insert_raw(&mut raw, &throws))));
    group.finish();
    runtime.block_on(store.close()).expect("a closed database");
}

async fn raw_database(path: &std::path::Path) -> SqliteConnection {
    let mut connection =
        SqliteConnection::connect(&format!("sqlite://{}?mode=rwc", path.display())).await.expect("raw");
    for statement in
        ["PRAGMA journal_mode = wal", "PRAGMA synchronous = full", "CREATE TABLE throw (current BLOB, position BLOB)"]
    {
        sqlx::query(statement).execute(&mut connection).await.expect("a statement");
    }
    connection
}

async fn insert_raw(connection: &mut SqliteConnection, throws: &[Throw]) {
    let mut transaction = connection.begin().await.expect("a transaction");
    for throw in throws {
        let [current, position] = [throw.trace.current_a(), throw.trace.position_mm()].map(floats);
        let insert = sqlx::query("INSERT INTO throw VALUES (?, ?)").bind(current).bind(position);
        insert.execute(&mut *transaction).await.expect("a row");
    }
    transaction.commit().await.expect("a commit");
}

/// Little-endian 32-bit floats.
pub(crate) fn floats(values: &[f64]) -> Vec<u8> {
    #[expect(clippy::cast_possible_truncation, reason = "loggers send 32-bit floats")]
    values.iter().flat_map(|value| (*value as f32).to_le_bytes()).collect()
}
