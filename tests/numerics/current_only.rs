//! Throws of machines without a toe sensor.

use pointsd::estimate::{Features, Grade, Identification, Identifier, Settings};
use pointsd::simulate::{Condition, Parameters, Part, Sensors};
use pointsd::throw::{Direction, Throw, Trace};

use super::identify::simulated;

/// The current of a simulated throw.
fn current(machine: &Parameters, direction: Direction, rate_hz: f64) -> Vec<f64> {
    let sensors = Sensors { sample_rate_hz: rate_hz, ..Sensors::default() };
    simulated(machine, &sensors, direction, 4).trace.current_a().to_vec()
}

/// Identifies a throw from its current. The logger sends `position` as each toe position.
fn identify(
    current: Vec<f64>,
    direction: Direction,
    rate_hz: f64,
    position: f64,
    supply_v: Option<f64>,
) -> Identification {
    let positions = vec![position; current.len()];
    let trace = Trace::new(rate_hz, current, positions).unwrap();
    let throw = Throw { direction: Some(direction), supply_v, ..Throw::recorded(trace) };
    Identifier::default().identify(&throw, &Settings { stroke_mm: Some(115.0), ..Settings::default() })
}

/// Checks the change of b0, a1, a0 \[%\], within `limit_pct`, by a change of each part \[%\].
#[track_caller]
fn assert_changes(
    direction: Direction,
    coefficients: impl Fn(&Parameters) -> [f64; 3],
    limit_pct: f64,
    faults: &[(Part, f64, [f64; 3])],
) {
    let machine = Parameters::default();
    let new = coefficients(&machine);
    for (part, size_pct, expected) in faults {
        let mut condition = Condition::default();
        condition.change(*part, *size_pct);
        let worn = coefficients(&machine.in_condition(&condition).unwrap());
        for at in 0..3 {
            let change = 100.0 * (worn[at] / new[at] - 1.0);
            assert!((change - expected[at]).abs() < limit_pct, "{direction}, {part:?}: coefficient {at} by {change} %");
        }
    }
}

#[test]
fn with_the_voltage_every_part_shows_in_the_current_alone() {
    let machine = Parameters::default();
    for direction in Direction::BOTH {
        let coefficients = |machine: &Parameters| {
            let current = current(machine, direction, 1000.0);
            let estimate = identify(current, direction, 1000.0, f64::NAN, Some(110.0)).outcome.unwrap();
            assert_eq!(estimate.grade, Grade::CurrentOnly);
            estimate.coefficients()
        };
        let known = machine.coefficients().unwrap();
        for (found, known) in coefficients(&machine).iter().zip([known.b0, known.a1, known.a0]) {
            assert!((found / known - 1.0).abs() < 0.04, "{direction}: {found} for {known}");
        }
        let faults = [
            (Part::Kt, -10.0, [-10.0, -2.0, 0.0]),
            (Part::Friction, 30.0, [3.0, 34.0, 4.0]),
            (Part::Stiffness, 15.0, [0.0, 0.0, 15.0]),
            (Part::Inertia, 10.0, [-9.1; 3]),
        ];
        assert_changes(direction, coefficients, 2.0, &faults);
    }
}

#[test]
fn without_the_voltage_or_at_a_low_rate_there_are_features() {
    let machine = Parameters::default();
    for (rate_hz, supply_v, why) in [
        (1000.0, None, "need supply_v"),
        (25.0, Some(110.0), "at least 500 samples/s"),
        (25.0, None, "need supply_v"),
        (20_000.0, None, "need supply_v"),
    ] {
        // A logger without a toe sensor sends nothing, nulls or zeros.
        for position in [f64::NAN, 0.0] {
            let current = current(&machine, Direction::NormalToReverse, rate_hz);
            let found = identify(current, Direction::NormalToReverse, rate_hz, position, supply_v);
            assert_eq!(found.quality(), "current_only", "{rate_hz} Hz");
            assert!(found.detail().unwrap().contains(why), "{:?}", found.detail());
            assert_eq!(found.direction, Some(Direction::NormalToReverse));
            let Features { duration_s, running_current_a, energy_j, travel_mm, end_position_mm, .. } = found.features;
            assert!((duration_s.unwrap() - 4.3).abs() < 0.1, "{rate_hz} Hz: {duration_s:?}");
            assert!((running_current_a.unwrap() - 0.87).abs() < 0.02, "{rate_hz} Hz: {running_current_a:?}");
            assert_eq!((energy_j.is_some(), travel_mm, end_position_mm), (supply_v.is_some(), None, None));
        }
    }
}

