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
use pointsd::{
    diagnose::{AlarmEvent, Cause, MachineMonitor, Observation, SensorChannel, Settings, Verdict},
    estimate::Features,
    throw::{Direction, ThrowRef},
};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The coefficients of the nominal machine.
pub(crate) const NOMINAL: [f64; 3] = [203.0, 5.9, 1.56];

/// Scatter of a machine.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Nature {
    /// Relative standard deviation of the machine's natural scatter of b0, a1, a0.
    pub(crate) scatter: [f64; 3],
    /// Serial correlation of the natural scatter between consecutive throws.
    pub(crate) phi: f64,
    /// Relative standard deviation of the estimator's error of b0, a1, a0.
    pub(crate) sensor: [f64; 3],
}

impl Default for Nature {
    fn default() -> Self {
        Self { scatter: [0.005, 0.03, 0.01], phi: 0.5, sensor: [0.0053, 0.0060, 0.0052] }
    }
}

impl Nature {
    /// Covariance of the logarithms that the estimator reports; the correlations are the measured ones.
    pub(crate) fn covariance(&self) -> Matrix3<f64> {
        let r = Matrix3::new(1.0, 0.97, 0.91, 0.97, 1.0, 0.79, 0.91, 0.79, 1.0);
        let s = Vector3::from(self.sensor);
        r.component_mul(&(s * s.transpose())) + Matrix3::from_diagonal(&s.map(|v| 1e-6 * v * v))
    }
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
    nature: Nature,
    state: Vector3<f64>,
    root: Matrix3<f64>,
    started_at: Timestamp,
}

impl Machine {
    pub(crate) fn new(seed: u64, nature: Nature) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let state = Vector3::from_fn(|i, _| nature.scatter[i] * normal(&mut rng));
        let root = nature.covariance().cholesky().unwrap().l();
        let started_at = "2026-01-01T00:00:00Z".parse().unwrap();
        let (monitor, settings) = (MachineMonitor::new("21B"), Settings::default());
        Self { monitor, settings, rng, throws: 0, only: None, nature, state, root, started_at }
    }

    /// A machine whose monitor has learned its full baseline.
    pub(crate) fn learned(seed: u64, nature: Nature) -> Self {
        Self::learned_with(seed, nature, Settings::default())
    }

    /// [`Self::learned`] with other settings.
    pub(crate) fn learned_with(seed: u64, nature: Nature, settings: Settings) -> Self {
        let mut machine = Self::new(seed, nature);
        machine.settings = settings;
        machine.events(2 * machine.settings.baseline_throws, Vector3::zeros());
        machine
    }

    /// The next throw, with `shift` added to the logarithms of b0, a1, a0.
    pub(crate) fn throw(&mut self, shift: Vector3<f64>) -> Observation {
        let Nature { scatter, phi, .. } = self.nature;
        let fresh = (1.0 - phi * phi).sqrt();
        self.state = Vector3::from_fn(|i, _| phi * self.state[i] + fresh * scatter[i] * normal(&mut self.rng));
        let error = self.root * Vector3::from_fn(|_, _| normal(&mut self.rng));
        let log = Vector3::from(NOMINAL.map(f64::ln)) + self.state + error + shift;
        let estimate = log.map(f64::exp);
        let scale = Matrix3::from_diagonal(&estimate);
        self.throws += 1;
        self.started_at += SignedDuration::from_mins(30);
        let turn = Direction::BOTH[usize::from(self.throws.is_multiple_of(2))];
        let throw = ThrowRef { boot_id: "7f0e6c1a".to_owned(), throw_no: self.throws };
        Observation {
            direction: Some(self.only.unwrap_or(turn)),
            estimate: Some((estimate.into(), scale * self.nature.covariance() * scale)),
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
