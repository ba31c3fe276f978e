//! Machines in the field: a generator of throws without the assumptions of the diagnosis. The scatter may have heavy
//! tails and strong serial correlation, and the temperature has days and seasons.

use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix3, Vector3};
pub(crate) use pointsd::evaluate::Scatter;
use pointsd::{
    diagnose::{AlarmEvent, MachineMonitor, Observation, Settings, Verdict},
    estimate::Features,
    throw::{Direction, ThrowRef},
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::fleet::{Nature, normal};

/// A machine that throws in alternating directions, with its monitor.
pub(crate) struct Machine {
    pub(crate) monitor: MachineMonitor,
    pub(crate) settings: Settings,
    pub(crate) rng: ChaCha8Rng,
    pub(crate) throws: u64,
    scatter: Scatter,
    state: Vector3<f64>,
    centre: [Vector3<f64>; 2],
    root: Matrix3<f64>,
    started_at: Timestamp,
    /// Time between two throws.
    pub(crate) interval: SignedDuration,
}

impl Machine {
    pub(crate) fn new(seed: u64, scatter: Scatter) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(0xf1e1d ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let centre = [(); 2].map(|()| {
            Vector3::new(150.0_f64.ln(), 8.0_f64.ln(), 2.5_f64.ln()) + Vector3::from_fn(|_, _| 0.1 * normal(&mut rng))
        });
        let root = Nature::default().covariance().cholesky().unwrap().l();
        let state = Vector3::from_fn(|i, _| scatter.sd[i] * normal(&mut rng));
        let started_at = "2026-01-01T00:00:00Z".parse().unwrap();
        let (monitor, settings) = (MachineMonitor::new("21B"), Settings::default());
        let interval = SignedDuration::from_mins(72);
        Self { monitor, settings, rng, throws: 0, scatter, state, centre, root, started_at, interval }
    }

    /// A machine after this number of healthy throws.
    pub(crate) fn after(throws: usize, seed: u64, scatter: Scatter) -> Self {
        let mut machine = Self::new(seed, scatter);
        machine.events(throws, Vector3::zeros());
        machine
    }

    /// The direction of the next throw: 0 or 1.
    pub(crate) fn side(&self) -> usize {
        usize::from(self.throws % 2 == 1)
    }

    /// The next throw, an interval later, with `shift` added to ln b0, ln a1, ln a0.
    pub(crate) fn throw(&mut self, shift: Vector3<f64>, temperature_c: Option<f64>) -> Observation {
        self.state = self.scatter.next(self.state, || normal(&mut self.rng));
        let error = self.root * Vector3::from_fn(|_, _| normal(&mut self.rng));
        let side = self.side();
        let estimate = (self.centre[side] + self.state + error + shift).map(f64::exp);
        let scale = Matrix3::from_diagonal(&estimate);
        self.throws += 1;
        self.started_at += self.interval;
        let duration_s = 4.3 * (1.0 + 0.004 * normal(&mut self.rng));
        let throw = ThrowRef { boot_id: "field".to_owned(), throw_no: self.throws };
        Observation {
            direction: Some(Direction::BOTH[side]),
            estimate: Some((estimate.into(), scale * Nature::default().covariance() * scale)),
            features: Features { duration_s: Some(duration_s), ..Features::default() },
            temperature_c,
            ..Observation::without_trace(throw, self.started_at)
        }
    }

    /// Gives the next throw, without a temperature, to the monitor.
    pub(crate) fn feed(&mut self, shift: Vector3<f64>) -> Verdict {
        let throw = self.throw(shift, None);
        self.observe(&throw)
    }

    /// Gives the next throw, at a temperature, to the monitor.
    pub(crate) fn feed_at(&mut self, shift: Vector3<f64>, celsius: f64) -> Verdict {
        let throw = self.throw(shift, Some(celsius));
        self.observe(&throw)
    }

    /// Gives a throw to the monitor.
    pub(crate) fn observe(&mut self, throw: &Observation) -> Verdict {
        self.monitor.observe(throw, &self.settings)
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
}

/// Change of ln b0, ln a1, ln a0 per kelvin: weaker magnets, thinner grease, less thrust of the rails.
pub(crate) const PER_KELVIN: [f64; 3] = [-0.0015, -0.008, -0.001];

/// Temperature over the throws of a life, with 20 throws on each day.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Climate {
    /// Winter and summer mean \[°C\].
    pub(crate) season_c: (f64, f64),
    /// Throws in winter, and throws from winter to summer.
    pub(crate) change: (u64, u64),
    /// Daily swing \[K\].
    pub(crate) day_k: f64,
}

impl Climate {
    pub(crate) fn celsius(&self, throw: u64) -> f64 {
        let (from, over) = self.change;
        let part = ((throw as f64 - from as f64) / (over as f64).max(1.0)).clamp(0.0, 1.0);
        let (winter, summer) = self.season_c;
        let day = (throw as f64 / 20.0 * std::f64::consts::TAU).sin();
        winter + (summer - winter) * 0.5 * (1.0 - (std::f64::consts::PI * part).cos()) + self.day_k * day
    }

    /// Effect of the temperature on the logarithms, and the temperature.
    pub(crate) fn effect(&self, throw: u64) -> (Vector3<f64>, f64) {
        let celsius = self.celsius(throw);
        (Vector3::from(PER_KELVIN) * (celsius - 10.0), celsius)
    }
}
