//! The whole estimator on simulated throws: it must return the simulated coefficients.

use pointsd::estimate::{Identification, Identifier, Settings};
use pointsd::simulate::{Coefficients, Conditions, Parameters, Rails, Sensors};
use pointsd::throw::{Direction, Throw};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// A throw of a machine as these sensors record it; `seed` is that of their noise.
pub(crate) fn simulated(machine: &Parameters, sensors: &Sensors, direction: Direction, seed: u64) -> Throw {
    simulated_in(&Conditions::default(), machine, sensors, direction, seed)
}

/// A throw in these conditions.
pub(crate) fn simulated_in(
    conditions: &Conditions,
    machine: &Parameters,
    sensors: &Sensors,
    direction: Direction,
    seed: u64,
) -> Throw {
    let motion = machine.simulate(direction, conditions, sensors.step_s()).unwrap();
    let trace = sensors.record(&motion, direction, &mut ChaCha8Rng::seed_from_u64(seed)).unwrap().trace;
    Throw { direction: Some(direction), anti_alias_hz: sensors.anti_alias_hz, ..Throw::recorded(trace) }
}

pub(crate) fn settings_of(machine: &Parameters) -> Settings {
    Settings { lead_mm: machine.lead_mm, neutral_mm: machine.neutral_mm, ..Settings::default() }
}

/// The default machine without dry friction, which equation (10) describes completely.
pub(crate) fn without_dry_friction() -> Parameters {
    let machine = Parameters::default();
    let rails = Rails { slide_friction: 0.0, ..machine.rails };
    Parameters { motor_dry_nm: 0.0, screw_dry_nm: 0.0, rails, ..machine }
}

/// Checks that each coefficient is within this relative error of the true one.
#[track_caller]
pub(crate) fn assert_near(found: [f64; 3], known: &Coefficients, limit: f64, what: &str) {
    for (found, known) in found.into_iter().zip(known.values()) {
        assert!((found / known - 1.0).abs() < limit, "{what}: {found} for {known}");
    }
}

fn identify(throw: &Throw, settings: &Settings) -> Identification {
    Identifier::default().identify(throw, settings)
}

#[test]
fn a_noise_free_throw_gives_the_machines_physics_within_1_pct_in_both_directions() {
    for neutral_mm in [0.0, 57.5, 115.0] {
        let machine = Parameters { neutral_mm, ..without_dry_friction() };
        let known = machine.coefficients().unwrap();
        for direction in Direction::BOTH {
            let throw = simulated(&machine, &Sensors::perfect(1000.0), direction, 1);
            let found = identify(&throw, &settings_of(&machine));
            assert_eq!(found.direction, Some(direction));
            let what = format!("{direction}, neutral {neutral_mm}");
            assert_near(found.outcome.unwrap().coefficients(), &known, 0.01, &what);
        }
    }
}

#[test]
fn the_kink_of_the_current_at_switch_on_causes_no_error_anywhere_between_two_samples() {
    for (sample_rate_hz, inductance_h) in
        [(500.0, 0.02), (500.0, 0.04), (1000.0, 0.01), (1000.0, 0.02), (1000.0, 0.04), (1500.0, 0.02), (2000.0, 0.01)]
    {
        let machine = Parameters { inductance_h, ..without_dry_friction() };
        let known = machine.coefficients().unwrap();
        for part in [0.0, 0.3, 0.5, 0.8] {
            for direction in Direction::BOTH {
                let sensors = Sensors { before_s: 0.2 + part / sample_rate_hz, ..Sensors::perfect(sample_rate_hz) };
                let estimate =
                    identify(&simulated(&machine, &sensors, direction, 1), &settings_of(&machine)).outcome.unwrap();
                let what = format!("{sample_rate_hz} Hz, {inductance_h} H, {part} of an interval, {direction}");
                assert_near(estimate.coefficients(), &known, 0.003, &what);
            }
        }
    }
}

#[test]
fn a_spring_that_drives_the_motor_is_distinguished_from_a_current_of_the_other_polarity() {
    for screw_stiffness_nm in [0.1, 0.2, 0.5] {
        let machine = Parameters { screw_stiffness_nm, ..without_dry_friction() };
        let known = machine.coefficients().unwrap();
        for (direction, signed_current) in Direction::BOTH.into_iter().flat_map(|d| [(d, false), (d, true)]) {
            let sensors = Sensors { signed_current, ..Sensors::perfect(1000.0) };
            let throw = simulated(&machine, &sensors, direction, 1);
            let estimate = identify(&throw, &settings_of(&machine)).outcome.unwrap();
            assert_near(estimate.coefficients(), &known, 0.005, &format!("{screw_stiffness_nm} N m/rad, {direction}"));
        }
    }
}

#[test]
fn a_declared_direction_that_the_toe_contradicts_is_flagged_and_the_movement_wins() {
    let machine = Parameters::default();
    let mut throw = simulated(&machine, &Sensors::default(), Direction::NormalToReverse, 1);
    for (declared, contradicted) in
        [(None, None), (Some(Direction::NormalToReverse), Some(false)), (Some(Direction::ReverseToNormal), Some(true))]
    {
        throw.direction = declared;
        let found = identify(&throw, &settings_of(&machine));
        assert_eq!(found.direction, Some(Direction::NormalToReverse));
        assert_eq!(found.direction_contradicted, contradicted);
        assert!(found.outcome.is_ok());
    }
}
