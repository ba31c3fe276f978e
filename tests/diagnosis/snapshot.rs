//! Snapshots that earlier versions of the program wrote are read.

use jiff::SignedDuration;
use pointsd::{
    diagnose::{AlarmState, Cause, Command, CommandError, MachineMonitor, MachineState, Settings},
    throw::Direction,
};

/// Version 2, when each rule had a flag for its own alarm. Two alarms are active: of the features and of the supply.
const WITH_FLAGS: &str = include_str!("snapshots/version-2.json");
/// Version 1: three machines of a demo. Their alarms are acknowledged, shelved, and in a maintenance without an end.
const SNAPSHOTS: &str = include_str!("snapshots/version-1.ndjson");

fn monitors() -> [MachineMonitor; 3] {
    let all: Vec<_> = SNAPSHOTS.lines().map(|line| MachineMonitor::from_snapshot(line).unwrap()).collect();
    all.try_into().unwrap()
}

#[test]
fn a_snapshot_of_version_1_is_read_with_baselines_alarms_and_their_states() {
    let settings = Settings::default();
    let by = || "B. Fitter".to_owned();
    let [mut acknowledged, mut shelved, mut maintained] = monitors();
    for monitor in [&acknowledged, &shelved, &maintained] {
        for way in Direction::BOTH {
            assert!(monitor.baseline(way).unwrap().complete);
            assert!(monitor.throws_since_baseline(way) > 0);
        }
        let again = MachineMonitor::from_snapshot(&serde_json::to_string(monitor).unwrap()).unwrap();
        assert_eq!(&again, monitor);
    }
    let states = [acknowledged.state(), shelved.state(), maintained.state()];
    assert_eq!(states, [MachineState::Critical, MachineState::Critical, MachineState::Maintenance]);

    let now = acknowledged.open_alarms()[0].event_at;
    let twice = acknowledged.command(&Command::Ack { cause: Cause::Kt, by: by() }, now, &settings);
    assert_eq!(twice, Err(CommandError::AlreadyAcknowledged { cause: Cause::Kt, by: "A.Fitter".to_owned() }));
    assert_eq!(acknowledged.tick(now, &settings), []);

    assert_eq!(shelved.tick(now + SignedDuration::from_hours(7), &settings), []);
    let due = shelved.tick(now + SignedDuration::from_hours(9), &settings);
    assert_eq!(due[0].state, AlarmState::ActiveUnacknowledged);

    // The first tick gives a window without an end its end.
    assert_eq!(maintained.tick(now, &settings), []);
    let until = now + SignedDuration::from_hours(24 * i64::from(settings.longest_shelving_days));
    assert_eq!(maintained.tick(until - SignedDuration::from_secs(1), &settings), []);
    assert_eq!(maintained.tick(until, &settings)[0].state, AlarmState::ActiveUnacknowledged);
    assert_eq!(maintained.state(), MachineState::Critical);
}

#[test]
fn a_snapshot_of_a_newer_version_is_refused_by_its_number() {
    let error = MachineMonitor::from_snapshot(r#"{"version": 99}"#).unwrap_err().to_string();
    assert!(error.contains("99"), "{error}");
    assert!(MachineMonitor::from_snapshot("[]").is_err());
}

#[test]
fn the_owner_of_an_alarm_is_read_from_the_flags_of_an_earlier_program() {
    let owners = |json: &serde_json::Value| {
        let monitor = MachineMonitor::from_snapshot(&json.to_string()).unwrap();
        let now = serde_json::to_value(&monitor).unwrap();
        let again = MachineMonitor::from_snapshot(&now.to_string()).unwrap();
        assert_eq!(again, monitor);
        let open = now["alarms"]["open"].as_array().unwrap().clone();
        open.into_iter().map(|alarm| (alarm["last"]["cause"].clone(), alarm["rule"].clone())).collect::<Vec<_>>()
    };
    let mut json: serde_json::Value = serde_json::from_str(WITH_FLAGS).unwrap();
    // A field that an earlier program wrote is ignored.
    json["motor"] = vec![204, 12].into();
    let none = serde_json::Value::Null;
    assert_eq!(owners(&json), [("supply".into(), none.clone()), ("unattributed".into(), "features".into())]);
    json["features"]["alarmed"] = false.into();
    assert_eq!(owners(&json), [("supply".into(), none.clone()), ("unattributed".into(), none.clone())]);
    json["start"]["alarmed"] = true.into();
    assert_eq!(owners(&json), [("supply".into(), none.clone()), ("unattributed".into(), "start".into())]);
    json["start"]["alarmed"] = false.into();
    json["drift"]["intermittent"]["alarmed"] = "unattributed".into();
    assert_eq!(owners(&json), [("supply".into(), none.clone()), ("unattributed".into(), "intermittent".into())]);
    // The reason why the machine is not monitored.
    json["alarms"]["open"][1]["last"]["cause"] = "not_monitored".into();
    for (reason, rule) in [("silent", "silence".into()), ("two_loggers", "two_loggers".into()), ("unevaluated", none)] {
        json["operation"]["unmonitored"] = reason.into();
        assert_eq!(owners(&json)[1], ("not_monitored".into(), rule), "{reason}");
    }
}
