//! Throws without scatter, covariances at the ends of their range, constant temperatures: a monitor judges all of them
//! with finite numbers. A panic would leave the throws of the machine without a diagnosis.

use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix3, Vector3};
use pointsd::{
    diagnose::{Estimated, MachineMonitor, Observation, Settings},
    estimate::{Features, Grade, Rejection},
    throw::{Channel, Direction, ThrowRef},
};
use rand::{RngExt, SeedableRng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

use crate::fleet::{NOMINAL, estimator_covariance, in_parallel, normal};

const LIVES: u64 = 400;
const THROWS: u64 = 400;

/// Shares of throws that are rough, have ratios only, have a current only, or are rejected.
struct Shares {
    rough: f64,
    ratios_only: f64,
    current_only: f64,
    rejected: f64,
}

/// A machine whose measured values may have no scatter at all.
struct Degenerate {
    rng: ChaCha8Rng,
    /// Relative standard deviation of coefficients and features.
    scatter: f64,
    /// Factor on the stated standard deviations.
    stated: f64,
    shares: Shares,
    /// Temperature \[°C\], and its standard deviation; `None` if not published.
    temperature_c: Option<(f64, f64)>,
    supply_v: Option<f64>,
    /// Logarithmic change of one coefficient from a throw on.
    step: (u64, usize, f64),
    is_one_way: bool,
    has_same_time: bool,
}

impl Degenerate {
    fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut pick = |of: &[f64]| *of.choose(&mut rng).unwrap();
        let scatter = pick(&[0.0, 0.0, 1e-9, 0.01]);
        let stated = pick(&[1.0, 1.0, 1e-8, 100.0]);
        let mut share = || pick(&[0.0, 0.0, 0.1, 0.5, 1.0]);
        let shares = Shares { rough: share(), ratios_only: share(), current_only: share(), rejected: share() };
        let temperature = pick(&[-40.0, 0.0, 20.0, f64::NAN]);
        let temperature_c = (!temperature.is_nan()).then(|| (temperature, pick(&[0.0, 0.0, 5.0])));
        let supply_v = Some(pick(&[0.0, 1e-6, 110.0, f64::NAN])).filter(|v| !v.is_nan());
        let size = pick(&[-1.0, 0.0, 0.3, 5.0]);
        let step = (rng.random_range(0..THROWS), rng.random_range(0..3), size);
        let (is_one_way, has_same_time) = (rng.random_bool(0.2), rng.random_bool(0.2));
        Self { rng, scatter, stated, shares, temperature_c, supply_v, step, is_one_way, has_same_time }
    }

    fn throw(&mut self, throw_no: u64) -> Observation {
        let start: Timestamp = "2026-01-01T00:00:00Z".parse().unwrap();
        let after = if self.has_same_time { 0 } else { 30 * throw_no.cast_signed() };
        let throw = ThrowRef { boot_id: "7f0e6c1a".to_owned(), throw_no };
        let mut value = |centre: f64| centre * (1.0 + self.scatter * normal(&mut self.rng));
        let mut coefficients = NOMINAL.map(&mut value);
        let features = Features {
            duration_s: Some(value(4.3)),
            release_s: Some(value(0.03)),
            start_delay_s: Some(value(0.001)),
            start_gain: Some(value(200.0)),
            peak_current_a: Some(value(12.0)),
            running_current_a: Some(value(3.0)),
            mean_current_a: Some(value(3.5)),
            end_rise_a: Some(value(0.2)),
            run_on_s: Some(value(0.04)),
            charge_as: Some(value(15.0)),
            energy_j: self.supply_v.map(|v| value(15.0) * v),
            quiet_current_a: Some(value(0.01)),
            travel_mm: Some(value(115.0)),
            start_position_mm: Some(value(0.1)),
            end_position_mm: Some(value(115.1)),
            supply_v: self.supply_v,
            resistance_ohm: self.supply_v.map(|_| value(2.0)),
            back_emf_v_s_per_rad: self.supply_v.map(|_| value(0.5)),
            no_load_speed_rad_per_s: Some(value(180.0)),
            driven_s: None,
            driven_as: None,
        };
        let (from, which, size) = self.step;
        if throw_no >= from {
            coefficients[which] *= f64::exp(size);
        }
        let mut is = |share: f64| self.rng.random_bool(share);
        let (is_rough, ratios_only) = (is(self.shares.rough), is(self.shares.ratios_only));
        let (is_current_only, is_rejected) = (is(self.shares.current_only), is(self.shares.rejected));
        if ratios_only {
            coefficients = coefficients.map(|own| own / coefficients[0]);
        }
        let scale = Matrix3::from_diagonal(&Vector3::from(coefficients)) * self.stated;
        let unknown = if ratios_only { Matrix3::repeat(0.01) } else { Matrix3::zeros() };
        let covariance = scale * (estimator_covariance() + unknown) * scale;
        let estimate = Estimated::new(coefficients, covariance);
        let (grade, rejection) = match (is_current_only, is_rough) {
            (true, _) => (Grade::CurrentOnly, Rejection::NoMovement),
            (_, true) => {
                (Grade::Rough, Rejection::Noisy { channel: Channel::Position, measured: 2.0, expected: Some(0.02) })
            }
            _ => (Grade::Good, Rejection::PoorFit { fit_pct: 80.0, floor_pct: 99.0 }),
        };
        let turn = Direction::BOTH[usize::from(throw_no.is_multiple_of(2) && !self.is_one_way)];
        Observation {
            direction: Some(turn),
            outcome: Some(if is_rejected { Err(rejection) } else { Ok(Estimated { grade, ratios_only, ..estimate }) }),
            features,
            temperature_c: self.temperature_c.map(|(mean, sd)| mean + sd * normal(&mut self.rng)),
            ..Observation::without_trace(throw, start + SignedDuration::from_mins(after))
        }
    }
}

#[test]
fn throws_without_scatter_are_judged_with_finite_numbers() {
    let settings = Settings::default();
    let events = in_parallel(LIVES, |seed| {
        let mut machine = Degenerate::new(seed);
        let mut monitor = MachineMonitor::new("21B");
        let mut events = 0;
        for throw_no in 1..=THROWS {
            let observation = machine.throw(throw_no);
            let verdict = monitor.observe(&observation, &settings);
            events += verdict.events.len();
            for event in &verdict.events {
                let mut sizes = [event.change_pct, event.change_pct_sd].into_iter().flatten();
                assert!(sizes.all(f64::is_finite), "life {seed}, throw {throw_no}: {event:?}");
            }
            if throw_no % 50 == 0 {
                // JSON cannot hold a number that is not finite: the daemon could not read such a snapshot.
                let snapshot = serde_json::to_string(&monitor).unwrap();
                let again = MachineMonitor::from_snapshot(&snapshot)
                    .unwrap_or_else(|error| panic!("life {seed}: {error} {snapshot}"));
                assert_eq!(serde_json::to_string(&again).unwrap(), snapshot, "life {seed}, throw {throw_no}");
                assert!(again == monitor, "life {seed}, throw {throw_no}: {snapshot} {again:?} {monitor:?}");
            }
        }
        events
    });
    assert!(events.iter().sum::<usize>() > 0, "no life had an event: the test cannot fail");
}
