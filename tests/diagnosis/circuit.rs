//! The circuit of the motor: a changed resistance, a wrong sensor of the supply voltage, a weak supply that explains
//! slower throws, and a lost torque with sound magnets.

use nalgebra::{Matrix3, Vector3};
use pointsd::{
    diagnose::{AlarmEvent, AlarmState, Cause, Observation, SensorChannel},
    throw::Direction,
};

use crate::{
    drive::{Drive, State, Voltage},
    fleet::{causes, channels},
};

const SOUND: State = State::SOUND;
const OF_RATIOS: State = State::OF_RATIOS;

/// A drive with a published voltage, after a healthy time without an event.
fn learned(seed: u64, state: State) -> Drive {
    Drive::after_in(state, 100, 91_000 + seed, Voltage::Published)
}

/// The alarms that were raised, and those that ended.
fn split(events: Vec<AlarmEvent>) -> [Vec<AlarmEvent>; 2] {
    let (raised, ended) = events.into_iter().partition(|event| event.state == AlarmState::ActiveUnacknowledged);
    [raised, ended]
}

#[test]
fn a_bad_contact_is_an_alarm_of_the_supply_until_it_is_mended() {
    for (seed, before) in [(1, SOUND), (2, SOUND), (3, OF_RATIOS), (4, OF_RATIOS)] {
        let mut drive = learned(seed, before);
        let bad = State { ohms: 1.5, ..before };
        let [raised, _] = split(drive.events(60, bad));
        assert_eq!(raised.len(), 1, "seed {seed}: {raised:?}");
        let AlarmEvent { cause, change_pct, text, .. } = &raised[0];
        assert!(*cause == Cause::Supply && text.contains("resistance") && text.contains("brushes"), "{text}");
        let pct = change_pct.unwrap();
        assert!((42.0..58.0).contains(&pct), "{pct}");
        let [again, ended] = split(drive.events(60, before));
        assert!(again.is_empty() && ended.len() == 1 && ended[0].cause == Cause::Supply, "{again:?}, {ended:?}");
    }
}

/// The motor turns before the toe, or its sensor, moves.
#[test]
fn play_a_late_brake_and_a_late_position_are_no_bad_contact() {
    for (at, state) in [
        State { play_mm: 0.05, ..SOUND },
        State { play_mm: 0.2, ..SOUND },
        State { play_mm: 1.0, ..SOUND },
        State { brake_s: 0.03, ..SOUND },
        State { late_s: 0.005, ..SOUND },
    ]
    .into_iter()
    .enumerate()
    {
        for seed in 0..2 {
            let mut drive = learned(200 + 10 * at as u64 + seed, SOUND);
            let [raised, _] = split(drive.events(60, state));
            let is_about_the_start = |event: &AlarmEvent| event.text.contains("play") && event.text.contains("brake");
            assert!(!raised.is_empty() && raised.iter().all(is_about_the_start), "{state:?}: {raised:#?}");
        }
    }
}

/// A small drift at the same time, which motor and current sensor explain equally well, must not end the alarm.
#[test]
fn the_alarm_about_a_bad_contact_stays_as_long_as_the_contact_is_bad() {
    for (seed, torque) in [(5, 1.0), (6, 0.98), (7, 1.02), (8, 0.97)] {
        let mut drive = learned(seed, SOUND);
        let bad = State { ohms: 1.45, torque, ..SOUND };
        let events = drive.events(200, bad);
        let of_supply: Vec<_> = events.iter().filter(|event| event.cause == Cause::Supply).collect();
        assert_eq!(of_supply.len(), 1, "seed {seed}: {events:#?}");
    }
}

/// The error of the sensor is near the smallest error that is named, and scatters around it.
#[test]
fn the_alarm_about_a_voltage_sensor_stays_as_long_as_it_is_wrong() {
    let mut count = 0;
    for seed in 60..64 {
        for gain in [1.1, 0.9] {
            let events = learned(seed, SOUND).events_with(300, SOUND, |throw| read_with(gain, throw));
            let named: Vec<_> = events.iter().map(|event| (event.channel, event.state)).collect();
            let raised = (Some(SensorChannel::Supply), AlarmState::ActiveUnacknowledged);
            assert!(named.is_empty() || named == [raised], "seed {seed}, {gain}: {events:#?}");
            count += named.len();
        }
    }
    assert!(count > 0, "no life had an alarm: the test cannot fail");
}

