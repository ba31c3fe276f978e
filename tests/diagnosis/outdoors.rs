//! Machines out of doors: a generator of rain and temperature with its own machines. Their scatter, its serial correlation,
//! the leak of dry friction and the effect of the temperature differ from machine to machine.

use std::f64::consts::TAU;

use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix3, Vector3};
use pointsd::{
    diagnose::{Common, MachineMonitor, Observation, Settings, Verdict},
    estimate::Features,
    throw::{Direction, ThrowRef},
};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha12Rng;

/// Wetness over the throws of a life: spells with their first throw, number of throws and throws of drying.
#[derive(Debug, Clone, Default)]
pub(crate) struct Rain {
    pub(crate) spells: Vec<(u64, u64)>,
    pub(crate) loss_pct: f64,
    pub(crate) drying: u64,
}

impl Rain {
    /// Change of the logarithm of the friction.
    pub(crate) fn at(&self, throw: u64) -> f64 {
        let of = |(from, throws): &(u64, u64)| -> f64 {
            let Some(since) = throw.checked_sub(*from) else { return 0.0 };
            match since.checked_sub(*throws) {
                None => 1.0,
                Some(dry) => (1.0 - (dry + 1) as f64 / (self.drying + 1) as f64).max(0.0),
            }
        };
        self.spells.iter().map(of).fold(0.0, f64::max) * (1.0 - self.loss_pct / 100.0).ln()
    }
}

/// Temperature over the throws of a life: amplitudes of season and day \[K\], a year and a day \[throws\], and their phases.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Air {
    pub(crate) season_k: f64,
    pub(crate) day_k: f64,
    pub(crate) year: f64,
    pub(crate) day: f64,
    pub(crate) phase: f64,
}

impl Air {
    /// Distance from the mean of the year \[K\].
    pub(crate) fn at(&self, throw: u64) -> f64 {
        let throw = throw as f64;
        self.season_k * (TAU * (throw / self.year + self.phase)).sin()
            + self.day_k * (TAU * (throw / self.day + 0.15)).sin()
    }
}

/// Serial correlation of the slow part of the scatter.
const SLOW_PHI: f64 = 0.9;

/// A machine in service, with its monitor.
pub(crate) struct Outdoors {
    rng: ChaCha12Rng,
    /// Standard deviations of the natural scatter, and its serial correlation.
    pub(crate) sd: Vector3<f64>,
    pub(crate) phi: f64,
    /// The fast and the slow part of the scatter, and the share of the slow part in the variance.
    wander: [Vector3<f64>; 2],
    pub(crate) slow: f64,
    centre: [Vector3<f64>; 2],
    /// Part of a change of friction that changes all three coefficients.
    pub(crate) leak: f64,
    /// Change of the three logarithms per kelvin.
    pub(crate) per_k: Vector3<f64>,
    pub(crate) throws: u64,
    pub(crate) interval: SignedDuration,
    now: Timestamp,
    pub(crate) monitor: MachineMonitor,
}

impl Outdoors {
    pub(crate) fn new(seed: u64) -> Self {
        let mut rng = ChaCha12Rng::seed_from_u64(seed ^ 0x7a17_0000_0000);
        let mut between = |low: f64, high: f64| rng.random_range(low..high);
        let centre = [(); 2].map(|()| Vector3::new(between(4.6, 5.0), between(1.6, 2.2), between(0.5, 1.1)));
        let sd = Vector3::new(between(0.003, 0.006), between(0.02, 0.035), between(0.006, 0.012));
        let phi = between(0.2, 0.7);
        let leak = between(0.0, 0.3);
        let per_k = Vector3::new(between(-0.002, -0.001), between(-0.012, -0.004), between(-0.0015, 0.0));
        let now = "2026-03-01T00:00:00Z".parse().unwrap();
        Self {
            rng,
            sd,
            phi,
            wander: [Vector3::zeros(); 2],
            slow: 0.0,
            centre,
            leak,
            per_k,
            throws: 0,
            interval: SignedDuration::from_mins(70),
            now,
            monitor: MachineMonitor::new("W7"),
        }
    }

    /// A number of unit variance: the sum of twelve even ones.
    pub(crate) fn number(&mut self) -> f64 {
        (0..12).map(|_| self.rng.random::<f64>()).sum::<f64>() - 6.0
    }

    /// Change of the coefficients with this change of the logarithm of the friction. Less friction leaks less.
    pub(crate) fn of_friction(&self, change: f64) -> Vector3<f64> {
        let leak = self.leak * if change < 0.0 { 0.3 } else { 1.0 };
        Vector3::new(leak, 1.0 + leak, leak) * change
    }

    /// The next throw with this change of the logarithms and an optional temperature.
    pub(crate) fn next(&mut self, change: Vector3<f64>, temperature_c: Option<f64>) -> Observation {
        let parts = [(self.phi, 1.0 - self.slow), (SLOW_PHI, self.slow)];
        for (at, (phi, share)) in parts.into_iter().enumerate() {
            let fresh = (share * (1.0 - phi * phi)).sqrt();
            let news = Vector3::from_fn(|i, _| fresh * self.sd[i] * self.number());
            self.wander[at] = phi * self.wander[at] + news;
        }
        let side = usize::from(self.throws % 2 == 1);
        // The errors of an estimate are nearly equal in the three coefficients.
        let error = Vector3::repeat(0.005 * self.number()) + Vector3::from_fn(|_, _| 0.0015 * self.number());
        let estimate: [f64; 3] =
            (self.centre[side] + self.wander[0] + self.wander[1] + error + change).map(f64::exp).into();
        let covariance =
            Matrix3::from_fn(|i, j| estimate[i] * estimate[j] * (2.5e-5 + if i == j { 2.25e-6 } else { 0.0 }));
        self.throws += 1;
        self.now += self.interval;
        let throw = ThrowRef { boot_id: "w".to_owned(), throw_no: self.throws };
        Observation {
            direction: Some(Direction::BOTH[side]),
            estimate: Some((estimate, covariance)),
            features: Features { duration_s: Some(3.9), ..Features::default() },
            temperature_c,
            ..Observation::without_trace(throw, self.now)
        }
    }

    /// Gives the next throw to the monitor.
    pub(crate) fn throw(&mut self, change: Vector3<f64>) -> Verdict {
        let observation = self.next(change, None);
        self.monitor.observe(&observation, &Settings::default())
    }

    /// Gives the next throw to the monitor beside the other machines of its site.
    pub(crate) fn throw_beside(&mut self, change: Vector3<f64>, common: &Common) -> Verdict {
        let observation = self.next(change, None);
        self.monitor.observe_beside(&observation, common, &Settings::default())
    }

    pub(crate) fn now(&self) -> Timestamp {
        self.now
    }
}
