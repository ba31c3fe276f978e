//! Judgements, alarms and messages are stored together, each of them once.

use jiff::Timestamp;
use pointsd::{
    diagnose::{AlarmEvent, AlarmState, MachineState},
    store::{Found, Judgement, OutboxRow, Selector, StoredMonitor, statements},
    throw::Direction,
    wire::{Alarm, alarm_id},
};
use sqlx::Row;

use crate::given::{
    alarm, at, change, event, fresh, judge, judged, judgement, machine, open, outcome, outsider, pending, query,
    spooled, throw,
};

#[tokio::test]
async fn a_judgement_is_written_once_and_the_views_show_it() {
    let (_folder, store) = fresh().await;
    let row = spooled(&store, "21B", "b1", 1).await;
    let judged = Judgement { outcome: alarm(1, AlarmState::ActiveUnacknowledged), ..judgement(row, "21B") };
    for _ in 0..2 {
        judge(&store, judged.clone()).await.unwrap();
    }
    assert_eq!(pending(&store).await, 0);
    assert_eq!(store.reader().outbox_pending(0, 10).await.unwrap().len(), 1);
    let rows: Vec<(i64, i64)> =
        query(&store, "SELECT (SELECT count(*) FROM estimate), (SELECT count(*) FROM alarm_event)").await;
    assert_eq!(rows, [(1, 1)], "written once");

    let health: Vec<(String, String, f64, f64, f64, i64, f64)> = query(
        &store,
        "SELECT started_at, direction, b0, b0_sd, a0_pct, CAST(strftime('%s', started_at) AS INTEGER), \
         (julianday(started_at) - 2440587.5) * 86400 FROM health_history",
    )
    .await;
    let (started_at, direction, b0, b0_sd, a0_pct, seconds, days) = &health[0];
    assert_eq!((started_at.as_str(), direction.as_str()), ("2026-03-01T06:01:00.250000Z", "normal_to_reverse"));
    assert_eq!((*b0, *b0_sd, *a0_pct), (203.0, 2.0, 2.0));
    assert_eq!(*seconds, at(60).as_second());
    assert!((days - at(60).as_microsecond() as f64 * 1e-6).abs() < 1e-3);

    let features: Vec<(String, f64, f64)> =
        query(&store, "SELECT quality, charge_as, no_load_speed_rad_per_s FROM throw_features").await;
    assert_eq!(features, [("good".to_owned(), 12.5, 17.0)]);

    let machines: Vec<(String, String, i64, f64, f64, f64)> = query(
        &store,
        "SELECT direction, state, throws_since_baseline, change_now_pct, change_now_pct_sd, limit_in_throws_now \
         FROM machine_health",
    )
    .await;
    assert_eq!(machines, [("normal_to_reverse".to_owned(), "warning".to_owned(), 1, 23.0, 1.0, 40.0)]);
    let caveats: Vec<(String, String)> = query(&store, "SELECT machine, caveat FROM machine_caveats").await;
    assert_eq!(caveats, [("21B".to_owned(), "the baseline has a trend".to_owned())]);
    let latest = store.reader().latest_health(&Selector::default()).await.unwrap();
    assert_eq!(latest[0].caveats, ["the baseline has a trend"]);
    let alarms: Vec<(f64, f64, String, f64)> =
        query(&store, "SELECT change_pct, change_now_pct, direction_now, limit_in_throws_now FROM active_alarms").await;
    assert_eq!(
        alarms,
        [(18.0, 23.0, "normal_to_reverse".to_owned(), 40.0)],
        "the values of the event, and the present values"
    );
}

#[tokio::test]
async fn judgements_of_a_group_are_written_in_order_and_once_each() {
    let (_folder, store) = fresh().await;
    let (first, second) = (spooled(&store, "21B", "b1", 1).await, spooled(&store, "21B", "b1", 2).await);
    let judged = |row, event_no| Judgement {
        outcome: alarm(event_no, AlarmState::ActiveUnacknowledged),
        ..judgement(row, "21B")
    };
    let group = [judged(first, 1), judged(first, 7), judged(second, 2)];
    store.judge_all(group.into()).await.unwrap();
    assert_eq!(query::<(i64,)>(&store, "SELECT count(*) FROM estimate").await, [(2,)]);
    let events: Vec<(i64,)> = query(&store, "SELECT event_no FROM alarm_events ORDER BY event_no").await;
    assert_eq!(events, [(1,), (2,)]);
    assert_eq!(store.reader().outbox_pending(0, 10).await.unwrap().len(), 2);
    assert_eq!(store.reader().monitors(None, 10).await.unwrap()[0].snapshot, "{\"events\":2}");
}

