//! A real drive: the Electro-Mechanical Positioning System (Janot, Gautier, Brunot 2019), closed loop, 1 kHz.

use std::{env, fs};

use pointsd::estimate::{
    Hold, Identifier, Rejection, Settings,
    sriv::{Problem, Sriv, Termination, Workspace},
};
use pointsd::throw::{Throw, Trace};

/// Force per unit of the current reference \[N\].
const FORCE_N: f64 = 35.150_651_88;
const INTERVAL_S: f64 = 1e-3;

/// Force \[N\] and position \[m\] from the file in `POINTSD_EMPS`; `None`, with a message, without this variable.
fn recorded() -> Option<(Vec<f64>, Vec<f64>)> {
    let Some(path) = env::var_os("POINTSD_EMPS") else {
        println!("skipped: POINTSD_EMPS does not name the file of the benchmark, see deploy/RECORDINGS.md");
        return None;
    };
    let text = fs::read_to_string(&path).map_err(|error| format!("POINTSD_EMPS={}: {error}", path.display())).unwrap();
    let rows = text.lines().skip(1).map(|line| {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        (FORCE_N * cells[1], cells[2])
    });
    Some(rows.unzip())
}

#[test]
fn mass_friction_and_offset_of_a_real_drive_come_out_as_published() {
    let Some((force, position)) = recorded() else { return };
    let velocity: Vec<f64> =
        (1..position.len() - 1).map(|k| (position[k + 1] - position[k - 1]) / (2.0 * INTERVAL_S)).collect();
    // The sign of the mean velocity over 20 ms: single differences alternate around zero by the step of the encoder.
    let sign: Vec<f64> = (0..velocity.len())
        .map(|k| {
            let mean = velocity[k.saturating_sub(10)..(k + 11).min(velocity.len())].iter().sum::<f64>();
            if mean.abs() < 1e-3 { 0.0 } else { mean.signum() }
        })
        .collect();
    let sriv = Sriv::<1, 3, 4>::new([0, 0, 0]).unwrap();
    let ones = vec![1.0; sign.len()];
    let inputs = [(&force[1..force.len() - 1], Hold::First), (&sign, Hold::First), (&ones, Hold::Zero)];
    let problem = Problem { interval_s: INTERVAL_S, output: &velocity, inputs, equilibrium: None };
    let found = sriv.identify(&problem, &mut Workspace::default()).unwrap();
    assert_eq!(found.termination, Termination::Converged);
    let [b_force, b_sign, b_constant, a1] = found.parameters;
    let physics = [1.0 / b_force, a1 / b_force, -b_sign / b_force, -b_constant / b_force];
    println!(
        "M {:.2} kg, Fv {:.2} N s/m, Fc {:.2} N, offset {:.3} N, fit {:.4}",
        physics[0], physics[1], physics[2], physics[3], found.fit
    );
    for (name, found, published) in [
        ("M", physics[0], 95.1089),
        ("Fv", physics[1], 203.5034),
        ("Fc", physics[2], 20.3935),
        ("offset", physics[3], -3.1648),
    ] {
        assert!((found / published - 1.0).abs() < 0.03, "{name}: {found} for {published}");
    }
}

#[test]
fn the_plain_model_from_force_to_position_is_refused() {
    let Some((force, position)) = recorded() else { return };
    let sriv = Sriv::<2, 1, 3>::new([0]).unwrap();
    let inputs = [(&*force, Hold::First)];
    let problem = Problem { interval_s: INTERVAL_S, output: &position, inputs, equilibrium: None };
    let found = sriv.identify(&problem, &mut Workspace::default()).unwrap();
    assert_eq!(found.termination, Termination::Converged);
    let sound = found.sound(98.0);
    assert!(matches!(sound, Err(Rejection::Unstable { .. })), "an unstable model was accepted: {found:?}");

    // The whole record, both directions, as one throw.
    let millimetres = position.iter().map(|x| 1000.0 * x).collect();
    let throw = Throw::recorded(Trace::new(1000.0, force, millimetres).unwrap());
    let refused = Identifier::default().identify(&throw, &Settings::default()).outcome.unwrap_err();
    assert!(matches!(refused, Rejection::MovedBackwards { .. }), "{refused}");
}
