//! Short and strange traces that no machine makes: the estimator never panics, and its numbers are finite.

use pointsd::estimate::{Identifier, Motor, Settings};
use pointsd::throw::{Direction, Throw, Trace};
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// A channel at rest that then makes a pulse, a ramp, an inrush or a random walk of this height. It ends there, or
/// returns to exactly its value at rest.
fn channel(rng: &mut ChaCha8Rng, len: usize, height: f64) -> Vec<f64> {
    let rest = [0.0, 0.0, 0.15, 57.5, -3.0][rng.random_range(0..5)];
    let from = if rng.random() { rng.random_range(0..=len) } else { rng.random_range(0..=len.min(20)) };
    let length = rng.random_range(1..=len);
    let (kind, returns) = (rng.random_range(0..4), rng.random::<bool>());
    let mut walk = 0.0;
    (0..len)
        .map(|k| {
            let Some(at) = k.checked_sub(from) else { return rest };
            let share = (at as f64 / length as f64).min(1.0);
            walk += 0.1 * height * rng.random_range(-1.0..1.0);
            let moved = match kind {
                _ if returns && at >= length => 0.0,
                0 => height,
                1 => height * share,
                // The inrush of a motor.
                2 => height * (0.1 + 0.9 * (-20.0 * share).exp()),
                _ => walk,
            };
            rest + moved
        })
        .collect()
}

/// A random throw and random settings: few samples, a motor without movement, a movement without motor, a toe that
/// returns to its start, currents from the first sample on, single wrong values, any rate.
fn strange(seed: u64) -> (Throw, Settings) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let longest = [4, 40, 400, 3000, 3000][rng.random_range(0..5)];
    let len = rng.random_range(1..=longest);
    let rate_hz = [1.0, 25.0, 100.0, 500.0, 1000.0, 1000.0, 2500.0, 20_000.0][rng.random_range(0..8)];
    let mut sizes = |all: [f64; 6]| all[rng.random_range(0..6)];
    let (height_a, height_mm) =
        (sizes([0.0, 1.0, 13.0, -13.0, 1e-3, 300.0]), sizes([0.0, 1.0, 115.0, -115.0, 0.1, 1e3]));
    let (noise_a, noise_mm) = (sizes([0.0, 0.0, 0.02, 0.02, 1.0, 1e-9]), sizes([0.0, 0.0, 0.02, 0.02, 5.0, 1e-9]));
    let mut current = channel(&mut rng, len, height_a);
    let mut position = channel(&mut rng, len, height_mm);
    for k in 0..len {
        current[k] += noise_a * rng.random_range(-1.0..1.0);
        position[k] += noise_mm * rng.random_range(-1.0..1.0);
    }
    if rng.random_range(0..4) == 0 {
        let wrong = [f64::NAN, f64::INFINITY, -1e300, 1e-300, 400.0][rng.random_range(0..5)];
        let spoilt = if rng.random() { &mut current } else { &mut position };
        spoilt[rng.random_range(0..len)] = wrong;
    }
    if rng.random_range(0..8) == 0 {
        position.fill(f64::NAN);
    }
    let throw = Throw {
        direction: [None, Some(Direction::NormalToReverse), Some(Direction::ReverseToNormal)][rng.random_range(0..3)],
        supply_v: [None, Some(110.0), Some(f64::NAN)][rng.random_range(0..3)],
        anti_alias_hz: [None, None, Some(0.4 * rate_hz), Some(-1.0)][rng.random_range(0..4)],
        ..Throw::recorded(Trace::new(rate_hz, current, position).unwrap())
    };
    let settings = Settings {
        stroke_mm: [None, Some(115.0), Some(1.0)][rng.random_range(0..3)],
        neutral_mm: [0.0, 57.5, -1000.0][rng.random_range(0..3)],
        motor: if rng.random() { Motor::PermanentMagnet } else { Motor::Series },
        fit_floor_pct: [0.0, 98.0][rng.random_range(0..2)],
        refined: rng.random(),
        ..Settings::default()
    };
    (throw, settings)
}

/// `POINTSD_STRANGE=1000000` sets the number of traces. A panic names its seed.
#[test]
fn no_strange_trace_stops_the_estimator() {
    let traces = std::env::var("POINTSD_STRANGE").map_or(60_000, |text| text.parse().unwrap());
    let mut identifier = Identifier::default();
    let mut qualities = std::collections::BTreeMap::<String, usize>::new();
    for seed in 0..traces {
        let (throw, settings) = strange(seed);
        let found = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| identifier.identify(&throw, &settings)));
        let Ok(found) = found else { panic!("seed {seed}: {} samples", throw.trace.len()) };
        if let Ok(estimate) = &found.outcome {
            let variances = estimate.total_covariance().diagonal();
            assert!(
                estimate.coefficients().iter().chain(&variances).all(|v| v.is_finite() && *v >= 0.0),
                "seed {seed}"
            );
        }
        *qualities.entry(found.quality().to_owned()).or_default() += 1;
    }
    println!("{qualities:?}");
}

/// The toe moves only after the motor is off, and returns to about its start: the estimator has a window of one sample.
#[test]
fn a_toe_that_returns_to_its_start_moved_backwards() {
    for (quiet, returned_mm) in [(4, 0.0), (4, 0.5), (200, 0.0), (200, -0.5)] {
        let len = quiet + 1200;
        let current = (0..len).map(|k| if (quiet..quiet + 200).contains(&k) { 8.0 } else { 0.0 }).collect();
        let position = (0..len)
            .map(|k| match k {
                _ if k < quiet + 200 => 0.0,
                _ if k < quiet + 700 => 0.04 * f64::from(k - quiet - 200),
                _ => (20.0 - 0.1 * f64::from(k - quiet - 700)).max(returned_mm),
            })
            .collect();
        let throw = Throw::recorded(Trace::new(1000.0, current, position).unwrap());
        for stroke_mm in [None, Some(115.0)] {
            let settings = Settings { stroke_mm, ..Settings::default() };
            let refused = Identifier::default().identify(&throw, &settings).outcome.unwrap_err();
            assert_eq!(refused.code(), "moved_backwards", "{quiet} quiet samples, {returned_mm} mm: {refused}");
            assert!(refused.is_incomplete());
        }
    }
}
