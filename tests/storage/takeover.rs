//! Migration of a database of the last release. Its dump is `released.sql`: machine-1 has an acknowledged motor alarm,
//! machine-2 a shelved friction alarm, machine-3 a maintenance window without an end; machine-4 has gaps, a
//! contradicting throw in quarantine, an unpublished alarm and a pending throw.

use std::path::Path;

use jiff::Timestamp;
use pointsd::{
    daemon::{
        Offline,
        config::{Config, Document},
    },
    diagnose::{AlarmState, Cause, MachineMonitor, MachineState},
    store::{Found, Reader, Selector},
    throw::{Direction, MachineId},
};
use sqlx::Connection;

use crate::given::{open, outsider, query};

async fn released(folder: &Path) {
    let mut connection = outsider(folder.join("points.db")).await;
    sqlx::raw_sql(include_str!("released.sql")).execute(&mut connection).await.unwrap();
    connection.close().await.unwrap();
}

fn name(number: u32) -> MachineId {
    MachineId::new("north", &format!("machine-{number}")).unwrap()
}

#[tokio::test]
async fn a_database_of_the_previous_version_is_migrated_with_everything() {
    let folder = tempfile::tempdir().unwrap();
    released(folder.path()).await;
    let opened = open(folder.path()).await;
    assert_eq!(opened.report.found, Found::WithoutLog);
    assert!(opened.report.upgraded_by > 0);
    let (store, everything) = (opened.store, Selector::default());
    let reader = store.reader();

    let alarms = reader.open_alarms(&everything).await.unwrap();
    let states: Vec<_> = alarms.iter().map(|alarm| (alarm.machine.clone(), alarm.cause, alarm.state)).collect();
    assert_eq!(
        states,
        [
            (name(1), Cause::Kt, AlarmState::ActiveAcknowledged),
            (name(2), Cause::Friction, AlarmState::Shelved),
            (name(4), Cause::IncompleteThrow, AlarmState::ActiveUnacknowledged),
        ]
    );
    assert_eq!(alarms[0].by.as_deref(), Some("mia"));
    assert_eq!((alarms[1].by.as_deref(), alarms[1].why.as_deref()), (Some("mia"), Some("greased tonight")));
    let last = alarms[0].last_throw.as_ref().unwrap();
    assert_eq!((last.boot_id.as_str(), last.throw_no), ("1795324881386026-23000", 43));
    assert_eq!(reader.alarm_history(&everything, Timestamp::UNIX_EPOCH, 100).await.unwrap().len(), 7);
    assert_eq!(reader.outbox_pending(0, 100).await.unwrap().len(), 7);
    let acknowledged: Vec<(String, f64, String)> =
        query(&store, "SELECT acknowledged_by, change_pct, text FROM active_alarms WHERE acknowledged_by IS NOT NULL")
            .await;
    let [(by, change_pct, text)] = &acknowledged[..] else { panic!("{acknowledged:?}") };
    assert!(by == "mia" && (-15.4..-15.3).contains(change_pct) && text.contains("motor down 15 %"), "{text}");
    let evidence: Vec<(i64, f64, f64, String)> = query(
        &store,
        "SELECT last_throw_no, runner_up_margin, b0_a1, last_boot_id FROM alarm_events WHERE cause = 'kt' AND event_no = 2",
    )
    .await;
    assert_eq!((evidence[0].0, evidence[0].3.as_str()), (43, "1795324881386026-23000"));
    assert!(evidence[0].1 > 153.0 && evidence[0].2 < -0.029, "{evidence:?}");

    let history = reader.health_history(&everything, Timestamp::UNIX_EPOCH, 1000).await.unwrap();
    assert_eq!(history.len(), 43);
    assert_eq!(history.iter().filter(|health| health.quality == "good" && health.sd.is_some()).count(), 42);
    let gaps: Vec<(String, i64)> = query(&store, "SELECT machine, missing_throws FROM data_gaps ORDER BY 2 DESC").await;
    assert_eq!(gaps, [("machine-4".to_owned(), 2), ("machine-4".to_owned(), 1)]);
    assert_eq!(query::<(i64,)>(&store, "SELECT count(*) FROM quarantined_messages").await, [(1,)]);
    let commands: Vec<(String,)> = query(&store, "SELECT command FROM operator_commands ORDER BY carried_out_at").await;
    assert_eq!(
        commands.iter().map(|(word,)| word.as_str()).collect::<Vec<_>>(),
        ["ack", "shelve", "maintenance_start"]
    );

    for stored in reader.monitors(None, 100).await.unwrap() {
        let monitor = MachineMonitor::from_snapshot(&stored.snapshot).unwrap();
        assert!(Direction::BOTH.iter().all(|way| monitor.baseline(*way).is_some_and(|baseline| baseline.complete)));
        let state = match stored.machine.machine.as_str() {
            "machine-1" | "machine-2" => MachineState::Critical,
            "machine-3" => MachineState::Maintenance,
            _ => MachineState::Warning,
        };
        assert_eq!(monitor.state(), state, "{}", stored.machine);
        if stored.machine == name(1) {
            let [alarm] = &monitor.open_alarms()[..] else { panic!() };
            assert_eq!((alarm.first_throw.as_ref().unwrap().throw_no, alarm.event_no), (38, 3));
        }
    }
    store.close().await.unwrap();
}

/// The pipeline continues after the last throw of the old version: the pending throw is judged, and the alarm stays.
#[tokio::test]
async fn a_pending_throw_of_the_version_before_is_judged() {
    let folder = tempfile::tempdir().unwrap();
    released(folder.path()).await;
    let text = format!("[store]\npath = {:?}\nballast_mib = 0\n", folder.path().join("points.db"));
    let config = Config::from_document(&Document::parse(Path::new("taken-over.toml"), text).unwrap()).unwrap();
    let mut pipeline = Offline::open(config).await.unwrap();
    let judged = pipeline.judge().await.unwrap();
    let health: Vec<_> = judged.iter().flat_map(|batch| &**batch).map(|judgement| &judgement.health).collect();
    let [health] = health[..] else { panic!("{health:?}") };
    assert_eq!((&health.machine, health.throw.throw_no), (&name(4), 7));
    assert_eq!(health.state, Some(MachineState::Warning));
    pipeline.close().await.unwrap();
    let reader = Reader::open(&folder.path().join("points.db")).await.unwrap();
    let latest =
        reader.latest_health(&Selector { machine: name(4).machine.to_string(), ..Selector::default() }).await.unwrap();
    assert!(latest.iter().all(|health| health.state == Some(MachineState::Warning)), "{latest:?}");
}