/// The copper of the motor follows the air, and is warmer in busy hours.
#[test]
fn a_motor_that_warms_and_cools_has_no_alarm() {
    for (seed, is_published) in [(10, true), (11, true), (12, false), (13, false)] {
        let mut drive = Drive::new(91_000 + seed, Voltage::Published);
        let swing_k = if is_published { 30.0 } else { 15.0 };
        for throw in 0..400 {
            let celsius = 10.0 - swing_k * (f64::from(throw) / 120.0).cos();
            let heated_k = if throw % 150 > 110 { 40.0 } else { 5.0 };
            let ohms = 1.0 + 0.0039 * (celsius + heated_k - 20.0);
            let mut observation = drive.throw(State { ohms, ..SOUND });
            observation.temperature_c = is_published.then_some(celsius);
            let mut events = drive.observe(&observation).events;
            // The baseline may not show the effect of the temperature on the friction, and says so.
            events.retain(|event| event.cause != Cause::NotMonitored);
            assert_eq!(events, [], "seed {seed}, throw {throw}");
        }
    }
}

/// With a published temperature the monitor knows the effect of heat on the resistance, so it sees smaller faults.
#[test]
fn the_temperature_makes_a_smaller_change_of_the_resistance_visible() {
    for (is_published, expected) in [(true, 1), (false, 0)] {
        let mut drive = Drive::new(91_020, Voltage::Published);
        let mut raised = Vec::new();
        for throw in 0..160 {
            let celsius = 15.0 + 5.0 * (f64::from(throw) / 10.0).sin();
            let contact = if throw < 100 { 1.0 } else { 1.31 };
            let ohms = contact * (1.0 + 0.0039 * (celsius - 20.0));
            let mut observation = drive.throw(State { ohms, ..SOUND });
            observation.temperature_c = is_published.then_some(celsius);
            raised.extend(drive.observe(&observation).events);
        }
        assert_eq!(raised.len(), expected, "{raised:?}");
    }
}

/// Twice the resistance changes the inrush, and with it the acceleration that b0 describes: the motor is sound.
#[test]
fn a_motor_that_a_bad_contact_makes_look_weaker_is_not_named() {
    for (seed, before) in [(60, SOUND), (61, SOUND), (62, OF_RATIOS), (63, OF_RATIOS)] {
        let events = learned(seed, before).events_with(100, State { ohms: 2.0, ..before }, |throw| {
            if let Some(Ok(estimate)) = &mut throw.outcome {
                let scale = Matrix3::from_diagonal(&Vector3::new(0.925, 1.0, 1.0));
                estimate.coefficients[0] *= scale[(0, 0)];
                estimate.covariance = scale * estimate.covariance * scale;
            }
        });
        assert_eq!(causes(&events), [Cause::Supply], "seed {seed}: {events:?}");
    }
}

/// The resistance is computed from the movement of the toe, so it is wrong where the toe does not follow the motor. A
/// wrong gain of the current sensor would also change the inrush, which is as before.
#[test]
fn a_resistance_that_is_wrong_in_one_direction_accuses_no_current_sensor() {
    for seed in 64..68 {
        let stiff = State { stiffness: 1.6, ..OF_RATIOS };
        let events = learned(seed, OF_RATIOS).events_with(60, stiff, |throw| {
            if throw.direction == Some(Direction::ReverseToNormal) {
                throw.features.resistance_ohm = throw.features.resistance_ohm.map(|ohm| 0.7 * ohm);
            }
        });
        assert!(events.iter().any(|event| event.cause == Cause::Stiffness), "seed {seed}: {events:?}");
        let of_circuit = [Cause::Sensor, Cause::Supply];
        assert!(events.iter().all(|event| !of_circuit.contains(&event.cause)), "seed {seed}: {events:?}");
    }
}

