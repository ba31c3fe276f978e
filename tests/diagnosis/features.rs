//! Throws without coefficients: their features are monitored.

use nalgebra::Vector3;
use pointsd::{
    diagnose::{Cause, MachineMonitor, MachineState, Observation, Settings},
    estimate::Features,
};

use crate::{
    drive::{Drive, State},
    field::{Machine, Scatter},
};

/// A machine with a current sensor only, whose logger publishes no voltage, after a healthy time without an event.
fn current_only(seed: u64, settings: &Settings) -> Drive {
    let mut drive = Drive::new(55_000 + seed, false);
    drive.has_toe_sensor = false;
    for throw in 0..100 {
        let verdict = drive.feed(State::SOUND, settings);
        assert_eq!(verdict.events, [], "seed {seed}, throw {throw}");
    }
    assert_eq!(drive.monitor.state(), MachineState::Healthy);
    drive
}

#[test]
fn a_machine_with_a_current_sensor_only_is_monitored_by_its_features() {
    let settings = Settings::default();
    let faults = [
        ("dry slide chairs", State { friction: 1.8, ..State::SOUND }, true),
        ("very dry slide chairs", State { friction: 2.5, ..State::SOUND }, true),
        ("a weak supply", State { volts: 0.7, ..State::SOUND }, true),
        ("less friction", State { friction: 0.95, ..State::SOUND }, false),
    ];
    for (name, state, is_found) in faults {
        let mut found = 0;
        for seed in 0..4 {
            let mut drive = current_only(seed, &settings);
            let events: Vec<_> = (0..24).flat_map(|_| drive.feed(state, &settings).events).collect();
            assert!(events.iter().all(|event| event.cause == Cause::Unattributed), "{name}: {events:?}");
            found += u32::from(!events.is_empty());
            for event in &events {
                println!("{name}: {}", event.text);
            }
            let healthy: Vec<_> = (0..40).flat_map(|_| drive.feed(State::SOUND, &settings).events).collect();
            assert_eq!(healthy.len(), events.len(), "{name} mended: {healthy:?}");
            assert_eq!(drive.monitor.state(), MachineState::Healthy, "{name} mended");
        }
        assert_eq!(found, if is_found { 4 } else { 0 }, "{name}");
    }
}

#[test]
fn throws_that_are_rejected_one_after_the_other_show_by_their_features_that_the_machine_changed() {
    let settings = Settings::default();
    for (factor, cause) in [(1.2, Cause::Unattributed), (1.0, Cause::NotMonitored)] {
        let mut machine = Machine::new(56_000, Scatter::USUAL);
        let mut monitor = MachineMonitor::new("21B");
        for _ in 0..130 {
            assert_eq!(machine.feed(&mut monitor, Vector3::zeros(), None, &settings).events, []);
        }
        let mut named = Vec::new();
        for _ in 0..20 {
            let throw = machine.throw(Vector3::zeros(), None);
            let duration_s = throw.features.duration_s.map(|duration_s| factor * duration_s);
            let rejected = Observation { estimate: None, features: Features { duration_s, ..throw.features }, ..throw };
            named.extend(monitor.observe(&rejected, &settings).events.into_iter().map(|event| event.cause));
        }
        assert_eq!(named.first(), Some(&cause), "{named:?}");
        let ended: Vec<_> =
            (0..20).flat_map(|_| machine.feed(&mut monitor, Vector3::zeros(), None, &settings).events).collect();
        assert!(!ended.is_empty() && monitor.state() == MachineState::Healthy, "{ended:?}");
    }
}
