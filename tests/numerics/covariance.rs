//! The stated covariance against the scatter of repeated measurements.

use pointsd::estimate::Identifier;
use pointsd::simulate::{Conditions, Parameters, Sensor, Sensors};
use pointsd::throw::{Direction, Throw};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use super::identify::settings_of;

/// Throws for each combination of noise and direction.
const THROWS: u64 = 334;

#[test]
fn the_95_pct_interval_covers_the_noise_free_estimate_in_93_to_97_pct_of_the_throws() {
    let machine = Parameters::default();
    let settings = settings_of(&machine);
    let mut identifier = Identifier::default();
    let (mut covered, mut throws) = ([0_u32; 3], 0);
    for (current_a, position_mm) in [(0.02, 0.02), (0.05, 0.02), (0.005, 0.2)] {
        let channel = |noise| Sensor { noise, ..Sensor::default() };
        let sensors = Sensors {
            current: channel(current_a),
            position: channel(position_mm),
            before_s: 0.5,
            ..Sensors::default()
        };
        let perfect = Sensors { before_s: 0.5, ..Sensors::perfect(1000.0) };
        for direction in Direction::BOTH {
            let motion = machine.simulate(direction, &Conditions::default(), sensors.step_s()).unwrap();
            let mut rng = ChaCha8Rng::seed_from_u64(throws.into());
            let mut estimate = |sensors: &Sensors| {
                let trace = sensors.record(&motion, direction, &mut rng).unwrap().trace;
                identifier.identify(&Throw::recorded(trace), &settings).outcome.unwrap()
            };
            let truth = estimate(&perfect);
            let mut here = [0_u32; 3];
            for _ in 0..THROWS {
                let found = estimate(&sensors);
                let errors = [found.b0 - truth.b0, found.a1 - truth.a1, found.a0 - truth.a0];
                for i in 0..3 {
                    here[i] += u32::from(errors[i].abs() < 1.959_964 * found.covariance[(i, i)].sqrt());
                }
            }
            println!("{current_a} A, {position_mm} mm, {direction}: {here:?} of {THROWS}");
            throws += u32::try_from(THROWS).unwrap();
            for i in 0..3 {
                covered[i] += here[i];
            }
        }
    }
    for (name, covered) in ["b0", "a1", "a0"].into_iter().zip(covered) {
        let pct = 100.0 * f64::from(covered) / f64::from(throws);
        println!("{name}: {pct:.1} %");
        assert!((93.0..=97.0).contains(&pct), "{name}: {pct:.1} % of {throws}");
    }
}
