//! Throws that fail, get slow, cannot be evaluated, or never arrive.

use jiff::SignedDuration;
use nalgebra::Vector3;
use pointsd::diagnose::{AlarmEvent, AlarmState, Cause, MachineMonitor, MachineState, Observation, Settings, Severity};

use crate::fleet::{Machine, Nature};

fn machine() -> (Machine, MachineMonitor) {
    let mut machine = Machine::new(21, Nature::default());
    let monitor = machine.learned(&Settings::default());
    (machine, monitor)
}

fn feed(
    machine: &mut Machine,
    monitor: &mut MachineMonitor,
    throws: usize,
    change: impl Fn(&mut Observation),
) -> Vec<AlarmEvent> {
    (0..throws)
        .flat_map(|_| {
            let mut observation = machine.throw(Vector3::zeros());
            change(&mut observation);
            monitor.observe(&observation, &Settings::default()).events
        })
        .collect()
}

fn summary(events: &[AlarmEvent]) -> Vec<(Cause, Severity, AlarmState)> {
    events.iter().map(|event| (event.cause, event.severity, event.state)).collect()
}

#[test]
fn an_incomplete_throw_is_told_at_once_and_a_second_is_critical() {
    use AlarmState::{ActiveUnacknowledged, ClearedUnacknowledged};
    let (mut machine, mut monitor) = machine();
    let failed = feed(&mut machine, &mut monitor, 2, |o| (o.incomplete, o.estimate) = (true, None));
    assert_eq!(
        summary(&failed),
        [
            (Cause::IncompleteThrow, Severity::Warning, ActiveUnacknowledged),
            (Cause::IncompleteThrow, Severity::Critical, ActiveUnacknowledged)
        ]
    );
    let well = feed(&mut machine, &mut monitor, 20, |_| {});
    assert_eq!(summary(&well), [(Cause::IncompleteThrow, Severity::Critical, ClearedUnacknowledged)]);
}

#[test]
fn slow_throws_show_even_where_the_coefficients_do_not() {
    let (mut machine, mut monitor) = machine();
    let slow = |o: &mut Observation| o.features.duration_s = Some(4.3 * 1.3);
    let events = feed(&mut machine, &mut monitor, 10, slow);
    assert_eq!(summary(&events), [(Cause::SlowThrow, Severity::Warning, AlarmState::ActiveUnacknowledged)]);
    assert!((events[0].change_pct.unwrap() - 30.0).abs() < 1.0);
}

#[test]
fn a_machine_whose_throws_cannot_be_evaluated_is_not_monitored() {
    let (mut machine, mut monitor) = machine();
    let events = feed(&mut machine, &mut monitor, 25, |o| o.estimate = None);
    assert_eq!(summary(&events), [(Cause::NotMonitored, Severity::Warning, AlarmState::ActiveUnacknowledged)]);
    assert_eq!(monitor.state(), MachineState::NotMonitored);
    let events = feed(&mut machine, &mut monitor, 1, |_| {});
    assert_eq!(summary(&events), [(Cause::NotMonitored, Severity::Warning, AlarmState::ClearedUnacknowledged)]);
    assert_eq!(monitor.state(), MachineState::Healthy);
}

#[test]
fn silence_is_noticed_and_a_jumping_clock_is_no_silence() {
    let settings = Settings::default();
    let (mut machine, mut monitor) = machine();
    let mut now = machine.throw(Vector3::zeros()).started_at;
    assert_eq!(monitor.tick(now, &settings), []);
    assert_eq!(monitor.tick(now + SignedDuration::from_hours(24 * 3650), &settings), []);
    assert_eq!(monitor.tick(now - SignedDuration::from_hours(24), &settings), []);
    let mut events = Vec::new();
    for _ in 0..24 * 8 {
        now += SignedDuration::from_hours(1);
        events.extend(monitor.tick(now, &settings));
    }
    assert_eq!(summary(&events), [(Cause::NotMonitored, Severity::Warning, AlarmState::ActiveUnacknowledged)]);
}

#[test]
fn lost_throws_are_an_alarm_until_none_was_lost_for_a_while() {
    let settings = Settings::default();
    let (mut machine, mut monitor) = machine();
    let at = machine.throw(Vector3::zeros()).started_at;
    assert_eq!(monitor.gap(0, at, &settings), []);
    let events = monitor.gap(3, at, &settings);
    assert_eq!(summary(&events), [(Cause::DataLoss, Severity::Warning, AlarmState::ActiveUnacknowledged)]);
    let events = feed(&mut machine, &mut monitor, 12, |_| {});
    assert_eq!(summary(&events), [(Cause::DataLoss, Severity::Warning, AlarmState::ClearedUnacknowledged)]);
}

#[test]
fn nonsense_in_an_estimate_neither_panics_nor_teaches() {
    let settings = Settings::default();
    let mut machine = Machine::new(22, Nature::default());
    let mut monitor = MachineMonitor::new("21B");
    for at in 0..3 {
        for value in [f64::NAN, f64::INFINITY, 0.0, -1.0, f64::MIN_POSITIVE] {
            let mut observation = machine.throw(Vector3::zeros());
            observation.estimate.as_mut().unwrap().0[at] = value;
            monitor.observe(&observation, &settings);
        }
        for value in [f64::NAN, f64::INFINITY, -1.0, 1e9] {
            let mut observation = machine.throw(Vector3::zeros());
            observation.estimate.as_mut().unwrap().1[(at, at)] = value;
            monitor.observe(&observation, &settings);
        }
    }
    for direction in pointsd::throw::Direction::BOTH {
        assert_eq!(monitor.baseline_progress(direction, &settings).0, 0);
    }
}
