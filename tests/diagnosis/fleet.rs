//! Machines at parameter depth: coefficients from a calibrated scatter, with the correlated errors of the estimator.

use std::{
    num::NonZero,
    sync::{
        Mutex,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    thread,
};

use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix3, Vector3};
pub(crate) use pointsd::evaluate::Scatter;
use pointsd::{
    diagnose::{AlarmEvent, Cause, Estimated, MachineMonitor, Observation, SensorChannel, Settings, Verdict},
    estimate::Features,
    throw::{Direction, ThrowRef},
};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The coefficients of the nominal machine.
pub(crate) const NOMINAL: [f64; 3] = [203.0, 5.9, 1.56];

/// Covariance of the logarithms of b0, a1, a0 that the estimator reports; the correlations are the measured ones.
pub(crate) fn estimator_covariance() -> Matrix3<f64> {
    let r = Matrix3::new(1.0, 0.97, 0.91, 0.97, 1.0, 0.79, 0.91, 0.79, 1.0);
    let s = Vector3::new(0.0053, 0.0060, 0.0052);
    r.component_mul(&(s * s.transpose())) + Matrix3::from_diagonal(&s.map(|v| 1e-6 * v * v))
}

/// Standard normal number (Box and Muller).
pub(crate) fn normal(rng: &mut impl Rng) -> f64 {
    let (a, b): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

/// Cause of each event.
pub(crate) fn causes<'a>(events: impl IntoIterator<Item = &'a AlarmEvent>) -> Vec<Cause> {
    events.into_iter().map(|event| event.cause).collect()
}

/// Cause and channel of each event.
pub(crate) fn channels(events: &[AlarmEvent]) -> Vec<(Cause, Option<SensorChannel>)> {
    events.iter().map(|event| (event.cause, event.channel)).collect()
}

/// Results of lives with the seeds from 0 on, on all processors; in any order.
pub(crate) fn in_parallel<T: Send>(lives: u64, live: impl Fn(u64) -> T + Sync) -> Vec<T> {
    let (next, results) = (AtomicU64::new(0), Mutex::new(Vec::new()));
    let work = || {
        loop {
            let seed = next.fetch_add(1, Relaxed);
            if seed >= lives {
                return;
            }
            let result = live(seed);
            results.lock().unwrap().push(result);
        }
    };
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, NonZero::get) {
            scope.spawn(work);
        }
    });
    results.into_inner().unwrap()
}

/// A machine that throws in alternating directions, with its monitor.
pub(crate) struct Machine {
    pub(crate) monitor: MachineMonitor,
    pub(crate) settings: Settings,
    pub(crate) rng: ChaCha8Rng,
    pub(crate) throws: u64,
    /// The only direction of the throws; `None`: both in turn.
    pub(crate) only: Option<Direction>,
    /// Time between two throws.
    pub(crate) interval: SignedDuration,
    scatter: Scatter,
    state: Vector3<f64>,
    /// Logarithms of b0, a1, a0 in each direction, without scatter.
    centre: [Vector3<f64>; 2],
    root: Matrix3<f64>,
    started_at: Timestamp,
}

impl Machine {
    /// The nominal machine.
    pub(crate) fn new(seed: u64, scatter: Scatter) -> Self {
        let centre = [Vector3::from(NOMINAL.map(f64::ln)); 2];
        Self::with(ChaCha8Rng::seed_from_u64(seed), centre, scatter)
    }

    /// A machine in the field, which differs from all others and in its directions, with a throw every 72 minutes. Its
    /// scatter may have heavy tails and strong serial correlation, which the diagnosis does not assume.
    pub(crate) fn in_field(seed: u64, scatter: Scatter) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(0xf1e1d ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let usual = Vector3::new(150.0_f64, 8.0, 2.5).map(f64::ln);
        let centre = [(); 2].map(|()| usual + Vector3::from_fn(|_, _| 0.1 * normal(&mut rng)));
        Self { interval: SignedDuration::from_mins(72), ..Self::with(rng, centre, scatter) }
    }

    fn with(mut rng: ChaCha8Rng, centre: [Vector3<f64>; 2], scatter: Scatter) -> Self {
        let state = Vector3::from_fn(|i, _| scatter.sd[i] * normal(&mut rng));
        let root = estimator_covariance().cholesky().unwrap().l();
        let started_at = "2026-01-01T00:00:00Z".parse().unwrap();
        let (monitor, settings) = (MachineMonitor::new("21B"), Settings::default());
        let interval = SignedDuration::from_mins(30);
        Self { monitor, settings, rng, throws: 0, only: None, interval, scatter, state, centre, root, started_at }
    }

    /// [`Self::in_field`] after this number of healthy throws.
    pub(crate) fn after(throws: usize, seed: u64, scatter: Scatter) -> Self {
        let mut machine = Self::in_field(seed, scatter);
        machine.events(throws, Vector3::zeros());
        machine
    }

