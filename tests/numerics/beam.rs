//! The simulated machine against an independent reference: a second implementation of equations (1) to (9), with the
//! rails as a chain of rigid links (Hencky) without reduction to modes, small Runge-Kutta steps, and friction as a
//! steep tanh.

use pointsd::simulate::{Conditions, Motion, Parameters, Rails, STEP_S, Waveform};
use pointsd::throw::Direction;

/// Links of the chain: two between consecutive slide chairs.
const LINKS: usize = 26;
const STATES: usize = 5 + 2 * LINKS;

struct Reference {
    machine: Parameters,
    /// Travel of the toe per angle of the screw \[m/rad\].
    p: f64,
    /// Mass of each link \[kg\].
    mass: [f64; LINKS],
    /// Force of each link on the slide chair under it \[N\].
    normal: [f64; LINKS],
}

impl Reference {
    fn new(machine: &Parameters) -> Self {
        let rails = &machine.rails;
        let link_kg = 2.0 * rails.mass_kg_m * rails.length_m / LINKS as f64;
        let mut mass = [link_kg; LINKS];
        mass[LINKS - 1] = 0.5 * link_kg + rails.toe_mass_kg;
        let chair_n = 2.0 * link_kg * 9.81;
        let normal = std::array::from_fn(|at| match at {
            _ if at == LINKS - 1 => 0.5 * chair_n,
            _ if at % 2 == 1 => chair_n,
            _ => 0.0,
        });
        Self { machine: machine.clone(), p: machine.lead_mm / 1000.0 / std::f64::consts::TAU, mass, normal }
    }

    /// State: current, motor angle and speed (over the gear ratio), screw angle and speed, deflections, their speeds.
    fn derivative(&self, z: &[f64; STATES]) -> [f64; STATES] {
        let m = &self.machine;
        let n = m.gear_ratio;
        let (w, v) = (&z[5..5 + LINKS], &z[5 + LINKS..]);
        let toe_force = m.drive_stiffness_n_m * (self.p * z[3] - w[LINKS - 1])
            + m.drive_damping_ns_m * (self.p * z[4] - v[LINKS - 1]);
        let gear = m.gear_stiffness_nm * (z[1] - z[3]) + m.gear_damping_nms * (z[2] - z[4]);
        let dry = n * m.motor_dry_nm * (z[2] / 0.01).tanh();
        let mut d = [0.0; STATES];
        d[0] = (m.supply_v - m.resistance_ohm * z[0] - m.back_emf_constant * n * z[2]) / m.inductance_h;
        d[1] = z[2];
        d[2] = (n * m.torque_constant * z[0] - m.motor_viscous_nms * n * n * z[2] - dry - gear)
            / ((m.rotor_inertia_kg_m2 + m.load_inertia_kg_m2) * n * n);
        d[3] = z[4];
        d[4] = (gear - m.screw_viscous_nms * z[4] - m.screw_stiffness_nm * z[3] - self.p * toe_force)
            / m.screw_inertia_kg_m2;
        let force = self.bending(w);
        for at in 0..LINKS {
            let friction = m.rails.slide_friction * self.normal[at] * (v[at] / 1e-4).tanh();
            let drive = if at == LINKS - 1 { toe_force } else { 0.0 };
            d[5 + at] = v[at];
            d[5 + LINKS + at] = (force[at] - friction + drive) / self.mass[at];
        }
        d
    }

    /// Forces of the rotational springs between links; the spring at the clamped heel stands for half a link.
    fn bending(&self, w: &[f64]) -> [f64; LINKS] {
        let h = self.machine.rails.length_m / LINKS as f64;
        let stiffness = 2.0 * self.machine.rails.bending_stiffness_n_m2 / h;
        let mut force = [0.0; LINKS];
        for joint in 0..LINKS {
            let before = if joint == 0 { 0.0 } else { w[joint - 1] };
            let behind = if joint < 2 { 0.0 } else { w[joint - 2] };
            let turn = if joint == 0 { w[0] / h } else { (w[joint] - 2.0 * before + behind) / h };
            let moment = if joint == 0 { 2.0 * stiffness * turn } else { stiffness * turn };
            force[joint] -= moment / h;
            if joint >= 1 {
                force[joint - 1] += 2.0 * moment / h;
            }
            if joint >= 2 {
                force[joint - 2] -= moment / h;
            }
        }
        force
    }

