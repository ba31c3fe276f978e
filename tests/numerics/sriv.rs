//! SRIV against independent results: another implementation, and a benchmark of the literature.

use std::array;

use dsmc::system_identification::iv::srivc::{Initialization, InterSample, SrivcOptions, identify as peer};
use nalgebra::{Matrix4, SMatrix, SVector, Vector4};
use pointsd::estimate::{
    Hold,
    sriv::{Failure, Problem, Solution, Sriv, Termination, Workspace},
};
use rand::{Rng, RngExt};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::StandardNormal;

fn normal(rng: &mut impl Rng) -> f64 {
    rng.sample(StandardNormal)
}

/// y and u of b0 / (s² + a1 s + a0) under a random step sequence, linear between the samples, with noise on y.
pub(crate) fn second_order(
    b0: f64,
    a1: f64,
    a0: f64,
    len: usize,
    h: f64,
    noise: f64,
    seed: u64,
) -> (Vec<f64>, Vec<f64>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut level = 0.0;
    let input: Vec<f64> = (0..len)
        .map(|k| {
            if k % 37 == 5 {
                level = normal(&mut rng);
            }
            level
        })
        .collect();
    // Runge-Kutta with 20 steps in each interval, independent of the estimator's matrix exponential.
    let (mut state, mut output) = ([0.0, 0.0], Vec::with_capacity(len));
    let slope = |state: [f64; 2], u: f64| [state[1], b0 * u - a1 * state[1] - a0 * state[0]];
    let along = |s: [f64; 2], d: [f64; 2], h: f64| [s[0] + h * d[0], s[1] + h * d[1]];
    for k in 0..len {
        output.push(state[0] + noise * normal(&mut rng));
        let next = input[(k + 1).min(len - 1)];
        for part in 0..20 {
            let (dt, at) = (h / 20.0, |share: f64| input[k] + (next - input[k]) * (f64::from(part) + share) / 20.0);
            let k1 = slope(state, at(0.0));
            let k2 = slope(along(state, k1, dt / 2.0), at(0.5));
            let k3 = slope(along(state, k2, dt / 2.0), at(0.5));
            let k4 = slope(along(state, k3, dt), at(1.0));
            state = array::from_fn(|i| state[i] + dt / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
        }
    }
    (input, output)
}

/// Largest relative difference between our parameters and those of the peer, the crate `dsmc`.
fn compare<const N: usize, const P: usize>(u: &[f64], y: &[f64], h: f64, hold: Hold, lambda: f64) -> f64 {
    let mut sriv = Sriv::<N, 1, P>::new([P - N - 1]).unwrap();
    (sriv.start_per_s, sriv.tolerance) = (lambda, 1e-10);
    let problem = Problem { interval_s: h, output: y, inputs: [(u, hold)], equilibrium: None };
    let ours = sriv.identify(&problem, &mut Workspace::default()).unwrap();
    let options = SrivcOptions {
        input_intersample: match hold {
            Hold::First => InterSample::FirstOrderHold,
            Hold::Zero => InterSample::ZeroOrderHold,
        },
        max_iterations: 50,
        tolerance: 1e-10,
        ..SrivcOptions::default()
    };
    let theirs = peer(u, y, h, N, P - N - 1, &Initialization::StateVariableFilter(lambda), &options).unwrap();
    assert!(theirs.converged && ours.termination == Termination::Converged);
    // The peer has `a_1` … `a_N`, then the numerator.
    let in_order_of_peer: Vec<f64> =
        ours.parameters[P - N..].iter().chain(&ours.parameters[..P - N]).copied().collect();
    in_order_of_peer.iter().zip(theirs.parameter.iter()).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max)
}

#[test]
fn agrees_with_an_independent_implementation_to_1e_6() {
    for (seed, hold) in [(1, Hold::First), (2, Hold::Zero), (3, Hold::First)] {
        let (u, y) = second_order(203.0, 5.9, 1.56, 4000, 1e-3, 0.05, seed);
        let difference = compare::<2, 3>(&u, &y, 1e-3, hold, 5.0);
        assert!(difference < 1e-6, "order 2, {hold:?}: {difference:e}");
    }
    let (u, y) = second_order(40.0, 3.0, 25.0, 3000, 5e-3, 0.01, 4);
    let difference = compare::<2, 4>(&u, &y, 5e-3, Hold::First, 5.0);
    assert!(difference < 1e-6, "order 2 with a zero: {difference:e}");
    let benchmark = RaoGarnier::new();
    for seed in 0..3 {
        let y = benchmark.noisy(seed);
        let difference = compare::<4, 6>(&benchmark.input, &y, 0.01, Hold::Zero, 20.0);
        assert!(difference < 1e-6, "order 4, seed {seed}: {difference:e}");
    }
}

