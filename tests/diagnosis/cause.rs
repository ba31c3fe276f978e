//! Each cause is named correctly within a few throws, and a healthy machine has no alarms.

use nalgebra::Vector3;
use pointsd::{
    diagnose::{AlarmEvent, AlarmState, Cause, MachineMonitor, Settings, Severity},
    estimate::{Grade, Rejection},
};

use crate::fleet::{Machine, Scatter, normal, shift};

/// First alarm within `throws` after the onset of a fault that grows over `ramp` throws: cause, and throws since the
/// onset.
fn first_alarm(seed: u64, cause: Cause, pct: f64, ramp: u32, throws: u32) -> Option<(Cause, u32)> {
    let mut machine = Machine::learned(seed, Scatter::USUAL);
    for _ in 0..machine.rng_u(40) {
        machine.stay_healthy(1);
    }
    (1..=throws).find_map(|at| {
        let part = if ramp == 0 { 1.0 } else { (f64::from(at) / f64::from(ramp)).min(1.0) };
        let verdict = machine.feed(shift(cause, pct * part));
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

/// Logarithmic changes of gauges, the measures beside the coefficients; and whether the throws give only the ratios of
/// the coefficients.
#[derive(Debug, Clone, Copy, Default)]
struct Gauges {
    /// No-load speed; `None` for machines that do not show it.
    speed: Option<f64>,
    duration: f64,
    ratios_only: bool,
}

/// Alarm events of each of 20 machines in 60 throws after these changes of coefficients and gauges.
fn events_beside(shift: Vector3<f64>, gauges: Gauges) -> Vec<Vec<AlarmEvent>> {
    let settings = Settings::default();
    let of_machine = |seed: u64| {
        let mut machine = Machine::new(seed, Scatter::USUAL);
        let mut feed = |shift: Vector3<f64>, changes: Gauges| {
            let mut throw = machine.throw(shift);
            let mut scattered = |change: f64| (change + 0.01 * normal(&mut machine.rng)).exp();
            throw.features.no_load_speed_rad_per_s = changes.speed.map(|change| 17.0 * scattered(change));
            throw.features.duration_s = Some(4.3 * scattered(changes.duration));
            if changes.ratios_only {
                let estimate = throw.outcome.as_mut().unwrap().as_mut().unwrap();
                (estimate.ratios_only, estimate.grade) = (true, Grade::Rough);
            }
            machine.observe(&throw)
        };
        let before = Gauges { speed: gauges.speed.map(|_| 0.0), duration: 0.0, ..gauges };
        for _ in 0..2 * settings.baseline_throws {
            let events = feed(Vector3::zeros(), before).events;
            assert_eq!(events, [], "machine {seed}");
        }
        (0..60).flat_map(|_| feed(shift, gauges).events).collect()
    };
    (1_200..1_220).map(of_machine).collect()
}

fn is_of_features(event: &AlarmEvent) -> bool {
    event.text.contains("the throws have changed")
}

/// Cause and size \[%\] of the first alarm about the coefficients of 20 machines.
fn named_beside(shift: Vector3<f64>, gauges: Gauges) -> Vec<(Cause, f64)> {
    let first = |events: Vec<AlarmEvent>| {
        let event = events.into_iter().find(|event| !is_of_features(event));
        assert!(event.is_some(), "a machine has no alarm");
        let event = event.unwrap();
        (event.cause, event.change_pct.unwrap_or_default())
    };
    events_beside(shift, gauges).into_iter().map(first).collect()
}

fn named_beside_speed(shift: Vector3<f64>, speed: Option<f64>) -> Vec<(Cause, f64)> {
    named_beside(shift, Gauges { speed, ..Gauges::default() })
}

#[test]
fn dry_friction_that_lowers_b0_is_no_motor_fault_beside_an_unchanged_no_load_speed() {
    // This is the estimate on machines with little inertia: a1/b0, the friction per ampere, rises by 65 %.
    let dry = Vector3::new(-0.14, 0.36, 0.01);
    for (cause, change_pct) in named_beside_speed(dry, Some(0.0)) {
        assert_eq!(cause, Cause::Friction);
        assert!((50.0..80.0).contains(&change_pct), "{change_pct}");
    }
    let unknown = named_beside_speed(dry, None);
    assert!(unknown.iter().all(|(cause, _)| *cause == Cause::Unattributed), "{unknown:?}");
    let weak_magnets = named_beside_speed(dry, Some(0.14));
    assert!(weak_magnets.iter().all(|(cause, _)| *cause == Cause::Unattributed), "{weak_magnets:?}");
}

#[test]
fn a_motor_is_named_whether_its_no_load_speed_changes_with_its_torque_or_not() {
    for speed in [0.0, 0.16] {
        let named = named_beside_speed(shift(Cause::Kt, -15.0), Some(speed));
        assert!(named.iter().all(|(_, pct)| (-18.0..-12.0).contains(pct)), "{named:?}");
        // One machine may need more throws: its scatter leaves friction as a second explanation for a while.
        let at_once = named.iter().filter(|(cause, _)| *cause == Cause::Kt).count();
        assert!(at_once + 1 >= named.len(), "{named:?}");
    }
}

/// Weaker magnets turn faster. A dry load has the same torque at every speed, so its equivalent viscous friction falls.
/// To the ratios this is a stiffer machine, or a weaker motor with less friction.
#[test]
fn weak_magnets_before_a_dry_load_are_the_motor_if_its_speed_shows_it() {
    let dry = Vector3::new(-0.16, -0.13, 0.0);
    let faster = Gauges { speed: Some(0.16), duration: -0.14, ratios_only: false };
    for gauges in [faster, Gauges { ratios_only: true, ..faster }, Gauges { speed: None, ratios_only: true, ..faster }]
    {
        let named = named_beside(dry, gauges);
        assert!(named.iter().all(|(cause, _)| *cause == Cause::Kt), "{gauges:?}: {named:?}");
        let mean = named.iter().map(|(_, pct)| pct / named.len() as f64).sum::<f64>();
        assert!((-18.0..-11.0).contains(&mean), "{gauges:?}: {mean}");
    }
}

/// On a machine whose throws give only ratios, the features show a change before a part can be named.
#[test]
fn the_alarm_of_the_features_ends_when_a_part_is_named() {
    let gauges = Gauges { speed: Some(0.16), duration: -0.14, ratios_only: true };
    let lives = events_beside(Vector3::new(-0.16, -0.13, 0.0), gauges);
    let of_features: Vec<_> = lives.iter().filter(|events| events.iter().any(is_of_features)).collect();
    assert!(!of_features.is_empty());
    for events in of_features {
        let last = events.iter().rfind(|event| event.cause == Cause::Unattributed).unwrap();
        assert_eq!(last.state, AlarmState::ClearedUnacknowledged, "{events:?}");
        assert!(last.text.contains("motor explains the change"), "{}", last.text);
    }
}

#[test]
fn stiffness_and_friction_keep_their_names_on_machines_of_ratios() {
    let unlocking = Gauges { speed: None, duration: 0.01, ratios_only: true };
    for (cause, pct, duration) in
        [(Cause::Stiffness, 20.0, 0.01), (Cause::Friction, 40.0, 0.05), (Cause::Friction, -40.0, -0.06)]
    {
        for speed in [None, Some(0.0)] {
            let named = named_beside(shift(cause, pct), Gauges { speed, duration, ..unlocking });
            assert!(named.iter().all(|(named, _)| *named == cause), "{cause} {pct} %, {speed:?}: {named:?}");
        }
    }
}

/// To the ratios, more friction is the same as more torque before a stiffer spring, so there is doubt about the name. The
/// change is critical under either name.
#[test]
fn friction_beyond_its_critical_limit_is_critical_on_machines_of_ratios() {
    let gauges = Gauges { speed: Some(-0.06), duration: 0.15, ratios_only: true };
    let lives = events_beside(shift(Cause::Friction, 60.0) + shift(Cause::Stiffness, 10.0), gauges);
    let last = lives.iter().filter_map(|events| events.iter().rfind(|event| event.cause == Cause::Friction));
    let named: Vec<_> = last.filter(|event| event.state.is_active()).collect();
    assert!(named.len() > 10, "{named:#?}");
    assert!(named.iter().all(|event| event.severity == Severity::Critical), "{named:#?}");
}

/// The logarithms of b0 and a1 vary together, but last for different times. A constant change must not look like an outlier
/// that fades.
#[test]
fn a_constant_change_is_an_alarm_whatever_the_serial_correlations() {
    let mut machine = Machine::learned(1_250, Scatter { sd: [0.002, 0.02, 0.0005], ..Scatter::USUAL });
    let mut snapshot = serde_json::to_value(&machine.monitor).unwrap();
    let tracks = &mut snapshot["tracks"];
    for at in ["/sides/0/baseline/scatter", "/sides/1/baseline/scatter", "/mixed/scatter"] {
        let scatter = tracks.pointer_mut(at).unwrap();
        scatter["natural"] = serde_json::json!([8.0e-6, 1.24e-4, -8.0e-7, 2.0e-3, -9.0e-6, 3.3e-7]);
        scatter["lag1"] = serde_json::json!([0.84, 0.22, 0.2]);
    }
    machine.monitor = MachineMonitor::from_snapshot(&snapshot.to_string()).unwrap();
    let events = machine.events(60, Vector3::new(0.065, 0.54, 0.02));
    assert!(events.iter().any(|event| event.cause == Cause::Friction), "{events:#?}");
}

/// A constant force on the toe hinders one direction and helps the other, which no part does.
#[test]
fn opposite_changes_of_the_two_directions_are_no_change_of_a_part() {
    for seed in 0..8 {
        let mut machine = Machine::learned(1_300 + seed, Scatter::USUAL);
        let force = |machine: &Machine, pct: f64| {
            shift(Cause::Friction, if machine.side() as u64 == seed % 2 { pct } else { -0.8 * pct })
        };
        let mut events: Vec<AlarmEvent> = Vec::new();
        for throw in 0..300 {
            let shift = force(&machine, 0.3 * f64::from(throw));
            events.extend(machine.feed(shift).events);
        }
        assert!(!events.is_empty() && events.iter().all(|event| event.cause == Cause::Unattributed), "{events:#?}");
        let [first, .., last] = events.as_slice() else { panic!("no critical alarm: {events:#?}") };
        assert_eq!((first.severity, last.severity), (Severity::Warning, Severity::Critical));
        assert!(last.text.contains("opposite changes") && last.direction.is_none(), "{}", last.text);
    }
}

/// Slide chairs that become dry along a part of the stroke brake the toe early in one direction and late in the other, as
/// a weaker and a stiffer spring would. Later the throws of one direction give no estimate.
#[test]
fn opposite_changes_that_grow_fast_name_no_spring() {
    for seed in 0..8 {
        let mut machine = Machine::learned(1_400 + seed, Scatter::USUAL);
        let mut events: Vec<AlarmEvent> = Vec::new();
        for throw in 0..120 {
            let pct = 3.0 * f64::from(throw.min(20));
            let is_braked_early = machine.side() as u64 == seed % 2;
            let mut observation = machine.throw(shift(Cause::Stiffness, if is_braked_early { -pct } else { pct }));
            if throw > 40 && is_braked_early {
                observation.outcome = Some(Err(Rejection::NotPositive { b0: 14.0, a1: 1.4, a0: -0.01 }));
            }
            events.extend(machine.observe(&observation).events);
        }
        assert!(!events.is_empty() && events.iter().all(|event| !event.cause.is_part()), "{seed}: {events:#?}");
    }
}

#[test]
fn healthy_machines_have_no_alarm() {
    for (seed, phi) in (0..20).zip([0.0, 0.3, 0.5, 0.6].into_iter().cycle()) {
        let mut machine = Machine::new(seed, Scatter { phi, ..Scatter::USUAL });
        machine.stay_healthy(1_000);
    }
}

#[test]
fn a_large_fault_is_critical_and_its_text_can_be_acted_on() {
    let settings = Settings::default();
    let mut machine = Machine::learned(3, Scatter::USUAL);
    let events = machine.events(20, shift(Cause::Friction, 60.0));
    let last = events.last().unwrap();
    assert_eq!((last.cause, last.severity), (Cause::Friction, Severity::Critical));
    assert!((last.change_pct.unwrap() - 60.0).abs() < 3.0 * last.change_pct_sd.unwrap() + 6.0);
    assert!(last.text.starts_with("Machine 21B: friction up "), "{}", last.text);
    assert!(last.text.contains("Check slide chairs and lubrication."), "{}", last.text);
    let numbers = last.correlation.unwrap();
    assert!(!numbers.indicates_inertia(settings.correlation_limit));
}
