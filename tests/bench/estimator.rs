//! Time of the estimator, and of another implementation of the same method: the crate `dsmc`.

use std::hint::black_box;

use criterion::Criterion;
use dsmc::system_identification::iv::srivc::{Initialization, InterSample, SrivcOptions, identify};
use pointsd::estimate::{
    Hold, Identifier, Noise, Settings,
    sriv::{Problem, Sriv, Workspace},
};
use pointsd::simulate::{Conditions, Parameters, Sensors};
use pointsd::throw::{Direction, Throw, Trace};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

const SAMPLES: usize = 4000;
const INTERVAL_S: f64 = 1e-3;

/// One simulated throw of the default machine at 1 kHz, 4,000 samples from 20 ms before the motor's start.
fn trace() -> Trace {
    let (machine, direction) = (Parameters::default(), Direction::NormalToReverse);
    let sensors = Sensors { before_s: 0.02, ..Sensors::default() };
    let motion = machine.simulate(direction, &Conditions::default(), sensors.step_s()).expect("a sound throw");
    sensors.record(&motion, direction, &mut ChaCha8Rng::seed_from_u64(1)).expect("a sound throw").trace
}

/// Times SRIV with its covariance, and `dsmc`, which computes no covariance. Both have the same start and tolerance.
pub(crate) fn estimation(criterion: &mut Criterion) {
    let trace = trace();
    let input = &trace.current_a()[..SAMPLES];
    let start_mm = trace.position_mm()[0];
    let output: Vec<f64> =
        trace.position_mm()[..SAMPLES].iter().map(|x| (x - start_mm) * std::f64::consts::TAU / 10.0).collect();
    let mut group = criterion.benchmark_group("one throw of 4000 samples");

    let sriv = Sriv::<2, 1, 3>::new([0]).expect("a sound throw");
    let mut workspace = Workspace::default();
    let noise = Noise { output: 1.6e-4, inputs: [4e-4], scale: None, offsets: [2e-5, 8e-6] };
    group.bench_function("sriv with its covariance", |bencher| {
        bencher.iter(|| {
            let inputs = [(black_box(input), Hold::First)];
            let problem = Problem { interval_s: INTERVAL_S, output: black_box(&output), inputs, equilibrium: None };
            let solution = sriv.identify(&problem, &mut workspace).expect("a sound throw");
            sriv.covariance(&problem, &solution, &noise, &workspace)
        });
    });

    let options = SrivcOptions {
        input_intersample: InterSample::FirstOrderHold,
        tolerance: sriv.tolerance,
        max_iterations: sriv.max_iterations,
        ..SrivcOptions::default()
    };
    let start = Initialization::StateVariableFilter(5.0);
    group.bench_function("dsmc srivc, no covariance", |bencher| {
        bencher.iter(|| {
            identify(black_box(input), black_box(&output), INTERVAL_S, 2, 0, &start, &options).expect("a sound throw")
        });
    });

    let throw = Throw::recorded(trace);
    let (mut identifier, settings) = (Identifier::default(), Settings::default());
    group.bench_function("the whole way from trace to estimate", |bencher| {
        bencher.iter(|| identifier.identify(black_box(&throw), &settings));
    });
    group.finish();
}
