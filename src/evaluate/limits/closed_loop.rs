//! A motor in a closed loop: equation (12) with a current that depends on the movement.
//!
//! SRIV computes its instrument from the current. If the current depends on a disturbance of the position, the
//! instrument is correlated with this disturbance, and the estimate may be biased.

use rand::RngExt;
use rand_distr::StandardNormal;

use super::finding::{Finding, Row};
use super::trial::{Bench, fit};
use crate::estimate::{Hold, midpoint};
use crate::simulate::{Coefficients, Parameters};
use crate::throw::OutOfRange;

/// Sampling interval of logger and controller \[s\].
const INTERVAL_S: f64 = 1e-3;
/// Integration steps between two samples.
const FINE: usize = 20;
/// Set point of the speed \[rad/s on the screw\].
const SPEED_RAD_S: f64 = 17.0;
/// Proportional gain of the controller \[A per rad/s\].
const GAIN: f64 = 0.5;
/// Integral time of the controller \[s\].
const INTEGRAL_S: f64 = 0.2;
/// Largest current of the controller \[A\].
const MAX_CURRENT_A: f64 = 13.0;
/// Time constant of the filter from recorded position to speed \[s\].
const SPEED_FILTER_S: f64 = 0.01;
/// Correlation time of the load \[s\].
const LOAD_S: f64 = 0.05;
/// Standard deviation of the current sensor's noise \[A\].
const CURRENT_NOISE_A: f64 = 0.02;

/// Source of the motor's current.
#[derive(Debug, Clone, Copy, strum::AsRefStr)]
#[strum(serialize_all = "snake_case")]
enum Current {
    /// A battery: only the back-EMF depends on the speed.
    Battery,
    /// A controller with the speed from the recorded position, including its noise.
    Controller,
    /// The current of an undisturbed throw on a battery, independent of the movement.
    Replayed,
}

/// Errors of the estimates, with a current that depends on the movement and with one that does not.
pub(super) fn closed_loop(bench: &mut Bench, throws: usize) -> Result<Finding, OutOfRange> {
    let machine = Parameters::default();
    let mut plant = Plant { known: machine.coefficients()?, machine, replayed: Vec::new() };
    plant.replayed = plant.throw(Current::Battery, 0.0, 0.0, bench).0;
    let mut rows = Vec::new();
    for (noise_um, load_pct, current) in [
        (20.0, 0.0, Current::Battery),
        (20.0, 0.0, Current::Controller),
        (200.0, 0.0, Current::Controller),
        (20.0, 5.0, Current::Replayed),
        (20.0, 5.0, Current::Battery),
        (20.0, 5.0, Current::Controller),
    ] {
        let mut row = Row::new(format!("{}, {noise_um}, {load_pct}", current.as_ref()), throws);
        let noise = noise_um / 1000.0 * plant.radians_per_mm();
        for _ in 0..throws {
            let (current, position) = plant.throw(current, noise, load_pct / 100.0, bench);
            // The current is constant between two samples.
            let inputs = [(&*current, Hold::Zero)];
            let variances = [CURRENT_NOISE_A.powi(2), noise * noise];
            fit::<1, 3>(&mut row, inputs, INTERVAL_S, &position, variances, plant.known.values());
        }
        rows.push(row);
    }
    Ok(Finding {
        name: "closed_loop",
        title: "A current that depends on the movement",
        about: "Mean error ± observed standard deviation (standard deviation that the estimator states). The load varies at \
                random with a correlation time of 50 ms, and the given share of the running torque as standard deviation.",
        label: "current from, position noise [um], load [%]",
        rows,
    })
}

/// The machine with its true coefficients, and the current of an undisturbed throw on a battery.
struct Plant {
    machine: Parameters,
    known: Coefficients,
    replayed: Vec<f64>,
}

impl Plant {
    fn radians_per_mm(&self) -> f64 {
        std::f64::consts::TAU / self.machine.lead_mm
    }

    /// Simulates a throw; returns the recorded current \[A\] and screw angle \[rad\]. `noise`: standard deviation of
    /// the recorded angle \[rad\]; `load`: standard deviation of the random load, as part of the running torque.
    fn throw(&self, current: Current, noise: f64, load: f64, bench: &mut Bench) -> (Vec<f64>, Vec<f64>) {
        let Coefficients { b0, a1, a0, .. } = self.known;
        let mut normal = || bench.rng.sample::<f64, _>(StandardNormal);
        let end = 0.95 * self.machine.stroke_mm * self.radians_per_mm();
        let back_emf = self.machine.back_emf_constant * self.machine.gear_ratio;
        let ([mut angle, mut speed], mut disturbance) = ([0.0; 2], 0.0);
        let mut controller = Controller::default();
        let (mut currents, mut positions) = (Vec::new(), Vec::new());
        while angle < end && positions.len() < 20_000 {
            let recorded = angle + noise * normal();
            let driving = match current {
                Current::Battery => (self.machine.supply_v - back_emf * speed) / self.machine.resistance_ohm,
                Current::Controller => controller.current(recorded),
                Current::Replayed => {
                    let last = self.replayed.last().copied().unwrap_or_default();
                    self.replayed.get(positions.len()).copied().unwrap_or(last)
                }
            };
            let measured = if noise > 0.0 { driving + CURRENT_NOISE_A * normal() } else { driving };
            currents.push(measured);
            positions.push(recorded);
            let keeps = (-INTERVAL_S / LOAD_S).exp();
            let size = load * a1 * SPEED_RAD_S;
            disturbance = keeps * disturbance + (1.0 - keeps * keeps).sqrt() * size * normal();
            let h = INTERVAL_S / FINE as f64;
            // Equation (12); the current is constant between two samples.
            let acceleration = |[angle, speed]: [f64; 2]| b0 * driving - a1 * speed - a0 * angle - disturbance;
            for _ in 0..FINE {
                [angle, speed] = midpoint([angle, speed], h, acceleration, acceleration);
            }
        }
        (currents, positions)
    }
}

/// A speed controller with a proportional and an integral part.
#[derive(Default)]
struct Controller {
    /// Recorded position at the last sample \[rad\].
    before: f64,
    /// Filtered speed \[rad/s\].
    speed: f64,
    /// Integral of the speed error \[rad\].
    integral: f64,
}

impl Controller {
    /// The current \[A\] at the next sample, from the recorded position \[rad\]. Its integral stops at the largest
    /// current.
    fn current(&mut self, recorded: f64) -> f64 {
        self.speed += ((recorded - self.before) / INTERVAL_S - self.speed) * INTERVAL_S / SPEED_FILTER_S;
        self.before = recorded;
        let error = SPEED_RAD_S - self.speed;
        let asked = GAIN * (error + self.integral / INTEGRAL_S);
        if asked.abs() <= MAX_CURRENT_A {
            self.integral += error * INTERVAL_S;
        }
        asked.clamp(-MAX_CURRENT_A, MAX_CURRENT_A)
    }
}
