//! The prefilter that matches the noise: half the scatter, no bias, and a true covariance.

use pointsd::estimate::{
    Hold, Identifier, Noise, Settings,
    sriv::{Problem, Sriv, Workspace},
};
use pointsd::simulate::{Conditions, Parameters, Sensors};
use pointsd::throw::{Direction, Throw};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use super::identify::{settings_of, without_dry_friction};
use super::sriv::second_order;

const THROWS: u64 = 300;

#[test]
fn refined_estimates_scatter_half_as_much_without_bias_as_their_covariance_states() {
    let machine = without_dry_friction();
    let known = machine.coefficients().unwrap();
    let known = [known.b0, known.a1, known.a0];
    let plain = settings_of(&machine);
    let refined = Settings { refined: true, ..plain.clone() };
    let sensors = Sensors { before_s: 0.5, ..Sensors::default() };
    let mut identifier = Identifier::default();
    let (mut squares, mut sums, mut covered) = ([[0.0; 3]; 2], [[0.0; 3]; 2], [0_u32; 3]);
    let mut of_ratio = [0.0; 2];
    for direction in Direction::BOTH {
        let motion = machine.simulate(direction, &Conditions::default(), sensors.step_s()).unwrap();
        for seed in 0..THROWS {
            let trace = sensors.record(&motion, direction, &mut ChaCha8Rng::seed_from_u64(seed)).unwrap().trace;
            let throw = Throw::recorded(trace);
            for (which, settings) in [&plain, &refined].into_iter().enumerate() {
                let found = identifier.identify(&throw, settings).outcome.unwrap();
                of_ratio[which] += found.ratios_sd()[0] / found.ratios()[0];
                for (i, value) in [found.b0, found.a1, found.a0].into_iter().enumerate() {
                    let error = value / known[i] - 1.0;
                    sums[which][i] += error;
                    squares[which][i] += error * error;
                    let sd = found.covariance[(i, i)].sqrt() / known[i];
                    covered[i] += u32::from(which == 1 && error.abs() < 1.959_964 * sd);
                }
            }
        }
    }
    let throws = 2.0 * THROWS as f64;
    // Most of the interval of a ratio covers dry friction, which the prefilter does not change.
    assert!(of_ratio[1] < 1.5 * of_ratio[0], "sd of a1/b0: {:?} %", of_ratio.map(|sum| 100.0 * sum / throws));
    for (i, name) in ["b0", "a1", "a0"].into_iter().enumerate() {
        let [plain, refined] = [0, 1].map(|which| {
            let mean: f64 = sums[which][i] / throws;
            (mean, (squares[which][i] / throws - mean * mean).sqrt())
        });
        println!(
            "{name}: scatter {:.3} % and {:.3} %, bias {:.3} %",
            100.0 * plain.1,
            100.0 * refined.1,
            100.0 * refined.0
        );
        assert!(refined.1 < 0.7 * plain.1, "{name}: {refined:?}, plain {plain:?}");
        assert!(refined.0.abs() < 1e-3, "{name}: bias {}", refined.0);
        let pct = 100.0 * f64::from(covered[i]) / throws;
        assert!((92.0..=98.5).contains(&pct), "{name}: {pct} % covered");
    }
}

#[test]
fn a_trace_without_noise_of_the_current_is_not_refined() {
    let (input, output) = second_order(203.0, 5.9, 1.56, 4000, 1e-3, 0.012, 7);
    let sriv = Sriv::<2, 1, 3>::new([0]).unwrap();
    let inputs = [(&*input, Hold::First)];
    let problem = Problem { interval_s: 1e-3, output: &output, inputs, equilibrium: None };
    let mut workspace = Workspace::default();
    let plain = sriv.identify(&problem, &mut workspace).unwrap();
    for (current_a, is_refined) in [(0.0, false), (0.02, true)] {
        let noise =
            Noise { output: 0.012_f64.powi(2), inputs: [current_a * current_a], scale: None, offsets: [0.0; 2] };
        let refined = sriv.refine(&problem, &plain, &noise, &mut workspace).unwrap();
        assert_eq!(refined.is_some(), is_refined, "{current_a} A");
    }
}

#[test]
fn dry_friction_biases_refined_estimates_no_more_than_plain_ones() {
    let machine = Parameters::default();
    let mut identifier = Identifier::default();
    let settings = Settings { refined: true, ..settings_of(&machine) };
    let motion = machine.simulate(Direction::NormalToReverse, &Conditions::default(), 2e-4).unwrap();
    let known = machine.coefficients().unwrap();
    let mean = (0..40).map(|seed| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let trace = Sensors::default().record(&motion, Direction::NormalToReverse, &mut rng).unwrap().trace;
        identifier.identify(&Throw::recorded(trace), &settings).outcome.unwrap().b0 / known.b0 - 1.0
    });
    let mean = mean.sum::<f64>() / 40.0;
    assert!(mean.abs() < 0.006, "{mean}");
}