/// Recordings of three-phase machines at 25 Hz begin with a few samples at rest, often with the pulse of a contact, and
/// end with the current of the detection circuit.
#[test]
fn the_pulse_of_a_contact_before_the_inrush_is_no_noise() {
    for before in [&[0.0, 0.0][..], &[0.0, 0.0, 0.56, 0.24], &[0.0, 0.0, 0.0, 0.59, 0.0], &[0.0, 0.0, 0.0, 2.2, 0.0]] {
        let mut current = [before, &[4.06]].concat();
        current.extend([2.1; 128]);
        current.extend([0.6; 10]);
        current.extend([0.0; 2]);
        let nothing = vec![f64::NAN; current.len()];
        let throw = Throw::recorded(Trace::new(25.0, current, nothing).unwrap());
        let Features { duration_s, running_current_a, quiet_current_a, .. } =
            Identifier::default().identify(&throw, &Settings::default()).features;
        let expected_s = 139.0 / 25.0;
        // The pulse may count as the start.
        assert!((duration_s.unwrap() - expected_s).abs() < 0.13, "{before:?}: {duration_s:?} for {expected_s} s");
        assert!((running_current_a.unwrap() - 2.1).abs() < 0.05, "{before:?}: {running_current_a:?}");
        assert_eq!(quiet_current_a, None, "{before:?}");
    }
}

/// A cut recording looks like a throw that ends early, with a smaller back-EMF and a larger b0. One that begins in the
/// inrush has a larger b0 too.
#[test]
fn a_recording_without_the_start_or_the_end_of_the_motor_gives_no_coefficients() {
    let machine = Parameters::default();
    for direction in Direction::BOTH {
        let whole = current(&machine, direction, 1000.0);
        let part =
            |part: std::ops::Range<usize>| identify(whole[part].to_vec(), direction, 1000.0, f64::NAN, Some(110.0));
        let found = part(0..whole.len());
        let (b0, end_s) = (found.outcome.unwrap().b0, found.features.duration_s.unwrap() + 0.2);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index of the trace")]
        let off = (1000.0 * end_s).round() as usize;
        // The recording ends with the motor.
        let found = part(0..off + 3);
        assert!(
            (found.outcome.unwrap().b0 / b0 - 1.0).abs() < 1e-3 && found.features.duration_s.is_some(),
            "{direction}"
        );
        for end in [1000, 1500, 2500, 3200, 4000, off - 5] {
            let found = part(0..end);
            let detail = found.detail().unwrap();
            assert!(detail.contains("does not show that the motor is switched off"), "{direction}, {end}: {detail}");
            assert_eq!((found.quality(), found.features.duration_s), ("current_only", None), "{direction}, {end}");
        }
        // The rails that help reverse to normal take the current to 0 after the inrush.
        let latest = if direction == Direction::NormalToReverse { 100 } else { 20 };
        for late in [2, 4, 6, 8, 10, 20, 50, 100].into_iter().filter(|late| *late <= latest) {
            let found = part(200 + late..whole.len());
            let detail = found.detail().unwrap();
            assert!(detail.contains("start of the motor is not in the recording"), "{direction}, {late}: {detail}");
            assert_eq!(
                (found.quality(), found.features.duration_s.is_some()),
                ("current_only", true),
                "{direction}, {late}"
            );
        }
    }
}