#[tokio::test]
async fn a_throw_that_was_not_evaluated_shows_with_its_reason() {
    let (_folder, store) = fresh().await;
    let row = spooled(&store, "21B", "b1", 1).await;
    let mut refused = Judgement { identification: None, ..judgement(row, "21B") };
    "no_movement".clone_into(&mut refused.health.quality);
    refused.health.detail = Some("the toe did not move".to_owned());
    (refused.health.coefficients, refused.health.change_pct) = (None, None);
    judge(&store, refused).await.unwrap();
    let seen: Vec<(String, String)> = query(&store, "SELECT quality, detail FROM throws_not_evaluated").await;
    assert_eq!(seen, [("no_movement".to_owned(), "the toe did not move".to_owned())]);
    let [health] = &store.reader().latest_health(&Selector::default()).await.unwrap()[..] else { panic!() };
    assert_eq!((health.quality.as_str(), health.coefficients), ("no_movement", None));
}

#[tokio::test]
async fn a_throw_of_unknown_direction_counts_until_the_next_one() {
    let (_folder, store) = fresh().await;
    let directions = async || {
        let latest = store.reader().latest_health(&Selector::default()).await.unwrap();
        latest.into_iter().map(|health| health.direction).collect::<Vec<_>>()
    };
    let row = spooled(&store, "21B", "b1", 1).await;
    let mut unknown = judgement(row, "21B");
    unknown.health.direction = None;
    judge(&store, unknown).await.unwrap();
    assert_eq!(directions().await, [None]);
    let in_view =
        async || query::<(String,)>(&store, "SELECT direction FROM machine_health ORDER BY started_at DESC").await;
    assert_eq!(in_view().await, [("unknown".to_owned(),)]);
    let row = spooled(&store, "21B", "b1", 2).await;
    judge(&store, judgement(row, "21B")).await.unwrap();
    assert_eq!(directions().await, [Some(Direction::NormalToReverse)]);
    assert_eq!(in_view().await, [("normal_to_reverse".to_owned(),)]);
    // The position sensor dies.
    let row = spooled(&store, "21B", "b1", 3).await;
    let mut unknown = judgement(row, "21B");
    unknown.health.direction = None;
    judge(&store, unknown).await.unwrap();
    assert_eq!(directions().await, [None, Some(Direction::NormalToReverse)]);
    assert_eq!(in_view().await, [("unknown".to_owned(),), ("normal_to_reverse".to_owned(),)]);
    let plan: Vec<(i64, i64, i64, String)> = query(&store, "EXPLAIN QUERY PLAN SELECT * FROM machine_health").await;
    assert!(plan.iter().any(|(.., step)| step.starts_with("SEARCH later USING PRIMARY KEY")), "{plan:?}");
}

#[tokio::test]
async fn an_alarm_lives_through_its_events_and_each_is_published_once() {
    let (_folder, store) = fresh().await;
    let id = machine("21B");
    let everything = Selector::default();
    store.record(alarm(1, AlarmState::ActiveUnacknowledged)).await.unwrap();
    store.record(alarm(2, AlarmState::ActiveAcknowledged)).await.unwrap();
    // A repetition, as after a commit that succeeded although it returned an error.
    store.record(alarm(2, AlarmState::ActiveAcknowledged)).await.unwrap();

    let [open_alarm] = &store.reader().open_alarms(&everything).await.unwrap()[..] else { panic!() };
    let raised = event(1, AlarmState::Normal);
    assert_eq!(open_alarm.alarm_id, alarm_id(&id, raised.cause, raised.raised_at));
    assert_eq!(open_alarm.alarm_id, format!("north.21B.friction.{}", at(10).as_microsecond()));
    assert_eq!(open_alarm.event, event(2, AlarmState::ActiveAcknowledged), "the event is restored completely");
    let acknowledged: Vec<(String, String)> =
        query(&store, "SELECT acknowledged_by, acknowledged_at FROM active_alarms").await;
    assert_eq!(acknowledged, [("mia".to_owned(), "2026-03-01T06:00:20.250000Z".to_owned())]);

    store.record(alarm(3, AlarmState::Normal)).await.unwrap();
    assert!(store.reader().open_alarms(&everything).await.unwrap().is_empty());
    let history = store.reader().alarm_history(&everything, at(15), 10).await.unwrap();
    assert_eq!(history.iter().map(|row| row.event_no).collect::<Vec<_>>(), [2, 3]);

    let messages = store.reader().outbox_pending(0, 10).await.unwrap();
    let read = |message: &OutboxRow| serde_json::from_slice::<Alarm>(&message.payload).unwrap().event_no;
    assert_eq!(messages.iter().map(read).collect::<Vec<_>>(), [1, 2, 3]);
    store.outbox_sent(&[messages[0].row, messages[1].row]).await.unwrap();
    assert_eq!(store.reader().outbox_pending(0, 10).await.unwrap()[..], messages[2..]);
}