/// Changes a throw as a wrong gain of the voltage sensor does: resistance and back-EMF are computed from the voltage.
fn read_with(gain: f64, throw: &mut Observation) {
    let features = &mut throw.features;
    for value in [&mut features.supply_v, &mut features.resistance_ohm, &mut features.back_emf_v_s_per_rad] {
        *value = value.map(|value| gain * value);
    }
}

#[test]
fn a_wrong_voltage_sensor_is_named_and_nothing_else() {
    // The gain of the sensor, and the true voltage. The last sensor is stuck while the supply falls.
    for (at, (gain, volts)) in [(0.67, 1.0), (0.85, 1.0), (1.2, 1.0), (1.0 / 0.72, 0.72)].into_iter().enumerate() {
        for before in [SOUND, OF_RATIOS] {
            let mut drive = learned(30 + at as u64, before);
            let mut events = drive.events_with(60, State { volts, ..before }, |throw| read_with(gain, throw));
            let slower = [Cause::SlowThrow, Cause::Unattributed, Cause::Supply, Cause::NotMonitored];
            events.retain(|event| volts >= 1.0 || !slower.contains(&event.cause));
            assert_eq!(channels(&events), [(Cause::Sensor, Some(SensorChannel::Supply))], "{gain}: {events:?}");
            let pct = events[0].change_pct.unwrap();
            assert!((pct - 100.0 * (gain - 1.0)).abs() < 5.0, "{gain}: {pct}");
            let [again, ended] = split(drive.events(60, before));
            assert!(again.is_empty() && ended.iter().any(|event| event.cause == Cause::Sensor), "{again:?}, {ended:?}");
        }
    }
}

/// The events of the next throws, read with this gain of the voltage sensor. The throws of one direction have no
/// estimate, as with a load that varies along the stroke.
fn events_one_sided(drive: &mut Drive, throws: usize, gain: f64, state: State) -> Vec<AlarmEvent> {
    drive.events_with(throws, state, |throw| {
        read_with(gain, throw);
        let is_rejected = throw.direction == Some(Direction::ReverseToNormal);
        throw.outcome.take_if(|outcome| is_rejected && outcome.is_ok());
    })
}

/// A healthy drive with a published voltage and one rejected direction.
fn one_sided(seed: u64) -> Drive {
    let mut drive = Drive::new(91_000 + seed, Voltage::Published);
    let events = events_one_sided(&mut drive, 120, 1.0, SOUND);
    assert!(events.iter().all(|event| event.cause == Cause::NotMonitored), "seed {seed}: {events:?}");
    drive
}

/// Less voltage makes dry friction look larger, also if the sensor of the voltage is stuck.
#[test]
fn a_weak_supply_is_no_friction_of_a_machine_with_one_rejected_direction() {
    for seed in 70..74 {
        for volts in [0.7, 0.65] {
            for gain in [1.0, 1.0 / volts] {
                let mut drive = one_sided(seed);
                let weak = State { volts, ..SOUND };
                let events = events_one_sided(&mut drive, 100, gain, weak);
                let blamed = events.iter().find(|event| {
                    Cause::PHYSICAL.contains(&event.cause)
                        || event.cause == Cause::Unattributed && event.change_pct.is_some()
                });
                assert!(blamed.is_none(), "seed {seed}, {volts}, {gain}: {events:#?}");
            }
        }
    }
}

/// The motor turns more slowly with less voltage, so the longer duration is no second alarm. A fault of a part at the
/// same time is a second alarm.
#[test]
fn a_change_that_a_published_loss_of_voltage_explains_is_no_second_alarm() {
    for (seed, has_toe_sensor, before) in
        [(40, true, OF_RATIOS), (41, true, OF_RATIOS), (42, false, SOUND), (43, false, SOUND)]
    {
        let healthy = || {
            let mut drive = Drive::new(91_000 + seed, Voltage::Published);
            drive.has_toe_sensor = has_toe_sensor;
            drive.stay_healthy(100, before);
            drive
        };
        for volts in [0.8, 0.7] {
            let mut drive = healthy();
            let weak = State { volts, ..before };
            let [raised, _] = split(drive.events(60, weak));
            // Rough throws can scatter so much that the monitor states which faults it cannot see.
            let causes = causes(raised.iter().filter(|event| event.cause != Cause::NotMonitored));
            assert_eq!(causes, [Cause::Supply], "seed {seed}, {volts}: {raised:?}");
        }
        let mut drive = healthy();
        let both = State { volts: 0.8, friction: 2.0, ..before };
        let [raised, _] = split(drive.events(60, both));
        let is_about_the_drive = |event: &AlarmEvent| [Cause::Unattributed, Cause::Friction].contains(&event.cause);
        assert!(raised.iter().any(is_about_the_drive), "seed {seed}: {raised:?}");
    }
}