/// The result is near that of an iteration to the last digit. With strong noise each step is only about half as long as
/// the step before, so the steps that would follow are together longer than the last one.
#[test]
fn the_iteration_ends_near_its_limit() {
    fn distance<const N: usize, const P: usize>(u: &[f64], y: &[f64], h: f64, lambda: f64, tolerance: f64) -> f64 {
        let [end, limit] = [tolerance, 1e-14].map(|tolerance| {
            let mut sriv = Sriv::<N, 1, P>::new([P - N - 1]).unwrap();
            (sriv.start_per_s, sriv.tolerance) = (lambda, tolerance);
            let inputs = [(u, Hold::Zero)];
            let problem = Problem { interval_s: h, output: y, inputs, equilibrium: None };
            SVector::from(sriv.identify(&problem, &mut Workspace::default()).unwrap().parameters)
        });
        (end - limit).norm() / limit.norm()
    }
    let benchmark = RaoGarnier::new();
    for seed in 0..40 {
        for tolerance in [1e-2, 1e-4, 1e-6] {
            let noise = 0.1 * (seed % 20) as f64;
            let (u, y) = second_order(203.0, 5.9, 1.56, 2000, 2e-3, noise, seed);
            let second = distance::<2, 3>(&u, &y, 2e-3, 5.0, tolerance);
            let fourth = distance::<4, 6>(&benchmark.input, &benchmark.noisy(seed), 0.01, 20.0, tolerance);
            assert!(second.max(fourth) < 2.0 * tolerance, "{seed}, {tolerance}: {second:e}, {fourth:e}");
        }
    }
}

/// G = (-6400 s + 1600) / (s⁴ + 5 s³ + 408 s² + 416 s + 1600) under a ten-stage PRBS, each bit held for 7 samples.
struct RaoGarnier {
    input: Vec<f64>,
    output: Vec<f64>,
}

const TRUTH: [f64; 6] = [-6400.0, 1600.0, 5.0, 408.0, 416.0, 1600.0];

impl RaoGarnier {
    fn new() -> Self {
        let mut register = [true; 10];
        let bits = (0..1023).map(|_| {
            let out = register[9];
            let next = register[9] ^ register[6];
            register.rotate_right(1);
            register[0] = next;
            if out { 1.0 } else { -1.0 }
        });
        let input: Vec<f64> = bits.flat_map(|bit| [bit; 7]).collect();
        // Exact discretisation by nalgebra's matrix exponential of the controller form.
        let mut augmented = SMatrix::<f64, 5, 5>::zeros();
        for i in 0..3 {
            augmented[(i, i + 1)] = 1.0;
        }
        for (j, a) in [-1600.0, -416.0, -408.0, -5.0].into_iter().enumerate() {
            augmented[(3, j)] = a;
        }
        augmented[(3, 4)] = 1.0;
        let exponential = (augmented * 0.01).exp();
        let phi: Matrix4<f64> = exponential.fixed_view::<4, 4>(0, 0).into_owned();
        let gamma: Vector4<f64> = exponential.fixed_view::<4, 1>(0, 4).into_owned();
        let mut state = SVector::<f64, 4>::zeros();
        let output = input
            .iter()
            .map(|u| {
                let y = 1600.0 * state[0] - 6400.0 * state[1];
                state = phi * state + gamma * *u;
                y
            })
            .collect();
        Self { input, output }
    }