/// A few samples at rest before the motor do not show the noise well. Of the thousands after it some are far from the
/// mean.
#[test]
fn the_noise_of_a_long_rest_after_few_samples_does_not_lengthen_the_throw() {
    let machine = Parameters::default();
    for (rate_hz, leads) in [(1000.0, &[0, 3, 7, 20][..]), (50.0, &[4])] {
        let sensors = Sensors { sample_rate_hz: rate_hz, after_s: 5.0, ..Sensors::default() };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index of the trace")]
        let on = (rate_hz * sensors.before_s).round() as usize;
        for (direction, seed) in Direction::BOTH.into_iter().flat_map(|way| (0..10).map(move |seed| (way, seed))) {
            let whole = simulated(&machine, &sensors, direction, seed).trace.current_a().to_vec();
            for lead in leads {
                let found = identify(whole[on - lead..].to_vec(), direction, rate_hz, f64::NAN, None);
                let duration_s = found.features.duration_s.unwrap();
                assert!((4.1..4.4).contains(&duration_s), "{rate_hz} Hz, {lead}, {direction}, {seed}: {duration_s} s");
            }
        }
    }
}

/// Changes the current to that of a motor that stalls at the end of the stroke for 35 ms, and that the drive turns back
/// after the cut-off.
fn with_stall(machine: &Parameters, current: &mut Vec<f64>, rate_hz: f64) {
    let peak = current.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap();
    let cut_off = current.iter().rposition(|i| i.abs() > 0.15).unwrap() - 8;
    let (from_a, rest) = (current[cut_off].abs(), current[current.len() - 1]);
    current.truncate(cut_off);
    let stall_a = machine.supply_v / machine.resistance_ohm;
    let armature_s = machine.inductance_h / machine.resistance_ohm;
    let time_s = |k: i32| f64::from(k) / rate_hz;
    current.extend((1..=35).map(|k| peak.signum() * (stall_a + (from_a - stall_a) * (-time_s(k) / armature_s).exp())));
    let end_a = current[current.len() - 1];
    let back_a = 1.5 * from_a * peak.signum();
    current.extend(
        (1..=800)
            .map(|k| rest + (end_a - back_a) * (-time_s(k) / armature_s).exp() + back_a * (-time_s(k) / 0.1).exp()),
    );
}

/// After the cut-off there is no voltage, so the current while the drive turns the motor back must not count.
#[test]
fn a_stall_at_the_end_of_the_stroke_neither_hides_nor_changes_a_fault() {
    for direction in Direction::BOTH {
        let coefficients = |machine: &Parameters| {
            let mut current = current(machine, direction, 1000.0);
            with_stall(machine, &mut current, 1000.0);
            identify(current, direction, 1000.0, f64::NAN, Some(110.0)).outcome.unwrap().coefficients()
        };
        let faults = [
            (Part::Kt, -15.0, [-15.0, -3.0, 0.0]),
            (Part::Inertia, 20.0, [-16.7; 3]),
            (Part::Stiffness, 30.0, [0.0, 0.0, 30.0]),
        ];
        assert_changes(direction, coefficients, 3.0, &faults);
    }
}

/// The charge feature of a motor that runs for 3 s, with an inrush of 30 A that rises in 6 ms and decays in 0.1 s.
fn charge_as(rate_hz: f64, phase: f64, running_a: f64) -> Option<f64> {
    let current: Vec<f64> = (0..=10_000)
        .map(|k| (f64::from(k) + phase) / rate_hz - 0.4)
        .take_while(|t| *t < 4.0)
        .map(|t| match t {
            t if (0.0..3.0).contains(&t) => {
                running_a + 30.0 * (-t / 0.1).exp() - (running_a + 30.0) * (-t / 0.006).exp()
            }
            _ => 0.0,
        })
        .collect();
    identify(current, Direction::NormalToReverse, rate_hz, f64::NAN, None).features.charge_as
}

