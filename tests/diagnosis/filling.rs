//! The first throws of a machine: the baseline does not learn a fault, and its learning ends.

use nalgebra::Vector3;
use pointsd::{
    diagnose::{Cause, Settings, Severity},
    throw::Direction,
};

use crate::fleet::{Machine, Nature, shift};

fn is_complete(machine: &Machine) -> bool {
    Direction::BOTH.into_iter().all(|way| machine.monitor.baseline(way).is_some_and(|record| record.complete))
}

#[test]
fn a_fault_while_the_baseline_fills_is_named_and_not_learned() {
    const TRIALS: u64 = 15;
    let settings = Settings::default();
    for cause in Cause::PHYSICAL {
        for seed in 0..TRIALS {
            let mut machine = Machine::new(5_000 + seed, Nature::default());
            machine.stay_healthy(30);
            let sign = if seed.is_multiple_of(2) { 1.0 } else { -1.0 };
            let fault = shift(cause, sign * 2.0 * settings.limit_pct(cause).unwrap());
            let first = machine.events(120, fault).remove(0);
            assert_eq!(first.cause, cause, "seed {seed}: {}", first.text);
            assert!(!is_complete(&machine), "{cause}: the fault was learned");
        }
    }
}

#[test]
fn healthy_machines_complete_their_baseline_without_an_alarm() {
    const LIVES: u64 = 60;
    for (seed, phi) in (0..LIVES).zip([0.0, 0.3, 0.6, 0.8].into_iter().cycle()) {
        let mut machine = Machine::new(6_000 + seed, Nature { phi, ..Nature::default() });
        machine.stay_healthy(250);
        assert!(is_complete(&machine), "seed {seed}, phi {phi}");
    }
}

/// The first twelve throws of each direction are in unusual weather: all later throws differ significantly from them,
/// by less than every limit.
#[test]
fn an_unlucky_first_dozen_does_not_end_the_learning() {
    let calm = Nature { scatter: [0.002, 0.005, 0.003], ..Nature::default() };
    for seed in 0..10 {
        let mut machine = Machine::new(7_100 + seed, calm);
        for (throws, weather) in [(24, shift(Cause::Friction, 13.0)), (276, Vector3::zeros())] {
            let events = machine.events(throws, weather);
            // So different throws may hide a change of the friction, which is stated.
            assert!(events.iter().all(|event| event.cause == Cause::NotMonitored), "seed {seed}: {events:?}");
        }
        assert!(is_complete(&machine), "seed {seed}");
        let found = machine.events(10, shift(Cause::Kt, -20.0));
        assert_eq!(found.first().map(|event| event.cause), Some(Cause::Kt), "seed {seed}");
        assert_eq!(found.last().map(|event| event.severity), Some(Severity::Critical), "seed {seed}");
    }
}

/// A complete baseline with few throws has an uncertain scatter, as one that is still learning.
#[test]
fn a_small_complete_baseline_names_every_cause() {
    const TRIALS: u64 = 10;
    for baseline_throws in [12, 25] {
        let settings = Settings { baseline_throws, ..Settings::default() };
        for (cause, seed) in Cause::PHYSICAL.into_iter().flat_map(|cause| (0..TRIALS).map(move |seed| (cause, seed))) {
            let mut machine = Machine::learned_with(8_000 + seed, Nature::default(), settings.clone());
            let sign = if seed.is_multiple_of(2) { 1.0 } else { -1.0 };
            let fault = shift(cause, sign * 2.0 * settings.limit_pct(cause).unwrap());
            let found = (0..60).find_map(|_| machine.feed(fault).events.first().cloned());
            assert_eq!(found.map(|event| event.cause), Some(cause), "{baseline_throws} throws, seed {seed}");
        }
    }
}