    /// The output with white noise; the noise has a tenth of its power.
    fn noisy(&self, seed: u64) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let len = self.output.len() as f64;
        let mean = self.output.iter().sum::<f64>() / len;
        let power = self.output.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / len;
        let sd = (power / 10.0).sqrt();
        self.output.iter().map(|y| y + sd * normal(&mut rng)).collect()
    }

    fn identify(&self, y: &[f64], workspace: &mut Workspace<6>) -> Result<Solution<4, 1, 6>, Failure> {
        let mut sriv = Sriv::<4, 1, 6>::new([1]).unwrap();
        sriv.start_per_s = 20.0;
        let inputs = [(&*self.input, Hold::Zero)];
        sriv.identify(&Problem { interval_s: 0.01, output: y, inputs, equilibrium: None }, workspace)
    }
}

#[test]
fn the_benchmark_of_the_literature_gives_the_published_results() {
    const RUNS: usize = 200;
    let published_sd = [42.4, 73.5, 0.062, 1.10, 3.9, 8.0];
    let benchmark = RaoGarnier::new();
    let mut workspace = Workspace::default();
    let (mut sum, mut squares) = ([0.0; 6], [0.0; 6]);
    for seed in 0..RUNS as u64 {
        let found = benchmark.identify(&benchmark.noisy(1000 + seed), &mut workspace).unwrap();
        assert_eq!(found.termination, Termination::Converged, "seed {seed}");
        for i in 0..6 {
            let error = found.parameters[i] - TRUTH[i];
            sum[i] += error;
            squares[i] += error * error;
        }
    }
    for i in 0..6 {
        let runs = RUNS as f64;
        let mean = sum[i] / runs;
        let sd = ((squares[i] - runs * mean * mean) / (runs - 1.0)).sqrt();
        println!("parameter {i}: mean error {mean:.4}, sd {sd:.4}, published sd {}", published_sd[i]);
        assert!(mean.abs() < 3.0 * sd / runs.sqrt(), "parameter {i}: mean error {mean}, sd {sd}");
        assert!((sd / published_sd[i] - 1.0).abs() < 0.15, "parameter {i}: sd {sd}, published {}", published_sd[i]);
    }
}

#[test]
fn a_constant_load_is_identified_as_another_input() {
    // y'' + 3 y' + 25 y = 40 u + 7 from rest: the solution without the load, plus the response to it.
    let (h, len) = (5e-3, 3000);
    let (u, mut y) = second_order(40.0, 3.0, 25.0, len, h, 0.0, 9);
    let (decay, omega): (f64, f64) = (1.5, (25.0_f64 - 2.25).sqrt());
    for (k, y) in y.iter_mut().enumerate() {
        let t = k as f64 * h;
        let (sin, cos) = (omega * t).sin_cos();
        *y += 7.0 / 25.0 * (1.0 - (-decay * t).exp() * (cos + decay / omega * sin));
    }
    let sriv = Sriv::<2, 2, 4>::new([0, 0]).unwrap();
    let ones = vec![1.0; len];
    let inputs = [(&*u, Hold::First), (&*ones, Hold::Zero)];
    let problem = Problem { interval_s: h, output: &y, inputs, equilibrium: None };
    let found = sriv.identify(&problem, &mut Workspace::default()).unwrap();
    for (found, truth) in found.parameters.iter().zip([40.0, 7.0, 3.0, 25.0]) {
        assert!((found / truth - 1.0).abs() < 2e-3, "{found} for {truth}");
    }
}

#[test]
fn data_that_determine_nothing_fail_with_the_reason() {
    let sriv = Sriv::<2, 1, 3>::new([0]).unwrap();
    let flat = vec![0.0; 100];
    let problem = |u, y| Problem { interval_s: 0.01, output: y, inputs: [(u, Hold::First)], equilibrium: None };
    let identify = |u, y| sriv.identify(&problem(u, y), &mut Workspace::default()).map(|s| s.parameters);
    assert_eq!(identify(&flat, &flat), Err(Failure::Singular));
    assert_eq!(identify(&flat[1..], &flat), Err(Failure::UnequalLengths));
    assert_eq!(identify(&flat[..5], &flat[..5]), Err(Failure::TooFewSamples));
    assert_eq!(identify(&flat, &[f64::NAN; 100]), Err(Failure::Singular));
    assert!(
        Sriv::<2, 1, 3>::new([1]).is_none()
            && Sriv::<2, 1, 4>::new([2]).is_none()
            && Sriv::<2, 2, 4>::new([0, 0]).is_some()
    );
}
