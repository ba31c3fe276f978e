//! Each cause is named correctly within a few throws, and a healthy machine has no alarms.

use nalgebra::Vector3;
use pointsd::diagnose::{Cause, MachineMonitor, Settings, Severity};

use crate::fleet::{Machine, Nature, shift};

/// First alarm within `throws` after the onset of a fault that grows over `ramp` throws: cause, and throws since the
/// onset.
fn first_alarm(seed: u64, cause: Cause, pct: f64, ramp: u32, throws: u32) -> Option<(Cause, u32)> {
    let settings = Settings::default();
    let mut machine = Machine::new(seed, Nature::default());
    let mut monitor = machine.learned(&settings);
    for _ in 0..machine.rng_u(40) {
        assert_eq!(machine.feed(&mut monitor, Vector3::zeros(), &settings).events, []);
    }
    (1..=throws).find_map(|at| {
        let part = if ramp == 0 { 1.0 } else { (f64::from(at) / f64::from(ramp)).min(1.0) };
        let verdict = machine.feed(&mut monitor, shift(cause, pct * part), &settings);
        verdict.events.first().map(|event| (event.cause, at))
    })
}

fn size_pct(cause: Cause) -> f64 {
    2.0 * Settings::default().limit_pct(cause).unwrap()
}

#[test]
fn steps_and_ramps_at_twice_the_limit_are_named_right() {
    const TRIALS: u64 = 40;
    for cause in Cause::PHYSICAL {
        for (sign, ramp) in [(1.0, 0), (-1.0, 0), (1.0, 100), (-1.0, 100)] {
            let mut delays = Vec::new();
            for trial in 0..TRIALS {
                let found = first_alarm(900 + trial, cause, sign * size_pct(cause), ramp, ramp + 60);
                let (named, delay) = found.unwrap_or_else(|| panic!("{cause} was missed"));
                assert_eq!(named, cause, "trial {trial}, sign {sign}, ramp {ramp}");
                delays.push(delay);
            }
            delays.sort_unstable();
            let median = delays[delays.len() / 2];
            assert!(ramp > 0 || median <= 3, "{cause}, sign {sign}: median delay {median}");
        }
    }
}

#[test]
fn healthy_machines_have_no_alarm() {
    let settings = Settings::default();
    for (seed, phi) in (0..20).zip([0.0, 0.3, 0.5, 0.6].into_iter().cycle()) {
        let mut machine = Machine::new(seed, Nature { phi, ..Nature::default() });
        let mut monitor = MachineMonitor::new("21B");
        for _ in 0..1_000 {
            let verdict = machine.feed(&mut monitor, Vector3::zeros(), &settings);
            assert_eq!(verdict.events, []);
        }
    }
}

#[test]
fn a_large_fault_is_critical_and_its_text_can_be_acted_on() {
    let settings = Settings::default();
    let mut machine = Machine::new(3, Nature::default());
    let mut monitor = machine.learned(&settings);
    let events: Vec<_> =
        (0..20).flat_map(|_| machine.feed(&mut monitor, shift(Cause::Friction, 60.0), &settings).events).collect();
    let last = events.last().unwrap();
    assert_eq!((last.cause, last.severity), (Cause::Friction, Severity::Critical));
    assert!((last.change_pct.unwrap() - 60.0).abs() < 3.0 * last.change_pct_sd.unwrap() + 6.0);
    assert!(last.text.starts_with("Machine 21B: friction up "), "{}", last.text);
    assert!(last.text.contains("Check slide chairs and lubrication."), "{}", last.text);
    let numbers = last.correlation.unwrap();
    assert!(!numbers.indicates_inertia(settings.correlation_limit));
}