#[test]
fn a_charge_that_depends_on_the_moments_of_the_samples_is_unknown() {
    let of_phases =
        |rate_hz: f64, running_a: f64| [0.0, 0.2, 0.4, 0.6, 0.8].map(|phase| charge_as(rate_hz, phase, running_a));
    for running_a in [1.5, 12.0] {
        let truth = 3.0 * running_a + 30.0 * 0.1 - (running_a + 30.0) * 0.006;
        let fine = of_phases(1000.0, running_a);
        assert!(fine.iter().all(|charge| (charge.unwrap() / truth - 1.0).abs() < 0.02), "{truth}: {fine:?}");
        let slow = of_phases(25.0, running_a);
        let is_right = |charge: &Option<f64>| charge.is_none_or(|charge| (charge / truth - 1.0).abs() < 0.1);
        assert!(
            slow.iter().all(is_right) && slow.iter().any(Option::is_some) == (running_a > 2.0),
            "{truth}: {slow:?}"
        );
    }
}

/// Without a direction, a throw against the spring of one direction may be one with it.
#[test]
fn a_current_without_a_direction_counts_as_normal_to_reverse_only_if_it_fits() {
    for truth in Direction::BOTH {
        let current = current(&Parameters::default(), truth, 1000.0);
        let identify = |direction: Option<Direction>| {
            let trace = Trace::new(1000.0, current.clone(), vec![f64::NAN; current.len()]).unwrap();
            let throw = Throw { direction, supply_v: Some(110.0), ..Throw::recorded(trace) };
            let settings = Settings { stroke_mm: Some(115.0), ..Settings::default() };
            Identifier::default().identify(&throw, &settings).outcome.unwrap()
        };
        assert_eq!(identify(None), identify(Some(truth)), "{truth}");
    }
}

/// Changes the samples of a current.
type Damage<'a> = &'a dyn Fn(&mut Vec<f64>);

/// Without a toe sensor a damaged current gives no coefficients, and a dead one no features that look like a throw.
#[test]
fn a_damaged_current_has_its_reason_and_a_dead_one_shows_no_motor() {
    let direction = Direction::NormalToReverse;
    let sound = current(&Parameters::default(), direction, 1000.0);
    let peak = sound.iter().copied().fold(0.0, f64::max);
    let start = sound.iter().position(|i| *i > 0.5 * peak).unwrap();
    let damaged = |damage: Damage<'_>| {
        let mut current = sound.clone();
        damage(&mut current);
        identify(current, direction, 1000.0, f64::NAN, Some(110.0))
    };
    let rest = sound[..start - 20].to_vec();
    let noise = |current: &mut Vec<f64>| {
        for (i, rest) in current.iter_mut().zip(rest.iter().cycle()) {
            *i = *rest;
        }
    };
    let cases: [(&str, Damage<'_>); 4] = [
        ("clipped", &|current| current.iter_mut().for_each(|i| *i = i.min(0.6 * peak))),
        ("spike", &|current| current[start + 30] = 40.0),
        ("stuck", &|current| {
            let (from, value) = (current.len() / 2, current[current.len() / 2]);
            current[from..].fill(value);
        }),
        ("not_finite", &|current| current[start + 500..].fill(f64::NAN)),
    ];
    for (quality, damage) in cases {
        let found = damaged(damage);
        assert_eq!(found.quality(), quality, "{:?}", found.detail());
    }
    for (name, dead) in [("noise", &noise as Damage<'_>), ("zeros", &|current| current.fill(0.0))] {
        let found = damaged(dead);
        assert!(found.detail().unwrap().contains("shows no motor"), "{name}: {:?}", found.detail());
        let Features { duration_s, running_current_a, energy_j, .. } = found.features;
        assert_eq!((duration_s, running_current_a, energy_j), (None, None, None), "{name}");
    }
}
