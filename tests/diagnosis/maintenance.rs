//! What a maintenance window ends, keeps and forgets.

use jiff::{SignedDuration, Timestamp};
use nalgebra::Vector3;
use pointsd::{
    diagnose::{AlarmEvent, AlarmState, Cause, Command, MachineMonitor, MachineState, Observation, Settings},
    estimate::Rejection,
    throw::{Direction, ThrowRef},
};

use crate::{
    drive::{Drive, State, Voltage},
    operational::{disturb, ended, fail, feed, machine, raised, summary},
};

/// Its cause has an alarm already, so the alarm of the lost monitor ends at once, in a maintenance too.
#[test]
fn no_second_alarm_of_a_cause_outlives_a_maintenance() {
    let mut machine = machine();
    let own = feed(&mut machine, 1, fail).remove(0);
    let settings = Settings::default();
    let now = own.event_at + SignedDuration::from_hours(1);
    let by = || "mia".to_owned();
    let until = now + SignedDuration::from_hours(1);
    let start = Command::MaintenanceStart { until, by: by(), why: "look".to_owned() };
    machine.monitor.command(&start, now, &settings).unwrap();
    let lost = AlarmEvent { raised_at: own.raised_at - SignedDuration::from_hours(9), ..own.clone() };
    assert_eq!(machine.monitor.adopt(lost, now)[0].state, AlarmState::Normal);
    machine.monitor.command(&Command::MaintenanceEnd { by: by() }, now, &settings).unwrap();
    let open: Vec<_> = machine.monitor.open_alarms().iter().map(|alarm| alarm.raised_at).collect();
    assert_eq!(open, [own.raised_at]);
}

/// At the end of a maintenance the rules forget the last throws, so the alarms that come from them must end too.
#[test]
fn no_alarm_of_a_sensor_outlives_a_maintenance_that_mends_it() {
    let mut machine = machine();
    feed(&mut machine, 5, disturb);
    assert_eq!(machine.monitor.state(), MachineState::Warning);
    let at = machine.throw(Vector3::zeros()).started_at;
    let start = Command::MaintenanceStart {
        until: at + SignedDuration::from_hours(1),
        by: "mia".to_owned(),
        why: "new sensor".to_owned(),
    };
    for command in [start, Command::MaintenanceEnd { by: "mia".to_owned() }] {
        machine.monitor.command(&command, at, &Settings::default()).unwrap();
    }
    feed(&mut machine, 40, |_| {});
    assert_eq!(machine.monitor.state(), MachineState::Healthy);
}

#[test]
fn a_fault_that_a_maintenance_left_is_reported_again() {
    let settings = Settings::default();
    for is_incomplete in [false, true] {
        let mut drive = Drive::after(110, 33, Voltage::Unknown);
        let (state, cause, stays) = if is_incomplete {
            (State { stroke: 0.5, ..State::SOUND }, Cause::IncompleteThrow, 5)
        } else {
            (State { friction: 1.5, ..State::SOUND }, Cause::Friction, 40)
        };
        if is_incomplete {
            drive.stroke_mm = Some(115.0);
        }
        let raised = drive.events(stays, state);
        assert_eq!(raised[0].cause, cause);
        let start = raised[0].event_at + SignedDuration::from_hours(100);
        let by = || "mia".to_owned();
        let until = start + SignedDuration::from_hours(1);
        for command in
            [Command::Ack { cause, by: by() }, Command::MaintenanceStart { until, by: by(), why: "look".to_owned() }]
        {
            drive.monitor.command(&command, start, &settings).unwrap();
        }
        let [back] = &drive.monitor.tick(until, &settings)[..] else { panic!("one alarm") };
        assert_eq!(back.state, AlarmState::ActiveAcknowledged);
        let again = drive.events(stays, state);
        assert_eq!((again[0].cause, again[0].state), (cause, AlarmState::ActiveUnacknowledged));
        assert!(!again[0].text.contains("before the maintenance"), "{}", again[0].text);
    }
}

/// The maintenance did not mend the reason for which one direction is rejected.
#[test]
fn a_direction_that_stays_unseen_after_a_maintenance_keeps_its_alarm() {
    let settings = Settings::default();
    let mut machine = machine();
    let reverse_unseen = |o: &mut Observation| {
        if o.direction == Some(Direction::ReverseToNormal) {
            o.outcome = Some(Err(Rejection::EndMissing { travel_mm: 80.0 }));
        }
    };
    let events = feed(&mut machine, 80, reverse_unseen);
    assert!(summary(&events).contains(&raised(Cause::NotMonitored)), "{events:?}");
    let now = machine.throw(Vector3::zeros()).started_at;
    let (until, by) = (now + SignedDuration::from_hours(8), || "mia".to_owned());
    let start = Command::MaintenanceStart { until, by: by(), why: "look".to_owned() };
    machine.monitor.command(&start, now, &settings).unwrap();
    machine.monitor.command(&Command::MaintenanceEnd { by: by() }, now, &settings).unwrap();
    let events = feed(&mut machine, 30, reverse_unseen);
    assert!(events.iter().all(|event| event.cause != Cause::NotMonitored || event.event_no == 1), "{events:?}");
    let events = feed(&mut machine, 20, |_| {});
    assert!(summary(&events).contains(&ended(Cause::NotMonitored)), "{events:?}");
}

/// An order that was given while the clock was years ahead ends within the longest allowed time.
#[test]
fn a_maintenance_of_a_clock_that_was_ahead_ends() {
    let settings = Settings::default();
    let mut machine = machine();
    let now = machine.throw(Vector3::zeros()).started_at;
    let ahead = now + SignedDuration::from_hours(24 * 365 * 5);
    let until = ahead + SignedDuration::from_hours(8);
    let start = Command::MaintenanceStart { until, by: "mia".to_owned(), why: "look".to_owned() };
    machine.monitor.command(&start, ahead, &settings).unwrap();
    machine.monitor.tick(now, &settings);
    assert_eq!(machine.monitor.state(), MachineState::Maintenance);
    machine.monitor.tick(now + SignedDuration::from_hours(24 * 32), &settings);
    assert_eq!(machine.monitor.state(), MachineState::Healthy);
}

/// The daemon is off when a maintenance window ends. Throws from after its end count, though they arrive days later.
#[test]
fn throws_after_a_maintenance_that_ended_while_the_daemon_was_off_count() {
    let settings = Settings::default();
    let at = |hour: i64| "2026-03-01T12:00:00Z".parse::<Timestamp>().unwrap() + SignedDuration::from_hours(hour);
    let mut monitor = MachineMonitor::new("21");
    let mut throw_no = 0;
    let mut is_outdated = |monitor: &mut MachineMonitor, started_at, received_at| {
        throw_no += 1;
        let throw = ThrowRef { boot_id: "a".to_owned(), throw_no };
        monitor.date(&throw, started_at, Some(received_at), false, &settings).is_outdated
    };
    for hour in -20..-5 {
        let started_at = at(hour);
        is_outdated(&mut monitor, started_at, started_at + SignedDuration::from_secs(7));
    }
    let start = Command::MaintenanceStart { until: at(0), by: "A. Person".into(), why: "motor".into() };
    monitor.command(&start, at(-4), &settings).unwrap();
    monitor.tick(at(60), &settings);
    assert!(is_outdated(&mut monitor, at(-2), at(61)));
    assert!(!is_outdated(&mut monitor, at(10), at(61)));
}
