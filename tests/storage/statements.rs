//! SQLite can prepare every statement of the store.

use pointsd::{
    diagnose::{AlarmState, Cause, Command, MachineState},
    store::{Outcome, Selector, statements},
};
use sqlx::{Column, Executor, Row, SqlSafeStr};

use crate::given::{alarm, at, fresh, judged, machine, outcome, outsider, query, spooled};

#[tokio::test]
async fn every_statement_prepares_against_the_migrated_schema() {
    let (_folder, store) = fresh().await;
    let mut connection = outsider(store.path()).await;
    let mut wrong = Vec::new();
    for (name, sql) in statements::all() {
        if let Err(error) = connection.prepare(sql.into_sql_str()).await {
            wrong.push(format!("{name}: {error}"));
        }
    }
    assert!(statements::all().count() > 100);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The statements that run for each throw do not read the whole history.
#[tokio::test]
async fn the_statements_of_every_throw_find_their_rows_by_index() {
    let (_folder, store) = fresh().await;
    for throw_no in 1..=50 {
        judged(&store, "21B", "b1", throw_no).await;
    }
    let mut connection = outsider(store.path()).await;
    // These statements are ordered by row and limited, so they end after a few rows.
    let reads_from_the_start = ["THROWS", "NEWEST_HEALTH", "LAST_RECEIVED"];
    let single = statements::all().flat_map(|(name, all)| all.split("; ").map(move |sql| (name, sql)));
    for (name, sql) in single {
        // A replay reads all throws once.
        let housekeeping = sql.starts_with("SELECT count") || name.contains("OLDEST") || name == "JUDGED_ORDER";
        if housekeeping || reads_from_the_start.contains(&name) || name.starts_with("AGED") || name.contains("EMPTY") {
            continue;
        }
        let question = sqlx::AssertSqlSafe(format!("EXPLAIN QUERY PLAN {sql}"));
        let plan: Vec<(i64, i64, i64, String)> = sqlx::query_as(question).fetch_all(&mut connection).await.unwrap();
        for (.., step) in plan {
            let scans =
                step.starts_with("SCAN throw") || step.starts_with("SCAN estimate") || step.starts_with("SCAN trace");
            assert!(!scans || step.contains("throw_pending"), "{name}: {step}");
        }
    }
}

/// A query of the history selects its rows in an index, without sorting the whole table.
#[tokio::test]
async fn a_question_about_the_history_chooses_its_rows_in_an_index() {
    let (_folder, store) = fresh().await;
    let mut connection = outsider(store.path()).await;
    for (name, step) in [
        ("HEALTH_SINCE", "SEARCH throw USING COVERING INDEX throw_by_time"),
        ("HEALTH_SINCE", "SEARCH estimate USING INTEGER PRIMARY KEY"),
        // Every page shows the open alarms, so they are not searched among all alarms.
        ("OPEN_ALARMS", "SCAN alarm USING INDEX alarm_open"),
        ("ALARM_HISTORY", "USING INDEX alarm_event_by_time"),
        ("ALARM_HISTORY_OF_MACHINE", "SEARCH alarm USING COVERING INDEX alarm_of_machine"),
        ("ALARM_HISTORY_OF_MACHINE", "SEARCH alarm_event USING PRIMARY KEY"),
    ] {
        let (_, sql) = statements::all().find(|statement| statement.0 == name).unwrap();
        let question = sqlx::AssertSqlSafe(format!("EXPLAIN QUERY PLAN {sql}"));
        let plan: Vec<(i64, i64, i64, String)> = sqlx::query_as(question).fetch_all(&mut connection).await.unwrap();
        assert!(plan.iter().any(|(.., part)| part.contains(step)), "{name}: {plan:?}");
    }
}

/// The history query has several statements, for all or some machines, with or without a time: all select the same way.
#[tokio::test]
async fn history_is_the_newest_of_the_selected_machines_oldest_first() {
    let (_folder, store) = fresh().await;
    for throw_no in 1..=6 {
        for name in ["21B", "22A"] {
            judged(&store, name, "b1", throw_no).await;
        }
    }
    let numbers = async |which: &Selector, since, limit| {
        let rows = store.reader().health_history(which, since, limit).await.unwrap();
        rows.into_iter().map(|row| (row.machine.machine.to_string(), row.throw.throw_no)).collect::<Vec<_>>()
    };
    let pairs = |machines: &[&str], from: u64| {
        let of = |no| machines.iter().map(move |name| ((*name).to_owned(), no));
        (from..=6).flat_map(of).collect::<Vec<_>>()
    };
    let (all, whenever) = (Selector::default(), jiff::Timestamp::UNIX_EPOCH);
    let one = Selector { machine: "2?A".to_owned(), ..Selector::default() };
    let none = Selector { site: "s*".to_owned(), ..Selector::default() };
    assert_eq!(numbers(&all, whenever, 4).await, pairs(&["21B", "22A"], 5));
    assert_eq!(numbers(&one, whenever, 2).await, pairs(&["22A"], 5));
    // Throw n starts n minutes after the start of the test.
    assert_eq!(numbers(&all, at(60 * 4), 100).await, pairs(&["21B", "22A"], 4));
    assert_eq!(numbers(&one, at(60 * 4), 100).await, pairs(&["22A"], 4));
    assert_eq!(numbers(&none, whenever, 100).await, []);
}

/// A rough throw has only the ratios a1/b0 and a0/b0. The views show their changes from the last baseline.
#[tokio::test]
async fn the_views_show_the_change_of_the_ratios_of_a_rough_throw() {
    let (_folder, store) = fresh().await;
    judged(&store, "21B", "b1", 1).await;
    let mut connection = outsider(store.path()).await;
    for statement in [
        "UPDATE estimate SET direction = 'normal_to_reverse', quality = 'rough', b0 = NULL, a1 = NULL, a0 = NULL,
             b0_pct = NULL, a1_pct = NULL, a0_pct = NULL,
             a1_per_b0 = 0.3, a0_per_b0 = 0.05, baseline_throws = 50",
        "UPDATE latest SET direction = 'normal_to_reverse'",
        "DELETE FROM baseline",
        "INSERT INTO baseline (machine_row, direction, taken_at_us, payload)
         SELECT machine_row, 'normal_to_reverse', started_at_us - 1,
                '{\"throws\": 50, \"center\": [2, 0.5, 0.1], \"reference_c\": 12.5}' FROM throw",
        "INSERT INTO baseline (machine_row, direction, taken_at_us, payload)
         SELECT machine_row, 'normal_to_reverse', started_at_us + 1, '{\"throws\": 9, \"center\": [1, 1, 1]}' FROM throw",
    ] {
        connection.execute(statement).await.unwrap();
    }
    for view in ["health_history", "machine_health"] {
        let question = sqlx::AssertSqlSafe(format!("SELECT a1_per_b0_pct, a0_per_b0_pct FROM {view}"));
        let (friction, stiffness): (f64, f64) = sqlx::query_as(question).fetch_one(&mut connection).await.unwrap();
        assert!((friction - 20.0).abs() < 1e-9 && stiffness.abs() < 1e-9, "{view}: {friction} {stiffness}");
    }
    let temperature: Vec<(Option<f64>,)> = sqlx::query_as("SELECT temperature_c FROM baselines ORDER BY taken_at")
        .fetch_all(&mut connection)
        .await
        .unwrap();
    assert_eq!(temperature, [(Some(12.5),), (None,)]);
    let [health] = &store.reader().latest_health(&Selector::default()).await.unwrap()[..] else { panic!() };
    let near = |is: Option<f64>, pct: f64| is.is_some_and(|is| (is - pct).abs() < 1e-9);
    assert!(near(health.a1_per_b0_pct, 20.0) && near(health.a0_per_b0_pct, 0.0), "{health:?}");
    // A rebaseline changes the present health, but not the history.
    let rebaseline = Command::Rebaseline { by: "mia".to_owned(), why: "new motor".to_owned() };
    for _ in 0..2 {
        store.record(Outcome { command: Some(rebaseline.clone()), ..outcome("21B", Vec::new()) }).await.unwrap();
    }
    for (view, change) in [("health_history", Some(20.0)), ("machine_health", None)] {
        let question = sqlx::AssertSqlSafe(format!("SELECT round(a1_per_b0_pct, 9) FROM {view}"));
        let shown: (Option<f64>,) = sqlx::query_as(question).fetch_one(&mut connection).await.unwrap();
        assert_eq!(shown.0, change, "{view} after a new baseline");
    }
    let [health] = &store.reader().latest_health(&Selector::default()).await.unwrap()[..] else { panic!() };
    assert_eq!(health.a1_per_b0_pct, None);
    let history = store.reader().health_history(&Selector::default(), at(0), 9).await.unwrap();
    assert!(near(history[0].a1_per_b0_pct, 20.0), "{history:?}");
    // The new baseline has 3 throws: it is not complete.
    connection.execute("UPDATE estimate SET baseline_before = NULL, baseline_throws = 3").await.unwrap();
    let change: (Option<f64>,) =
        sqlx::query_as("SELECT a1_per_b0_pct FROM machine_health").fetch_one(&mut connection).await.unwrap();
    assert_eq!(change, (None,));
}

/// The three views of alarms show the sensor of an alarm, as their last column.
#[tokio::test]
async fn the_views_of_alarms_show_the_channel_of_a_sensor() {
    let (_folder, store) = fresh().await;
    judged(&store, "21B", "b1", 1).await;
    let mut connection = outsider(store.path()).await;
    for statement in [
        "DELETE FROM alarm",
        "INSERT INTO alarm (alarm_id, machine_row, cause, raised_at_us, last_event_no, state)
         SELECT 'a', machine_row, 'sensor', 0, 1, 'active_unacknowledged' FROM machine",
        "INSERT INTO alarm_event (alarm_row, event_no, event_at_us, severity, state, payload)
         SELECT alarm_row, 1, 0, 'warning', state, '{\"channel\":\"position\"}' FROM alarm",
    ] {
        connection.execute(statement).await.unwrap();
    }
    for view in ["alarm_history", "active_alarms", "alarm_events"] {
        let question = sqlx::AssertSqlSafe(format!("SELECT * FROM {view}")).into_sql_str();
        let rows = connection.fetch_all(question).await.unwrap();
        let last = rows[0].columns().last().unwrap().name();
        assert_eq!((rows.len(), last, rows[0].get::<&str, _>("channel")), (1, "channel", "position"), "{view}");
    }
}

/// Times in SQL are text, and compared as text.
#[tokio::test]
async fn the_end_of_a_window_has_six_digits_of_its_second_as_every_time() {
    let (_folder, store) = fresh().await;
    judged(&store, "21B", "b1", 1).await;
    for nanosecond in [0, 750_000_000, 123_456_789] {
        let until = at(3_600) + jiff::SignedDuration::from_nanos(nanosecond);
        let command = Command::MaintenanceStart { until, by: "mia".to_owned(), why: "new chairs".to_owned() };
        store.record(Outcome { command: Some(command), ..outcome("21B", Vec::new()) }).await.unwrap();
    }
    let end = Command::MaintenanceEnd { by: "mia".to_owned() };
    store.record(Outcome { command: Some(end), ..outcome("21B", Vec::new()) }).await.unwrap();
    let ends: Vec<(Option<String>,)> = query(&store, "SELECT until FROM operator_commands").await;
    let fractions: Vec<_> = ends.iter().map(|(end,)| end.as_deref().map(|end| &end[19..])).collect();
    assert_eq!(fractions, [Some(".250000Z"), Some(".000000Z"), Some(".373456Z"), None]);
}

/// An alarm that was shelved once is out of service later. Its old shelving is no open window.
#[tokio::test]
async fn the_windows_are_the_present_shelvings_and_maintenance() {
    let (_folder, store) = fresh().await;
    let (_, windows) = statements::all().find(|(name, _)| *name == "WINDOWS").unwrap();
    let mut connection = outsider(store.path()).await;
    let mut commands = async || {
        let rows = connection.fetch_all(windows).await.unwrap();
        rows.iter().map(|row| row.get("command")).collect::<Vec<String>>()
    };
    let (by, why, until) = ("mia".to_owned(), "greased".to_owned(), at(3_600));
    let shelve = Command::Shelve { cause: Cause::Friction, until, by: by.clone(), why: why.clone() };
    let shelved = alarm(1, AlarmState::Shelved);
    store.record(Outcome { command: Some(shelve), ..shelved }).await.unwrap();
    assert_eq!(commands().await, ["shelve"]);
    store.record(alarm(2, AlarmState::ActiveUnacknowledged)).await.unwrap();
    assert_eq!(commands().await, [""; 0]);
    let mut repaired = alarm(3, AlarmState::OutOfService);
    repaired.command = Some(Command::MaintenanceStart { until, by, why });
    repaired.monitor.as_mut().unwrap().present.state = MachineState::Maintenance;
    store.record(repaired).await.unwrap();
    assert_eq!(commands().await, ["maintenance_start"]);
}

/// The deletion of a row does not search whole tables for rows that refer to it.
#[tokio::test]
async fn every_foreign_key_has_an_index() {
    let (_folder, store) = fresh().await;
    let mut connection = outsider(store.path()).await;
    let without: Vec<(String, String)> = sqlx::query_as(
        "SELECT child.name, key.\"from\" FROM sqlite_schema AS child, pragma_foreign_key_list(child.name) AS key
         WHERE child.type = 'table' AND NOT EXISTS (SELECT 1 FROM pragma_table_info(child.name) AS own
             WHERE own.name = key.\"from\" AND own.pk = 1)
         AND NOT EXISTS (SELECT 1 FROM pragma_index_list(child.name) AS usable, pragma_index_info(usable.name) AS part
             WHERE NOT usable.partial AND part.seqno = 0 AND part.name = key.\"from\")",
    )
    .fetch_all(&mut connection)
    .await
    .unwrap();
    // Machines are never deleted, and the table `backlog` is small: one row for each machine with missing throws.
    let without: Vec<_> =
        without.into_iter().filter(|(table, column)| column != "machine_row" && table != "backlog").collect();
    assert_eq!(without, []);
}

/// A machine with many gaps and a full quarantine does not delay the report of the gaps of other machines.
#[tokio::test]
async fn the_query_of_the_gaps_to_report_is_fast_for_many_gaps_and_a_full_quarantine() {
    const GAPS: i64 = 2_000;
    let (_folder, store) = fresh().await;
    for name in ["21B", "22A"] {
        spooled(&store, name, "b1", 1).await;
    }
    let numbers = "WITH RECURSIVE number (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM number WHERE n < ?1) ";
    let mut connection = outsider(store.path()).await;
    for (count, insert) in [
        // Of two numbers in each gap the first was in a message that is in quarantine with its number.
        (
            1_000,
            "INSERT INTO quarantine (received_at_us, key, reason, payload_bytes, payload_start, boot_id, throw_no) \
             SELECT n, 'points/v1/north/21B/throw', 'numbered', 9, zeroblob(9), 'b1', 10 * n FROM number",
        ),
        (
            1_000,
            "INSERT INTO quarantine (received_at_us, key, reason, payload_bytes, payload_start) \
             SELECT n + 9e15, 'points/v1/north/21B/throw', 'unread', 9, zeroblob(9) FROM number",
        ),
        (
            GAPS,
            "INSERT INTO gap (boot_row, first_no, last_no, kind, detected_at_us, written_off_at_us) \
             SELECT 1, 10 * n, 10 * n + 1, 'missed', 0, 0 FROM number",
        ),
        (
            1,
            "INSERT INTO gap (boot_row, first_no, last_no, kind, detected_at_us, written_off_at_us) \
             SELECT 2, 10, 19, 'missed', 0, 0 FROM number",
        ),
    ] {
        let insert = sqlx::AssertSqlSafe(format!("{numbers}{insert}"));
        sqlx::query(insert).bind(count).execute(&mut connection).await.unwrap();
    }
    let (_, unreported) = statements::all().find(|(name, _)| *name == "UNREPORTED_GAPS").unwrap();
    let start = tokio::time::Instant::now();
    let gaps = sqlx::query(unreported).bind(10_000).bind(0).bind(1).fetch_all(&mut connection).await.unwrap();
    let took = start.elapsed();
    assert!(took < std::time::Duration::from_secs(1), "{took:?}");
    let found = |row: &sqlx::sqlite::SqliteRow| -> (String, i64, i64, Option<String>) {
        (row.get("machine"), row.get("first_no"), row.get("refused"), row.get("reason"))
    };
    assert_eq!(gaps.len(), 2_001);
    assert_eq!(found(&gaps[0]), ("21B".to_owned(), 10, 2, Some("unread".to_owned())));
    assert_eq!(found(&gaps[2_000]), ("22A".to_owned(), 10, 0, None));
    for change in
        ["DELETE FROM quarantine WHERE throw_no IS NULL", "UPDATE quarantine SET boot_id = 'b0' WHERE throw_no = 20"]
    {
        connection.execute(change).await.unwrap();
    }
    let gaps = sqlx::query(unreported).bind(10_000).bind(0).bind(1).fetch_all(&mut connection).await.unwrap();
    assert_eq!(found(&gaps[0]), ("21B".to_owned(), 10, 1, Some("numbered".to_owned())));
    assert_eq!(found(&gaps[1]), ("21B".to_owned(), 20, 0, None));
}

/// The missing throws of a machine that was removed from the track are in no backlog.
#[tokio::test]
async fn the_missing_throws_of_a_retired_machine_are_not_awaited() {
    let (_folder, store) = fresh().await;
    for (boot_id, throw_no) in [("b1", 1), ("b1", 41), ("b2", 3)] {
        spooled(&store, "21B", boot_id, throw_no).await;
    }
    let retire = Command::Retire { by: "mia".to_owned(), why: "removed".to_owned() };
    store.record(Outcome { command: Some(retire), ..outcome("21B", Vec::new()) }).await.unwrap();
    let (_, awaited) = statements::all().find(|(name, _)| *name == "AWAITED_COUNT").unwrap();
    let count: (i64,) = sqlx::query_as(awaited).fetch_one(&mut outsider(store.path()).await).await.unwrap();
    assert_eq!(count, (0,));
    assert!(query::<(i64,)>(&store, "SELECT machine_row FROM backlog").await.is_empty());
    assert!(query::<(i64,)>(&store, "SELECT boot_row FROM boot WHERE tail_open").await.is_empty());
    assert!(!store.reader().cursor(&machine("21B")).await.unwrap().awaits);
}
