//! The simulated machine: time of one throw, and the errors that the time step of the simulation makes.

use criterion::Criterion;
use pointsd::simulate::{Conditions, Motion, Parameters, STEP_S, Sensors};
use pointsd::throw::Direction;
use rand::SeedableRng;

/// Times a 5 s throw with 5 modes and prints its largest errors against a step 64 times as fine.
pub(crate) fn simulator(criterion: &mut Criterion) {
    // A longer stroke for a 5 s throw; friction at every chair, so that every part of the model works.
    let mut machine = Parameters { stroke_mm: 132.0, ..Parameters::default() };
    machine.rails.slide_friction = 0.05;
    let direction = Direction::NormalToReverse;
    let conditions = Conditions::default();
    let throw = |step_s: f64| machine.simulate(direction, &conditions, step_s).expect("a valid machine");

    let (coarse, fine) = (throw(STEP_S), throw(STEP_S / 64.0));
    let (current_a, toe_mm) = largest_errors(&coarse, &fine, 64);
    println!(
        "simulator: {:.2} s on, {} modes, step {} ms; against a step of {:.1} us the largest errors are {:.5} A and {:.2} um",
        coarse.cut_off as f64 * STEP_S,
        machine.rails.modes,
        STEP_S * 1e3,
        STEP_S / 64.0 * 1e6,
        current_a,
        toe_mm * 1e3
    );
    criterion.bench_function("simulate one throw, 5 s, 5 modes", |bench| bench.iter(|| throw(STEP_S)));

    let sensors = Sensors::default();
    let mut rng = rand_chacha::ChaCha12Rng::seed_from_u64(1);
    criterion.bench_function("record one throw at 1 kHz with noise", |bench| {
        bench.iter(|| sensors.record(&coarse, direction, &mut rng).expect("valid sensors"));
    });
}

/// Largest differences of current and position while the motor is on, on the coarse grid.
fn largest_errors(coarse: &Motion, fine: &Motion, ratio: usize) -> (f64, f64) {
    let on = coarse.cut_off.min(fine.cut_off / ratio);
    let largest = |a: &[f64], b: &[f64]| (0..on).map(|at| (a[at] - b[at * ratio]).abs()).fold(0.0, f64::max);
    (largest(&coarse.current_a, &fine.current_a), largest(&coarse.toe_mm, &fine.toe_mm))
}
