//! The friction clutch of the toe drive: an obstruction makes it slip, a normal throw does not.

use std::f64::consts::TAU;

use pointsd::estimate::{Identifier, Motor, Rejection, Settings};
use pointsd::simulate::{Conditions, Parameters, Rails, STEP_S, Sensor, Sensors, Waveform};
use pointsd::throw::{Direction, Throw};

use super::identify::simulated_in;

/// Current and screw speed \[A, rad/s\] at which the motor turns against the slipping clutch: armature and shaft in
/// steady state, by fixed-point iteration.
fn slipping(machine: &Parameters) -> (f64, f64) {
    let n = machine.gear_ratio;
    let constant = machine.clutch_n * machine.lead_mm / 1000.0 / TAU + machine.motor_dry_nm * n + machine.screw_dry_nm;
    let viscous = machine.motor_viscous_nms * n * n + machine.screw_viscous_nms;
    (0..50).fold((1.0, 0.0), |(current, _), _| {
        let speed = (machine.supply_v - machine.resistance_ohm * current) / (machine.back_emf_constant * n);
        ((constant + viscous * speed) / (machine.torque_constant * n), speed)
    })
}

#[test]
fn an_obstruction_anywhere_shows_the_current_of_the_slipping_clutch() {
    let machine = Parameters { screw_stiffness_nm: 0.0, ..Parameters::default() };
    let (expected_a, speed) = slipping(&machine);
    // The power of the back-EMF is the heat of clutch and friction.
    let torque = machine.torque_constant * machine.gear_ratio * expected_a;
    let electric = machine.supply_v * expected_a - machine.resistance_ohm * expected_a * expected_a;
    assert!((electric / (torque * speed) - 1.0).abs() < 1e-9);

    for direction in Direction::BOTH {
        for part in 1..20 {
            let at_mm = machine.stroke_mm * f64::from(part) / 20.0;
            let conditions = Conditions { obstruction_mm: Some(at_mm), ..Conditions::default() };
            let motion = machine.simulate(direction, &conditions, STEP_S).unwrap();
            assert!(!motion.completed);
            assert!(
                (motion.cut_off as f64 * motion.step_s - machine.timeout_s).abs() < 1e-3,
                "the controller gives up"
            );
            let (toe_mm, current_a) = (motion.toe_mm[motion.cut_off], motion.current_a[motion.cut_off]);
            // The obstacle yields by half a millimetre under the force of the clutch and, where they help, of the
            // rails.
            assert!((toe_mm - at_mm).abs() < 0.6, "{direction}, obstacle at {at_mm} mm: the toe is at {toe_mm} mm");
            assert!(
                (current_a / expected_a - 1.0).abs() < 0.005,
                "{direction}, obstacle at {at_mm} mm: {current_a} A, the clutch takes {expected_a} A"
            );
            let throw = simulated_in(&conditions, &machine, &Sensors::default(), direction, 4);
            let refused = Identifier::default().identify(&throw, &Settings::default()).outcome.unwrap_err();
            assert!(refused.is_incomplete(), "{direction}, obstacle at {at_mm} mm: {refused}");
        }
    }
}

#[test]
fn the_step_is_fine_enough_while_the_clutch_slips() {
    let conditions = Conditions { obstruction_mm: Some(70.0), ..Conditions::default() };
    for machine in [Parameters::default(), Parameters { drive_stiffness_n_m: 5e6, ..Parameters::default() }] {
        for direction in Direction::BOTH {
            let run = |step_s| machine.simulate(direction, &conditions, step_s).unwrap();
            let (coarse, fine) = (run(STEP_S), run(STEP_S / 16.0));
            for at in 0..coarse.cut_off {
                assert!((coarse.current_a[at] - fine.current_a[at * 16]).abs() < 0.03);
                assert!((coarse.toe_mm[at] - fine.toe_mm[at * 16]).abs() < 0.005);
            }
        }
    }
}