/// A gear that loses torque does not change the back-EMF of the motor; weak magnets do.
#[test]
fn a_lost_torque_with_sound_magnets_points_to_the_gear() {
    for (seed, before) in [(50, SOUND), (51, SOUND), (52, OF_RATIOS), (53, OF_RATIOS)] {
        for (back_emf, is_sound) in [(1.0, true), (0.78, false)] {
            let mut drive = learned(seed, before);
            let weak = State { torque: 0.78, back_emf, ..before };
            let events = drive.events(100, weak);
            let of_motor: Vec<_> = events.iter().filter(|event| event.cause == Cause::Kt).collect();
            assert!(!of_motor.is_empty(), "seed {seed}, {back_emf}: {events:?}");
            for event in of_motor {
                let points_to_gear = event.text.contains("magnets are sound") && event.text.contains("gear");
                assert_eq!(points_to_gear, is_sound, "seed {seed}: {}", event.text);
            }
        }
    }
}

/// At a lower speed dry friction looks larger, but the motor does not lose torque.
#[test]
fn a_loss_of_torque_behind_a_weak_supply_is_named() {
    let weak = State { volts: 0.8, ..State::SOUND };
    for seed in [2, 14, 270] {
        let mut drive = Drive::after(110, seed, Voltage::Published);
        assert_eq!(causes(&drive.events(60, weak)), [Cause::Supply], "seed {seed}");
        let events = drive.events(24, State { torque: 0.78, ..weak });
        assert!(!events.is_empty() && events.iter().all(|event| event.cause == Cause::Kt), "seed {seed}: {events:#?}");
    }
}

/// The throws of the dip stay in the windows for a while, and are no evidence that a friction has ended.
#[test]
fn a_dip_of_the_supply_does_not_end_an_alarm_about_a_part() {
    for seed in 0..3 {
        let mut drive = learned(seed, SOUND);
        let dry = State { friction: 1.6, ..SOUND };
        assert_eq!(drive.events(40, dry)[0].cause, Cause::Friction);
        drive.events(4, State { volts: 0.84, ..dry });
        let after = causes(&drive.events(70, dry));
        assert!(!after.contains(&Cause::Friction), "seed {seed}: {after:?}");
    }
}

/// At the start of the motor, dry friction and the spring take a larger part of a lower torque. To a viscous model this is
/// more inertia in one direction and less in the other. Some starts leave the ratios only.
#[test]
fn a_weak_supply_of_a_machine_with_a_strong_spring_is_no_inertia() {
    for seed in 80..86 {
        for hides_start in [false, true] {
            let mut drive = learned(seed, SOUND);
            let events = drive.events_with(60, State { volts: 0.65, ..SOUND }, |throw| {
                let helps = throw.direction == Some(Direction::ReverseToNormal);
                let changes = if helps { [0.15_f64, 0.2, 0.15] } else { [-0.2, 0.0, -0.18] };
                let Some(Ok(estimate)) = &mut throw.outcome else { return };
                for (coefficient, change) in estimate.coefficients.iter_mut().zip(changes) {
                    *coefficient *= change.exp();
                }
                estimate.ratios_only = hides_start && helps;
            });
            let [raised, _] = split(events);
            let of_part = raised.iter().find(|event| Cause::PHYSICAL.contains(&event.cause));
            assert!(of_part.is_none(), "seed {seed}, {hides_start}: {raised:#?}");
            assert!(causes(&raised).contains(&Cause::Supply), "seed {seed}, {hides_start}: {raised:#?}");
        }
    }
}
