//! The simulated machine against analytical results.

use jiff::Timestamp;
use pointsd::simulate::{
    Conditions, Fault, FleetFault, FleetScatter, FleetSettings, Parameters, Part, RailModel, Rails, STEP_S, Sensor,
    Sensors, Shape, SimulatedMachine, Spread,
};
use pointsd::throw::Direction;
use rand_chacha::rand_core::SeedableRng;

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
        assert!((duration - 4.3).abs() < 0.15, "{duration} s");
        assert!((peak - 13.0).abs() < 1.0, "{peak} A");
        let running = &motion.current_a[5000..motion.cut_off];
        let mean = running.iter().sum::<f64>() / running.len() as f64;
        // About 1 A against the spring of the rails, less when the spring helps.
        let expected = if direction == Direction::NormalToReverse { 0.7..1.3 } else { 0.2..0.7 };
        assert!(expected.contains(&mean), "{direction}: {mean} A running");
        let beyond = motion.toe_mm.iter().fold(0.0_f64, |most, &mm| most.max(-mm).max(mm - machine.stroke_mm));
        assert!(beyond < 0.5, "the toe goes {beyond} mm into the stock rail");
        assert!((travel - machine.stroke_mm).abs() < 0.6, "{travel} mm");
    }
}

#[test]
fn a_seed_reproduces_a_fleet() {
    let settings = FleetSettings { machines: 2, sensors: Sensors::default(), ..FleetSettings::default() };
    let throws = |seed| {
        let mut machines = settings.build(seed).unwrap();
        (0..4).map(|at| machines[at % 2].next_throw("a", Timestamp::UNIX_EPOCH).unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(throws(7), throws(7));
    assert_ne!(throws(7)[0].trace, throws(8)[0].trace);
}

/// The default machine with quasi-static rails.
pub(crate) fn lumped() -> Parameters {
    Parameters { rails: Rails { model: RailModel::Lumped, ..Rails::default() }, ..Parameters::default() }
}

pub(crate) const NO_SCATTER: FleetScatter =
    FleetScatter { kt_pct: 0.0, friction_pct: 0.0, stiffness_pct: 0.0, supply_pct: 0.0, correlation: 0.0 };
const NO_SPREAD: Spread = Spread { kt_pct: 0.0, friction_pct: 0.0, stiffness_pct: 0.0, inertia_pct: 0.0 };

#[test]
fn a_longer_life_begins_as_the_shorter_one_did() {
    let life = |throws: usize| {
        let walk = Fault { part: Part::Inertia, shape: Shape::RandomWalk { throws: 5 }, size_pct: 10.0, from_throw: 2 };
        let faults = vec![FleetFault { machine: 0, fault: walk }];
        let settings = FleetSettings { machines: 1, machine: lumped(), faults, ..FleetSettings::default() };
        let mut machine = settings.build(9).unwrap().remove(0);
        (0..throws).map(|_| machine.next_throw("a", Timestamp::UNIX_EPOCH).unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(life(8)[..3], life(3)[..]);
}

#[test]
fn two_faults_at_once_change_the_coefficients_that_each_changes_alone() {
    let step = |part, size_pct| Fault { part, shape: Shape::Step, size_pct, from_throw: 1 };
    let change = |faults: &[Fault]| {
        let faults = faults.iter().map(|&fault| FleetFault { machine: 0, fault }).collect();
        let (scatter, spread) = (NO_SCATTER, NO_SPREAD);
        let settings =
            FleetSettings { machines: 1, machine: lumped(), faults, scatter, spread, ..FleetSettings::default() };
        let mut machine = settings.build(1).unwrap().remove(0);
        let [new, worn] = std::array::from_fn(|_| machine.next_machine().unwrap().0.coefficients().unwrap());
        [worn.b0 / new.b0, worn.a1 / new.a1, worn.a0 / new.a0]
    };
    let kt = change(&[step(Part::Kt, -10.0)]);
    let stiffness = change(&[step(Part::Stiffness, 20.0)]);
    let both = change(&[step(Part::Kt, -10.0), step(Part::Stiffness, 20.0)]);
    for at in [0, 2] {
        assert!((both[at] / (kt[at] * stiffness[at]) - 1.0).abs() < 1e-9, "{both:?}, {kt:?}, {stiffness:?}");
    }
    assert!((both[0] - 0.9).abs() < 1e-9 && (both[2] - 1.2).abs() < 1e-9, "{both:?}");
}

#[test]
fn a_random_walk_is_as_wide_as_set_after_its_throws() {
    let walk = Fault { part: Part::Kt, shape: Shape::RandomWalk { throws: 4 }, size_pct: 5.0, from_throw: 0 };
    let machines = 60;
    let settings = FleetSettings {
        machines,
        machine: lumped(),
        scatter: NO_SCATTER,
        spread: NO_SPREAD,
        faults: (0..machines).map(|machine| FleetFault { machine, fault: walk }).collect(),
        ..FleetSettings::default()
    };
    let end = |mut machine: SimulatedMachine| {
        let worn = (0..4).map(|_| machine.next_machine().unwrap().0).last().unwrap();
        worn.torque_constant / settings.machine.torque_constant - 1.0
    };
    let ends: Vec<f64> = settings.build(12).unwrap().into_iter().map(end).collect();
    let sd = (ends.iter().map(|end| end * end).sum::<f64>() / machines as f64).sqrt();
    // 60 machines determine a standard deviation to 9 %.
    assert!((sd / 0.05 - 1.0).abs() < 0.3, "{sd}");
}

#[test]
fn a_sagging_supply_slows_the_throw_and_then_stops_it() {
    let machine = Parameters::default();
    for direction in Direction::BOTH {
        let run = |supply_ratio| {
            let conditions = Conditions { supply_ratio, ..Conditions::default() };
            machine.simulate(direction, &conditions, STEP_S).unwrap()
        };
        let duration = |ratio| run(ratio).cut_off as f64 * STEP_S;
        assert!(duration(0.7) > 1.3 * duration(1.0) && run(0.7).completed);
        let starved = run(0.02);
        assert!(!starved.completed && (starved.cut_off as f64 * STEP_S - machine.timeout_s).abs() < 1e-3);
    }
}

#[test]
fn magnet_and_back_emf_fade_together_and_rails_soften_with_heat() {
    let machine = Parameters::default();
    let (cold, hot) = (machine.at_temperature(-10.0), machine.at_temperature(40.0));
    for (is, was, pct) in [
        (hot.torque_constant, machine.torque_constant, -3.0),
        // Torque and back-EMF have the same flux.
        (hot.back_emf_constant, machine.back_emf_constant, -3.0),
        (hot.rails.bending_stiffness_n_m2, machine.rails.bending_stiffness_n_m2, -2.0),
        (cold.torque_constant, machine.torque_constant, 4.5),
        (cold.rails.bending_stiffness_n_m2, machine.rails.bending_stiffness_n_m2, 3.0),
        (hot.resistance_ohm, machine.resistance_ohm, 7.8),
    ] {
        assert!(((is / was - 1.0) * 100.0 - pct).abs() < 1e-9, "{is} and {was}, {pct} % expected");
    }
    assert!(
        cold.motor_viscous_nms > 1.3 * machine.motor_viscous_nms && hot.screw_viscous_nms < machine.screw_viscous_nms
    );
    let a0 = |machine: &Parameters| machine.coefficients().unwrap().a0;
    assert!((a0(&hot) / a0(&machine) - 0.98).abs() < 1e-3);
    let throw = |machine: &Parameters, temperature_c| {
        let conditions = Conditions { temperature_c, ..Conditions::default() };
        machine.simulate(Direction::NormalToReverse, &conditions, STEP_S).unwrap()
    };
    assert_eq!(throw(&machine, 40.0), throw(&hot, 20.0), "the movement has the coefficients of its temperature");
}

#[test]
fn converters_of_12_and_16_bits_round_to_their_step() {
    let motion = lumped().simulate(Direction::NormalToReverse, &Conditions::default(), STEP_S).unwrap();
    for bits in [12, 16] {
        let channel = Sensor { noise: 0.0, full_scale: Some(150.0), bits: Some(bits), ..Sensor::default() };
        let sensors = Sensors { position: channel, ..Sensors::perfect(1000.0) };
        let record = |sensors: &Sensors| {
            let mut rng = rand_chacha::ChaCha12Rng::seed_from_u64(1);
            sensors.record(&motion, Direction::NormalToReverse, &mut rng).unwrap().trace
        };
        let (rounded, exact) = (record(&sensors), record(&Sensors::perfect(1000.0)));
        let step = 300.0 / 2.0_f64.powi(bits.cast_signed());
        let errors = rounded.position_mm().iter().zip(exact.position_mm()).map(|(a, b)| (a - b).abs());
        let largest = errors.fold(0.0, f64::max);
        assert!(largest <= step / 2.0 + 1e-12 && largest > 0.4 * step, "{bits} bits: {largest} mm, step {step}");
    }
}

#[test]
fn an_impossible_machine_is_refused_by_name() {
    let plain = Parameters::default();
    for (machine, name) in [
        (Parameters { clutch_n: 0.0, ..plain.clone() }, "clutch_n"),
        (Parameters { rectifier_ripple: 1.5, ..plain.clone() }, "rectifier_ripple"),
        (Parameters { breakaway_ratio: 0.5, ..plain.clone() }, "breakaway_ratio"),
        (Parameters { gear_ratio: f64::INFINITY, ..plain.clone() }, "gear_ratio"),
        (Parameters { rails: Rails { elements: 2, ..Rails::default() }, ..plain.clone() }, "rails.elements"),
        (Parameters { cut_off_mm: 200.0, ..plain.clone() }, "cut_off_mm"),
        (Parameters { timeout_s: 0.0, ..plain }, "timeout_s"),
    ] {
        let error = machine.simulate(Direction::NormalToReverse, &Conditions::default(), STEP_S).unwrap_err();
        assert_eq!(error.key, name);
        assert!(error.to_string().contains("must be"), "{error}");
    }
}