#[test]
fn no_normal_throw_slips() {
    let with_friction = |slide_friction| Rails { slide_friction, ..Rails::default() };
    let plain = Parameters::default();
    let machines = [
        plain.clone(),
        Parameters { rails: with_friction(0.3), ..plain.clone() },
        Parameters { neutral_mm: 115.0, rails: with_friction(0.3), ..plain.clone() },
        Parameters { drive_stiffness_n_m: 5e6, rails: with_friction(0.15), ..plain.clone() },
        Parameters { screw_stiffness_nm: 0.5, ..plain.clone() },
        Parameters { supply: Waveform::RectifiedMains { mains_hz: 50.0 }, ..plain },
        Parameters::series(),
    ];
    for machine in machines {
        for direction in Direction::BOTH {
            for temperature_c in [-40.0, 20.0] {
                let conditions = Conditions { temperature_c, ..Conditions::default() };
                let throw = |clutch_n| {
                    Parameters { clutch_n, ..machine.clone() }.simulate(direction, &conditions, STEP_S).unwrap()
                };
                // Half the clutch force is enough for a throw, so the clutch has a reserve for wear.
                let motion = throw(machine.clutch_n / 2.0);
                assert!(motion.completed, "{direction}, {temperature_c} °C: {machine:?}");
                assert_eq!(motion, throw(1e9), "{direction}, {temperature_c} °C: {machine:?}");
            }
        }
    }
}

#[test]
fn stiff_rails_are_more_than_the_clutch_can_bend() {
    // The force 3 EI / L³ of both rails at the full stroke is three times that of the clutch.
    let mut machine = Parameters::default();
    machine.rails.bending_stiffness_n_m2 = 3.0 * machine.clutch_n / 0.115 * machine.rails.length_m.powi(3) / 6.0;
    let motion = machine.simulate(Direction::NormalToReverse, &Conditions::default(), STEP_S).unwrap();
    let reached = motion.toe_mm[motion.cut_off];
    assert!(!motion.completed && (reached / (115.0 / 3.0) - 1.0).abs() < 0.03, "{reached} mm");
}

#[test]
fn impossible_conditions_are_refused_by_name() {
    let plain = Conditions::default();
    for (conditions, name) in [
        (Conditions { obstruction_mm: Some(-1.0), ..plain }, "obstruction_mm"),
        (Conditions { obstruction_mm: Some(116.0), ..plain }, "obstruction_mm"),
        (Conditions { temperature_c: f64::NAN, ..plain }, "temperature_c"),
        (Conditions { temperature_c: 200.0, ..plain }, "temperature_c"),
        (Conditions { supply_ratio: -0.1, ..plain }, "supply_ratio"),
    ] {
        let error = Parameters::default().simulate(Direction::NormalToReverse, &conditions, STEP_S).unwrap_err();
        assert_eq!(error.key, name);
    }
}

#[test]
fn a_series_motor_slips_its_clutch_too() {
    let machine = Parameters::series();
    let conditions = Conditions { obstruction_mm: Some(40.0), ..Conditions::default() };
    for direction in Direction::BOTH {
        let motion = machine.simulate(direction, &conditions, STEP_S).unwrap();
        let current_a = motion.current_a[motion.cut_off];
        assert!(!motion.completed && (1.0..6.0).contains(&current_a), "{current_a} A");
        let throw = simulated_in(&conditions, &machine, &Sensors::default(), direction, 4);
        let settings = Settings { motor: Motor::Series, ..Settings::default() };
        let refused = Identifier::default().identify(&throw, &settings).outcome.unwrap_err();
        assert!(refused.is_incomplete(), "{direction}: {refused}");
    }
}

/// A throw against an obstacle, on a machine whose motor stays on until the toe is nearly at the end of the stroke.
fn obstructed(sensors: &Sensors, direction: Direction, at_mm: f64, seed: u64) -> Throw {
    let machine = Parameters { cut_off_mm: 0.05, ..Parameters::default() };
    let conditions = Conditions { obstruction_mm: Some(at_mm), ..Conditions::default() };
    assert!(!machine.simulate(direction, &conditions, sensors.step_s()).unwrap().completed);
    simulated_in(&conditions, &machine, sensors, direction, seed)
}

