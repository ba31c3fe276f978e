//! The first throws of a machine: the baseline does not learn a fault, and its learning ends.

use nalgebra::Vector3;
use pointsd::{
    diagnose::{Cause, Settings, Severity},
    throw::Direction,
};

use crate::{
    drive::{Drive, State, Voltage},
    fleet::{Machine, Scatter, shift},
};

const OF_RATIOS: State = State::OF_RATIOS;

fn is_complete(machine: &Machine) -> bool {
    Direction::BOTH.into_iter().all(|way| machine.monitor.baseline(way).is_some_and(|record| record.complete))
}

#[test]
fn a_fault_while_the_baseline_fills_is_named_and_not_learned() {
    const TRIALS: u64 = 15;
    let settings = Settings::default();
    for cause in Cause::PHYSICAL {
        for seed in 0..TRIALS {
            let mut machine = Machine::new(5_000 + seed, Scatter::USUAL);
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
        let mut machine = Machine::new(6_000 + seed, Scatter { phi, ..Scatter::USUAL });
        machine.stay_healthy(250);
        assert!(is_complete(&machine), "seed {seed}, phi {phi}");
    }
}

/// The first twelve throws of each direction are in unusual weather: all later throws differ significantly from them,
/// by less than every limit.
#[test]
fn unusual_weather_in_the_first_throws_does_not_end_the_learning() {
    let calm = Scatter { sd: [0.002, 0.005, 0.003], ..Scatter::USUAL };
    for seed in 0..10 {
        let mut machine = Machine::new(7_100 + seed, calm);
        for (throws, weather) in [(24, shift(Cause::Friction, 13.0)), (276, Vector3::zeros())] {
            let events = machine.events(throws, weather);
            // Throws that differ so much may hide a change of the friction, and the monitor states this.
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
            let mut machine = Machine::learned_with(8_000 + seed, Scatter::USUAL, settings.clone());
            let sign = if seed.is_multiple_of(2) { 1.0 } else { -1.0 };
            let fault = shift(cause, sign * 2.0 * settings.limit_pct(cause).unwrap());
            let found = (0..60).find_map(|_| machine.feed(fault).events.first().cloned());
            assert_eq!(found.map(|event| event.cause), Some(cause), "{baseline_throws} throws, seed {seed}");
        }
    }
}

/// From the first dozen throws of each direction the monitor decides to compare only the ratios, and learns the
/// baseline.
#[test]
fn a_fault_while_the_baseline_of_ratios_fills_is_named_and_not_learned() {
    let faults = [
        (Cause::Kt, -15.0, State { torque: 0.85, back_emf: 0.85, ..OF_RATIOS }),
        (Cause::Friction, 40.0, State { friction: 1.4, ..OF_RATIOS }),
        (Cause::Stiffness, 30.0, State { stiffness: 1.3, ..OF_RATIOS }),
    ];
    for (cause, pct, fault) in faults {
        for seed in 0..4 {
            let mut drive = Drive::after_in(OF_RATIOS, 36, 61_000 + seed, Voltage::alternating(seed));
            let events = drive.events(60, fault);
            let named = events.iter().find(|event| event.cause == cause);
            let named = named.unwrap_or_else(|| panic!("{cause}, seed {seed}: {events:#?}"));
            let (size, sd) = named.change_pct.zip(named.change_pct_sd).unwrap();
            assert!((size - pct).abs() < 2.5 * sd, "{named:?}");
        }
    }
}

#[test]
fn wear_from_the_first_throw_is_a_trend_of_the_ratios_too() {
    let wear: [fn(f64) -> State; 3] = [
        |part| State { friction: part, ..State::SOUND },
        |part| State { stiffness: part, ..State::SOUND },
        |part| State { torque: 1.0 / part, back_emf: 1.0 / part, ..State::SOUND },
    ];
    // Both directions have ratios only, or one of them.
    for brakes in [[0.02, 0.02], [0.0, 0.02]] {
        for (worn, seed) in wear.into_iter().zip(41_000..) {
            let mut drive = Drive::new(seed, Voltage::Published);
            let is_stated = |drive: &Drive| drive.monitor.caveats().iter().any(|text| text.contains("has a trend"));
            let found = (0..60_u32).find(|throw| {
                let brake_s = brakes[*throw as usize % 2];
                drive.feed(State { brake_s, ..worn(1.0 + 0.0025 * f64::from(*throw)) });
                is_stated(&drive)
            });
            assert!(found.is_some(), "{brakes:?}: not stated before +15 %");
        }
    }
}

/// While a machine runs in, its friction falls. A later rise is one from the throws after that.
#[test]
fn a_fault_after_a_machine_has_run_in_is_named() {
    for seed in 42_000..42_006 {
        let mut drive = Drive::new(seed, Voltage::Published);
        let run_in = |throw: u32| 1.0 + 0.2 * (-f64::from(throw) / 60.0).exp();
        let raised = (0..250).flat_map(|throw| drive.feed(State { friction: run_in(throw), ..State::SOUND }).events);
        assert_eq!(raised.count(), 0, "seed {seed}");
        let events = drive.events(24, State { friction: 1.3, ..State::SOUND });
        let [named, ..] = &events[..] else { panic!("seed {seed}: no alarm") };
        assert_eq!(named.cause, Cause::Friction, "seed {seed}: {named:?}");
        assert!(named.change_pct.unwrap() > 15.0, "seed {seed}: {named:?}");
    }
}