    /// Current \[A\] and toe position \[mm\] at every `STEP_S`, from rest at normal.
    fn run(&self, duration_s: f64, steps_between: usize) -> Vec<(f64, f64)> {
        let h = STEP_S / steps_between as f64;
        let mut z = [0.0; STATES];
        let mut seen = vec![(0.0, 0.0)];
        let along = |z: &[f64; STATES], k: &[f64; STATES], h: f64| -> [f64; STATES] {
            std::array::from_fn(|at| z[at] + h * k[at])
        };
        while (seen.len() as f64) * STEP_S <= duration_s {
            for _ in 0..steps_between {
                let k1 = self.derivative(&z);
                let k2 = self.derivative(&along(&z, &k1, 0.5 * h));
                let k3 = self.derivative(&along(&z, &k2, 0.5 * h));
                let k4 = self.derivative(&along(&z, &k3, h));
                z = std::array::from_fn(|at| z[at] + h / 6.0 * (k1[at] + 2.0 * k2[at] + 2.0 * k3[at] + k4[at]));
            }
            seen.push((z[0], z[4 + LINKS] * 1000.0));
        }
        seen
    }
}

fn largest_difference(motion: &Motion, reference: &[(f64, f64)]) -> (f64, f64) {
    let pairs = motion.current_a.iter().zip(&motion.toe_mm).zip(reference);
    pairs.fold((0.0, 0.0), |(a, mm), ((current, toe), expected)| {
        ((current - expected.0).abs().max(a), (toe - expected.1).abs().max(mm))
    })
}

#[test]
fn the_machine_follows_an_independent_integration_of_its_equations() {
    for slide_friction in [0.0, 0.1] {
        // No friction at the screw: with the springs of equation (8) its steep tanh would need smaller steps.
        let rails = Rails { slide_friction, damping_ratio: 0.0, ..Rails::default() };
        let machine = Parameters { screw_dry_nm: 0.0, rails, ..Parameters::default() };
        let reference = Reference::new(&machine).run(1.0, 20);
        let motion = machine.simulate(Direction::NormalToReverse, &Conditions::default(), STEP_S).unwrap();
        let (current_a, toe_mm) = largest_difference(&motion, &reference);
        println!("mu {slide_friction}: largest differences {current_a:.4} A, {:.1} um", toe_mm * 1000.0);
        assert!(current_a < 0.08, "mu {slide_friction}: {current_a} A");
        assert!(toe_mm < 0.02, "mu {slide_friction}: {toe_mm} mm");
    }
}

/// Largest differences of current and position to a step 64 times as fine, while the motor is on.
fn step_error(machine: &Parameters, direction: Direction) -> (f64, f64) {
    let run = |step_s| machine.simulate(direction, &Conditions::default(), step_s).unwrap();
    let (coarse, fine) = (run(STEP_S), run(STEP_S / 64.0));
    let on = coarse.cut_off.min(fine.cut_off / 64);
    assert!(coarse.completed && fine.completed && on > 10_000);
    let largest = |a: &[f64], b: &[f64]| (0..on).map(|at| (a[at] - b[at * 64]).abs()).fold(0.0, f64::max);
    (largest(&coarse.current_a, &fine.current_a), largest(&coarse.toe_mm, &fine.toe_mm))
}

#[test]
fn the_normal_step_is_fine_enough() {
    let with_friction = |slide_friction| Rails { slide_friction, ..Rails::default() };
    let plain = Parameters::default();
    let machines = [
        ("plain", plain.clone()),
        ("heavy friction", Parameters { rails: with_friction(0.15), ..plain.clone() }),
        ("soft drive", Parameters { drive_stiffness_n_m: 5e6, rails: with_friction(0.15), ..plain.clone() }),
        ("mains", Parameters { supply: Waveform::RectifiedMains { mains_hz: 50.0 }, ..plain.clone() }),
        ("series motor", Parameters::series()),
    ];
    for (name, machine) in machines {
        for direction in Direction::BOTH {
            let (current_a, toe_mm) = step_error(&machine, direction);
            println!("{name}, {direction}: {current_a:.4} A, {:.3} um", toe_mm * 1000.0);
            assert!(current_a < 0.02, "{name}, {direction}: {current_a} A");
            assert!(toe_mm < 0.002, "{name}, {direction}: {toe_mm} mm");
        }
    }
}

#[test]
fn break_away_friction_holds_the_machine_longer() {
    // The motor starts when KT I exceeds its dry friction, times the break-away ratio.
    let current_at_start = |breakaway_ratio: f64| {
        let machine = Parameters { breakaway_ratio, motor_dry_nm: 1.0, screw_dry_nm: 0.0, ..Parameters::default() };
        let motion = machine.simulate(Direction::NormalToReverse, &Conditions::default(), STEP_S / 16.0).unwrap();
        let at = motion.toe_mm.iter().position(|mm| *mm > 1e-9).unwrap();
        motion.current_a[at]
    };
    let (plain, sticky) = (current_at_start(1.0), current_at_start(2.0));
    let expected = 1.0 / Parameters::default().torque_constant;
    println!("starts at {plain:.2} A, with break-away friction at {sticky:.2} A");
    // Gearbox and drive wind up before the toe moves; then the break-away friction is added.
    assert!(plain > expected, "{plain} A, friction alone needs {expected}");
    assert!(((sticky - plain) / expected - 1.0).abs() < 0.05, "{plain} and {sticky} A, {expected} apart expected");
}