/// Also if the alarm was silenced or over at that time, and another operator gave the next command.
#[tokio::test]
async fn the_views_have_who_acknowledged_an_alarm_and_when() {
    let mia = || Some("mia".to_owned());
    for (state, acknowledged_by) in [
        (AlarmState::Shelved, mia()),
        (AlarmState::OutOfService, mia()),
        (AlarmState::Normal, mia()),
        // As earlier versions stored it.
        (AlarmState::Normal, None),
    ] {
        let (_folder, store) = fresh().await;
        let acknowledged = AlarmEvent { by: mia(), acknowledged_by, ..event(2, state) };
        let mut events = vec![event(1, AlarmState::ActiveUnacknowledged), acknowledged];
        if state != AlarmState::Normal {
            let unshelved = AlarmEvent { by: Some("otto".to_owned()), acknowledged_by: mia(), ..events[1].clone() };
            events.push(AlarmEvent {
                event_no: 3,
                event_at: at(30),
                state: AlarmState::ActiveAcknowledged,
                ..unshelved
            });
        }
        store.record(outcome("21B", events)).await.unwrap();
        let found: Vec<(String, String)> =
            query(&store, "SELECT acknowledged_by, acknowledged_at FROM alarm_history").await;
        assert_eq!(found, [("mia".to_owned(), "2026-03-01T06:00:20.250000Z".to_owned())], "{state:?}");
    }
}

#[tokio::test]
async fn a_restart_finds_snapshots_and_pending_throws() {
    let folder = tempfile::tempdir().unwrap();
    let opened = open(folder.path()).await;
    assert_eq!(opened.report.found, Found::Fresh);
    let first = spooled(&opened.store, "21B", "b1", 1).await;
    let second = spooled(&opened.store, "21B", "b1", 2).await;
    let outcome = alarm(1, AlarmState::ActiveUnacknowledged);
    judge(&opened.store, Judgement { outcome, ..judgement(first, "21B") }).await.unwrap();
    opened.store.close().await.unwrap();

    let opened = open(folder.path()).await;
    assert_eq!((opened.report.found, opened.report.upgraded_by), (Found::Clean, 0));
    let reader = opened.store.reader();
    let snapshot = "{\"events\":1}".to_owned();
    let state = Some(MachineState::Warning);
    assert_eq!(reader.monitors(None, 10).await.unwrap(), [StoredMonitor { machine: machine("21B"), snapshot, state }]);
    let (waiting, _) = reader.to_judge(None, 10, at(0), std::time::Duration::ZERO).await.unwrap();
    assert_eq!(waiting.iter().map(|throw| throw.row).collect::<Vec<_>>(), [second]);
    for (since, rows) in [(at(0), 1), (at(61), 0), (jiff::Timestamp::UNIX_EPOCH, 1)] {
        let history = reader.health_history(&Selector::default(), since, 5).await.unwrap();
        assert_eq!(history.len(), rows, "since {since}");
        assert!(history.iter().all(|row| row.quality == "good"));
    }
    let elsewhere = Selector { machine: "22A".to_owned(), ..Selector::default() };
    assert!(reader.health_history(&elsewhere, at(0), 5).await.unwrap().is_empty());
}

/// If the clock of a logger is not set, its alarms are dated 1970. A query since a later time still finds them.
#[tokio::test]
async fn alarms_since_a_moment_include_those_that_a_wrong_clock_dates_before_it() {
    let (_folder, store) = fresh().await;
    let in_1970 = jiff::Timestamp::from_second(100).unwrap();
    let early = AlarmEvent { event_at: in_1970, raised_at: in_1970, ..event(1, AlarmState::ActiveUnacknowledged) };
    store.record(outcome("21B", vec![early])).await.unwrap();
    for (since, found) in [(0, 1), (2, 0)] {
        assert_eq!(store.reader().alarm_history(&Selector::default(), at(since), 10).await.unwrap().len(), found);
    }
}

/// An alarm that nobody acknowledges may be raised and cleared without end.
#[tokio::test]
async fn the_events_of_an_alarm_are_bounded() {
    let (_folder, store) = fresh().await;
    for event_no in 1..=1_010 {
        store.record(outcome("21B", vec![event(event_no, AlarmState::ActiveUnacknowledged)])).await.unwrap();
    }
    let events: Vec<(i64, i64, i64)> = query(
        &store,
        "SELECT count(*), min(event_no), (SELECT min(event_no) FROM alarm_event WHERE event_no > 1) FROM alarm_event",
    )
    .await;
    assert_eq!(events, [(1_001, 1, 11)]);
}

