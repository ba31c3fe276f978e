//! The simulated machine against its own physics.

use pointsd::simulate::{Conditions, Fleet, FleetSettings, Parameters, STEP_S, Sensors};
use pointsd::throw::Direction;

#[test]
fn the_default_machine_is_a_credible_one() {
    let machine = Parameters::default();
    let known = machine.coefficients().unwrap();
    assert!((known.b0 / 203.0 - 1.0).abs() < 0.01, "{known:?}");
    assert!((known.a1 / 5.9 - 1.0).abs() < 0.03, "{known:?}");
    assert!((known.a0 / 1.56 - 1.0).abs() < 0.02, "{known:?}");
    for direction in Direction::BOTH {
        let motion = machine.simulate(direction, &Conditions::default(), STEP_S).unwrap();
        let duration = motion.cut_off as f64 * motion.step_s;
        let peak = motion.current_a.iter().fold(0.0_f64, |most, &a| most.max(a));
        let travel = (motion.toe_mm[motion.toe_mm.len() - 1] - motion.toe_mm[0]).abs();
        assert!(motion.completed);
        assert!((3.5..5.0).contains(&duration), "{duration} s");
        assert!((11.0..15.0).contains(&peak), "{peak} A");
        assert!((travel - machine.stroke_mm).abs() < 0.6, "{travel} mm");
    }
}

#[test]
fn a_seed_reproduces_a_fleet() {
    let settings = FleetSettings { machines: 2, sensors: Sensors::default(), ..FleetSettings::default() };
    let throws = |seed| {
        let mut fleet = Fleet::new(&settings, seed).unwrap();
        let machines = fleet.machines();
        (0..4).map(|at| machines[at % 2].next_throw().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(throws(7), throws(7));
    assert_ne!(throws(7)[0].trace, throws(8)[0].trace);
}