#[test]
fn an_obstruction_in_the_last_part_of_a_known_stroke_is_seen() {
    let settings = Settings { stroke_mm: Some(115.0), ..Settings::default() };
    let identify = |sensors: &Sensors, at_mm: f64| {
        let throw = obstructed(sensors, Direction::NormalToReverse, at_mm, 5);
        Identifier::default().identify(&throw, &settings).outcome
    };
    for at_mm in [80.0, 105.0, 109.5, 110.0, 111.0, 112.0] {
        let refused = identify(&Sensors::default(), at_mm).unwrap_err();
        assert!(refused.is_incomplete(), "{at_mm} mm: {refused}");
    }
    // No obstruction: the motor may run on against its clutch at the end of the stroke, and the sensor may have a wrong
    // gain.
    for gain_pct in [0.0, -1.5, 1.5] {
        let position = Sensor { gain_pct, ..Sensor::default() };
        let found = identify(&Sensors { position, ..Sensors::default() }, 114.3);
        assert!(found.is_ok(), "gain {gain_pct} %: {found:?}");
    }
}

/// The throws end close to the end of the stroke, at 86 to 94 % of it.
#[test]
fn a_throw_that_ends_before_its_stroke_is_incomplete_however_the_motor_ends() {
    let settings = Settings { stroke_mm: Some(115.0), ..Settings::default() };
    let identify = |direction, conditions: &Conditions, timeout_s| {
        let machine = Parameters { timeout_s, ..Parameters::default() };
        let throw = simulated_in(conditions, &machine, &Sensors::default(), direction, 7);
        Identifier::default().identify(&throw, &settings)
    };
    let (free, timeout_s) = (Conditions::default(), Parameters::default().timeout_s);
    for direction in Direction::BOTH {
        for at_pct in [86.0, 88.0, 90.0, 92.0, 93.0, 94.0] {
            let far_mm = match direction {
                Direction::NormalToReverse => 1.15 * at_pct,
                Direction::ReverseToNormal => 115.0 - 1.15 * at_pct,
            };
            // An obstruction: the clutch slips until the controller gives up, or until a protection cuts the motor off.
            let blocked = Conditions { obstruction_mm: Some(far_mm), ..free };
            let whole_s = identify(direction, &free, timeout_s).features.duration_s.unwrap();
            for timeout_s in [timeout_s, whole_s + 0.2, whole_s + 1.0] {
                let refused = identify(direction, &blocked, timeout_s).outcome.unwrap_err();
                assert!(refused.is_incomplete(), "{direction}, {at_pct} %, {timeout_s} s: {refused}");
            }
            // The motor loses its supply during the movement.
            for late_s in [-0.06, -0.03, 0.0] {
                let found = identify(direction, &free, whole_s * at_pct / 100.0 + late_s);
                let travel_mm = found.features.travel_mm.unwrap();
                let is_short = travel_mm < 0.945 * 115.0;
                assert!(
                    !is_short || found.outcome.as_ref().is_err_and(Rejection::is_incomplete),
                    "{direction}, {at_pct} %, {late_s} s, {travel_mm} mm: {:?}",
                    found.outcome
                );
            }
        }
    }
}

/// If the step of the converter is larger than the noise, its output changes at some positions and stands still at
/// others.
#[test]
fn an_obstruction_before_a_quiet_converter_is_no_stuck_sensor() {
    for noise in [0.002, 0.005, 0.01, 0.02, 0.03] {
        // The offset puts the position at rest between two codes.
        for (direction, offset, seed) in
            [(Direction::NormalToReverse, 0.0366, 40), (Direction::ReverseToNormal, 0.0269, 41)]
        {
            let position = Sensor { noise, offset, full_scale: Some(150.0), bits: Some(12), ..Sensor::default() };
            let sensors = Sensors { position, ..Sensors::default() };
            for at_mm in [20.0, 35.0, 50.0, 60.0, 75.0, 90.0, 100.0] {
                let throw = obstructed(&sensors, direction, at_mm, seed);
                let refused = Identifier::default().identify(&throw, &Settings::default()).outcome.unwrap_err();
                assert!(refused.is_incomplete(), "{noise} mm, {direction}, {at_mm} mm: {refused}");
            }
        }
    }
}