/// Retention deletes a pending throw of a flood while the throw is judged. An alarm that the throw raised is still
/// stored and published.
#[tokio::test]
async fn the_alarm_of_a_throw_that_was_deleted_meanwhile_is_not_lost() {
    let (_folder, store) = fresh().await;
    let row = spooled(&store, "21B", "b1", 1).await;
    change(store.path(), ["DELETE FROM throw"]).await;
    let outcome = alarm(1, AlarmState::ActiveUnacknowledged);
    judge(&store, Judgement { outcome, ..judgement(row, "21B") }).await.unwrap();
    assert_eq!(store.reader().open_alarms(&Selector::default()).await.unwrap().len(), 1);
    assert_eq!(store.reader().outbox_pending(0, 10).await.unwrap().len(), 1);
    assert_eq!(store.reader().monitors(None, 10).await.unwrap().len(), 1);
}

/// Throws from a backlog arrive after throws that were recorded later.
#[tokio::test]
async fn the_latest_throw_is_the_last_of_the_machine_and_not_the_last_that_arrived() {
    let (_folder, store) = fresh().await;
    let live = [spooled(&store, "21B", "b1", 1).await, spooled(&store, "21B", "b1", 6).await];
    let backlog = [spooled(&store, "21B", "b1", 4).await, spooled(&store, "21B", "b1", 5).await];
    for row in [live[0], backlog[0], backlog[1], live[1]] {
        judge(&store, judgement(row, "21B")).await.unwrap();
    }
    assert_eq!(query::<(i64,)>(&store, "SELECT throw_no FROM machine_health").await, [(6,)]);
    // An old recording is imported, and the logger continues without a new start.
    judged(&store, "21B", "import", 3).await;
    judged(&store, "21B", "b1", 7).await;
    assert_eq!(query::<(i64,)>(&store, "SELECT throw_no FROM machine_health").await, [(7,)]);
}

/// Throw 6 is received live, and those before it come from the backlog.
#[tokio::test]
async fn the_pages_show_throws_in_the_order_of_their_machine() {
    let (_folder, store) = fresh().await;
    for throw_no in [1, 6, 2, 3, 4, 5] {
        let row = spooled(&store, "21B", "b1", throw_no).await;
        let mut judged = judgement(row, "21B");
        let direction = if throw_no % 2 == 0 { Direction::NormalToReverse } else { Direction::ReverseToNormal };
        judged.health.direction = Some(direction);
        judged.health.change_pct = Some([throw_no as f64, 0.0, 0.0]);
        judged.identification.as_mut().unwrap().direction = Some(direction);
        judge(&store, judged).await.unwrap();
    }
    let mut connection = outsider(store.path()).await;
    let (_, fleet) = statements::all().find(|(name, _)| *name == "FLEET").unwrap();
    let none = None::<&str>;
    let query = sqlx::query(fleet).bind(none).bind(none).bind(none).bind("fleet").bind("pointsd").bind(none);
    let row = query.bind(9).bind(0).bind(9).bind("").fetch_one(&mut connection).await.unwrap();
    assert_eq!(row.get::<i64, _>("started_at_us"), throw("b1", 6).started_at.as_microsecond());
    assert_eq!(row.get::<&str, _>("spark"), "[[6.0,0.0,0.0],[4.0,0.0,0.0],[2.0,0.0,0.0]]");
    let (_, newest) = statements::all().find(|(name, _)| *name == "MACHINE_NEWEST").unwrap();
    let query = sqlx::query(newest).bind("north").bind("21B").bind(4);
    let rows = query.fetch_all(&mut connection).await.unwrap();
    let numbers: Vec<i64> = rows.iter().map(|row| row.get("throw_no")).collect();
    assert_eq!(numbers, [6, 5, 4, 3]);
    // Recordings are imported, and the logger continues its boot.
    judged(&store, "21B", "import", 9).await;
    judged(&store, "21B", "b1", 7).await;
    let query = sqlx::query(newest).bind("north").bind("21B").bind(9);
    let rows = query.fetch_all(&mut connection).await.unwrap();
    let numbers: Vec<i64> = rows.iter().map(|row| row.get("throw_no")).collect();
    assert_eq!(numbers, [7, 6, 5, 4, 3, 2, 1, 9]);
}

/// A pending throw that waits for a missing one does not hide the judged throws.
#[tokio::test]
async fn pending_throws_take_no_place_in_a_limited_history() {
    let (_folder, store) = fresh().await;
    let row = spooled(&store, "21B", "b1", 1).await;
    judge(&store, judgement(row, "21B")).await.unwrap();
    spooled(&store, "21B", "b1", 3).await;
    let one = Selector { machine: "21B".to_owned(), ..Selector::default() };
    assert_eq!(store.reader().health_history(&one, Timestamp::UNIX_EPOCH, 1).await.unwrap().len(), 1);
}
