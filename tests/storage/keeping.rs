//! Retention: limits of rows, bytes and age; clock jumps.

use std::{collections::BTreeMap, time::Duration};

use jiff::{SignedDuration, Timestamp};
use pointsd::{
    diagnose::AlarmState,
    store::{Dropped, Settings, Spooled, Store},
};

use crate::given::{
    self, alarm, at, change, fresh, fresh_with, judge, judgement, machine, query, received, settings, spooled, throw,
};

/// Stores and judges the throws `first` to `last`, received one minute after another.
pub(crate) async fn judged(store: &Store, first: u64, last: u64) {
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

/// Another program has copied the database without auto-vacuum, so its unused pages cannot be returned to the disk.
#[tokio::test]
async fn pages_that_cannot_be_returned_to_the_disk_are_not_counted() {
    for mode in ["PRAGMA auto_vacuum = INCREMENTAL", "PRAGMA auto_vacuum = NONE"] {
        let folder = tempfile::tempdir().unwrap();
        let settings = Settings { low_disk_mib: 1 << 20, ..settings(folder.path()) };
        Store::open(&settings, at(0)).await.unwrap().store.close().await.unwrap();
        let large = "INSERT INTO quarantine (received_at_us, key, reason, payload_bytes, payload_start) \
                     VALUES (0, '', '', 0, zeroblob(4 << 20))";
        change(&settings.path, [mode, "VACUUM", large, "DELETE FROM quarantine"]).await;
        let store = Store::open(&settings, at(0)).await.unwrap().store;
        let returned = store.keep_bounds(None).await.unwrap();
        assert_eq!(returned.contains_key(&Dropped::Pages), mode.ends_with("INCREMENTAL"), "{returned:?}");
    }
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

/// After a loss of power the daemon has stored a backlog before its clock was set.
#[tokio::test]
async fn many_traces_without_a_usable_time_do_not_stop_the_limit_of_age() {
    let (_folder, store) = fresh_with(|settings| Settings { trace_days: 30, ..settings }).await;
    let day = |days: i64| at(86_400 * days);
    for throw_no in 1..=100 {
        judged_at(&store, throw_no, Timestamp::UNIX_EPOCH).await;
    }
    judged_at(&store, 101, day(0)).await;
    judged_at(&store, 102, day(50)).await;
    store.keep_bounds(Some(day(60))).await.unwrap();
    assert_eq!(query::<(i64,)>(&store, "SELECT count(*) FROM trace").await[0].0, 1);
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

/// The next throws fill the gap before the wrong number. With the number deleted, they must not count as deleted too.
#[tokio::test]
async fn a_deleted_throw_with_a_wrong_number_makes_no_later_throw_a_duplicate() {
    let (_folder, store) = fresh_with(|settings| Settings { max_throws: 100, ..settings }).await;
    for throw_no in (1..=50).chain([900_000]).chain(51..=160) {
        judged_at(&store, throw_no, at(60 * i64::try_from(throw_no).unwrap())).await;
    }
    let done = store.keep_bounds(Some(at(0))).await.unwrap();
    assert_eq!(done[&Dropped::Throws], 61);
    judged(&store, 161, 165).await;
    let again = store.spool(&machine("21B"), &throw("b1", 7), at(0)).await.unwrap();
    assert_eq!(again, Spooled::Duplicate);
}

#[tokio::test]
async fn a_counter_that_restarts_below_the_deleted_numbers_makes_no_duplicates() {
    let (_folder, store) = fresh_with(|settings| Settings { max_throws: 100, ..settings }).await;
    judged(&store, 1, 200).await;
    store.keep_bounds(Some(at(0))).await.unwrap();
    for throw_no in 1..=3 {
        let mut later = throw("b1", throw_no);
        later.started_at += SignedDuration::from_hours(24 * 365);
        let answer = store.spool(&machine("21B"), &later, at(20_000)).await.unwrap();
        assert!(matches!(answer, Spooled::New(_)), "{throw_no}: {answer:?}");
        let again = store.spool(&machine("21B"), &later, at(20_000)).await.unwrap();
        assert_eq!(again, Spooled::Duplicate);
    }
    assert_eq!(store.statistics().await.unwrap().counters()["contradicted_throws"], 3);
}