    /// A machine whose monitor has learned its full baseline.
    pub(crate) fn learned(seed: u64, scatter: Scatter) -> Self {
        Self::learned_with(seed, scatter, Settings::default())
    }

    /// [`Self::learned`] with other settings.
    pub(crate) fn learned_with(seed: u64, scatter: Scatter, settings: Settings) -> Self {
        let mut machine = Self::new(seed, scatter);
        machine.settings = settings;
        machine.events(2 * machine.settings.baseline_throws, Vector3::zeros());
        machine
    }

    /// The direction of the next throw: 0 or 1.
    pub(crate) fn side(&self) -> usize {
        usize::from(self.throws % 2 == 1)
    }

    /// The next throw, an interval later, with `shift` added to the logarithms of b0, a1, a0.
    pub(crate) fn throw(&mut self, shift: Vector3<f64>) -> Observation {
        self.state = self.scatter.next(self.state, || normal(&mut self.rng));
        let error = self.root * Vector3::from_fn(|_, _| normal(&mut self.rng));
        let side = self.side();
        let estimate = (self.centre[side] + self.state + error + shift).map(f64::exp);
        let scale = Matrix3::from_diagonal(&estimate);
        self.throws += 1;
        self.started_at += self.interval;
        let throw = ThrowRef { boot_id: "7f0e6c1a".to_owned(), throw_no: self.throws };
        Observation {
            direction: Some(self.only.unwrap_or(Direction::BOTH[side])),
            outcome: Some(Ok(Estimated::new(estimate.into(), scale * estimator_covariance() * scale))),
            features: Features { duration_s: Some(4.3 * (1.0 + 0.004 * normal(&mut self.rng))), ..Features::default() },
            ..Observation::without_trace(throw, self.started_at)
        }
    }

    /// Gives a throw to the monitor.
    pub(crate) fn observe(&mut self, throw: &Observation) -> Verdict {
        self.monitor.observe(throw, &self.settings)
    }

    /// Gives the next throw to the monitor.
    pub(crate) fn feed(&mut self, shift: Vector3<f64>) -> Verdict {
        let throw = self.throw(shift);
        self.observe(&throw)
    }

    /// Gives the next throw, at a temperature, to the monitor.
    pub(crate) fn feed_at(&mut self, shift: Vector3<f64>, celsius: f64) -> Verdict {
        let throw = Observation { temperature_c: Some(celsius), ..self.throw(shift) };
        self.observe(&throw)
    }

    /// The events of the next throws.
    pub(crate) fn events(&mut self, throws: usize, shift: Vector3<f64>) -> Vec<AlarmEvent> {
        (0..throws).flat_map(|_| self.feed(shift).events).collect()
    }

    /// Gives healthy throws to the monitor; none may have an event.
    #[track_caller]
    pub(crate) fn stay_healthy(&mut self, throws: usize) {
        assert_eq!(self.events(throws, Vector3::zeros()), []);
    }

    /// A random number below `limit` from the stream of this machine.
    pub(crate) fn rng_u(&mut self, limit: u64) -> u64 {
        self.rng.random_range(0..limit)
    }
}

/// Whether each 95 % interval of the size of `cause` contains the true size, from the thirteenth throw after its change
/// on.
pub(crate) fn sizes_held(cause: Cause, truth_pct: f64, verdicts: impl Iterator<Item = Verdict>) -> Vec<bool> {
    let named = |verdict: Verdict| verdict.present.drifts.into_iter().find(|drift| drift.cause == cause);
    verdicts
        .skip(12)
        .filter_map(named)
        .map(|drift| (drift.change_pct - truth_pct).abs() <= 1.96 * drift.change_pct_sd)
        .collect()
}

/// Checks that nine of ten intervals held, in at least `least` throws.
#[track_caller]
pub(crate) fn assert_nine_of_ten(held: &[bool], least: usize, what: &str) {
    let inside = held.iter().filter(|held| **held).count();
    assert!(held.len() >= least, "{what}: named in {} throws", held.len());
    assert!(10 * inside >= 9 * held.len(), "{what}: {inside} of {}", held.len());
}

/// Shift of the logarithms of b0, a1, a0 when the part behind `cause` changes by `pct` percent.
pub(crate) fn shift(cause: Cause, pct: f64) -> Vector3<f64> {
    let log = (pct / 100.0).ln_1p();
    match cause {
        Cause::Kt => Vector3::new(log, 0.0, 0.0),
        Cause::Friction => Vector3::new(0.0, log, 0.0),
        Cause::Stiffness => Vector3::new(0.0, 0.0, log),
        Cause::Inertia => Vector3::repeat(-log),
        _ => Vector3::zeros(),
    }
}
