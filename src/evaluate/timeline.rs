//! Timeline of a life: weather, faults and repair of each throw.

use nalgebra::Vector3;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use super::scenario::{PARTS, RAMP_THROWS, Scenario, Shape, Situation, displacement};
use crate::diagnose::Cause;

/// Throws of a life after its fault is complete.
const WATCH_THROWS: usize = 120;
/// Throws before the fault in a row with a short baseline: 15 in each direction.
const SHORT_BASELINE_THROWS: usize = 30;
/// In a life with a repair: throws with the first fault, and throws after its repair.
const REPAIR_ACT_THROWS: usize = 60;
/// Healthy throws between the baseline and the fault: a random number from this range.
const HEALTHY_THROWS: std::ops::Range<usize> = 20..80;
/// Period of the temperature \[throws\]; the healthy part of these lives is at least as long.
const SWING_THROWS: usize = 240;

/// A fault of one part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fault {
    /// The part.
    pub(super) part: Cause,
    /// Final change, as a fraction of nominal.
    pub(super) size: f64,
    /// First throw with the fault, from 0.
    pub(super) onset: usize,
    /// First throw after the repair.
    pub(super) repaired: Option<usize>,
    /// Development over the throws.
    pub(super) shape: Shape,
}

impl Fault {
    /// The change at throw `at`, as a fraction of nominal.
    pub(super) fn size_at(&self, at: usize) -> f64 {
        if at < self.onset || self.repaired.is_some_and(|end| at >= end) {
            return 0.0;
        }
        match self.shape {
            Shape::Step => self.size,
            Shape::Ramp => self.size * ((at - self.onset + 1) as f64 / RAMP_THROWS as f64).min(1.0),
        }
    }
}

/// Timeline of a life: its faults, their onset and its length.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Timeline {
    /// All faults of the life.
    pub(super) faults: Vec<Fault>,
    /// First throw of the judged fault or faults.
    pub(super) onset: usize,
    /// Throws of the life.
    pub(super) throws: usize,
    climate: Option<Climate>,
    /// Share of ln friction that moves ln b0 and ln a0 too.
    leakage: f64,
}

/// Range of the common change of all coefficients by dry friction, as a part of it; throws at trace depth with stiff and
/// soft toe drives gave 0.25 to 0.67.
const LEAKAGE: std::ops::Range<f64> = 0.25..0.67;

/// A varying temperature, and its effect on the coefficients.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Climate {
    phase: f64,
    measured: bool,
}

/// Change of ln b0, ln a1 and ln a0 per kelvin: warmth weakens the magnets, thins the grease, and softens the rails by
/// thermal thrust.
const PER_KELVIN: [f64; 3] = [-0.0015, -0.008, -0.001];
/// Mean, seasonal and daily amplitude of the temperature \[°C\].
const TEMPERATURE: [f64; 3] = [12.0, 12.0, 3.0];
/// Throws a day.
pub(super) const THROWS_A_DAY: usize = 20;

impl Climate {
    fn temperature_c(self, at: usize) -> f64 {
        let [mean, season, day] = TEMPERATURE;
        let turn = |period: f64| (std::f64::consts::TAU * (at as f64 / period + self.phase)).sin();
        mean + season * turn(SWING_THROWS as f64) + day * turn(THROWS_A_DAY as f64)
    }

    fn displacement(self, at: usize) -> Vector3<f64> {
        let warmer = self.temperature_c(at) - TEMPERATURE[0];
        Vector3::from(PER_KELVIN) * warmer
    }
}

impl Timeline {
    /// Whether the fault exists from the first throw, so that the baseline learns it. Then every alarm comes from
    /// scatter.
    pub(super) fn is_learned(&self) -> bool {
        self.onset == 0
    }

    /// A healthy life of `throws` throws.
    pub(super) fn healthy(throws: usize) -> Self {
        Self { faults: Vec::new(), onset: throws, throws, climate: None, leakage: 0.0 }
    }

    /// Life `trial` of a row, for a monitor whose baseline needs `baseline` throws of the machine.
    ///
    /// The sign of the faults alternates: a part can weaken, or be replaced by a stronger one.
    pub(super) fn of(scenario: &Scenario, trial: usize, baseline: usize, random: &mut ChaCha8Rng) -> Self {
        let situation = scenario.situation;
        let healthy = random.random_range(HEALTHY_THROWS);
        let start = match situation {
            Situation::ShortBaseline => SHORT_BASELINE_THROWS,
            Situation::FromFirstThrow => 0,
            Situation::Temperature { .. } => baseline + SWING_THROWS + healthy,
            _ => baseline + healthy,
        };
        let sign = |bit: usize, size: f64| {
            if !(0.0..=LARGEST_LOSS).contains(&size) || trial >> bit & 1 == 0 { 1.0 } else { -1.0 }
        };
        let mut faults = Vec::new();
        let mut onset = start;
        if situation == Situation::Repaired {
            let before = other_part(scenario.faults[0].0, trial);
            let repaired = Some(start + REPAIR_ACT_THROWS);
            faults.push(Fault { part: before, size: REPAIRED_SIZE, onset: start, repaired, shape: Shape::Step });
            onset = start + 2 * REPAIR_ACT_THROWS;
        }
        for (bit, &(part, size)) in scenario.faults.iter().enumerate() {
            faults.push(Fault { part, size: sign(bit, size) * size, onset, repaired: None, shape: scenario.shape });
        }
        let ramp = if scenario.shape == Shape::Ramp { RAMP_THROWS } else { 0 };
        let climate = match situation {
            Situation::Temperature { measured } => Some(Climate { phase: random.random(), measured }),
            _ => None,
        };
        let leakage = if situation == Situation::Leakage { random.random_range(LEAKAGE) } else { 0.0 };
        Self { faults, onset, throws: onset + ramp + WATCH_THROWS, climate, leakage }
    }

    /// Change of (ln b0, ln a1, ln a0) at throw `at`, from faults and temperature.
    pub(super) fn displacement(&self, at: usize) -> Vector3<f64> {
        let drift: Vector3<f64> = self.faults.iter().map(|fault| displacement(fault.part, fault.size_at(at))).sum();
        // A fall hardly leaks.
        let leaked = Vector3::repeat(drift.y.max(0.0) * self.leakage);
        drift + leaked + self.climate.map_or_else(Vector3::zeros, |climate| climate.displacement(at))
    }

    /// The measured temperature of throw `at` \[°C\].
    pub(super) fn temperature_c(&self, at: usize) -> Option<f64> {
        self.climate.filter(|climate| climate.measured).map(|climate| climate.temperature_c(at))
    }

    /// The parts with a fault from the onset on.
    pub(super) fn truth(&self) -> impl Iterator<Item = Cause> {
        self.faults.iter().filter(|fault| fault.onset == self.onset).map(|fault| fault.part)
    }

    /// The part that is repaired before the judged fault; its name before the onset is right.
    pub(super) fn repaired(&self) -> Option<Cause> {
        self.faults.iter().find(|fault| fault.repaired.is_some()).map(|fault| fault.part)
    }
}

/// Largest loss of a part, as a fraction; larger faults have a positive sign only.
const LARGEST_LOSS: f64 = 0.5;

/// Size of the repaired fault, as a fraction of nominal: beyond the warning limits of all causes.
const REPAIRED_SIZE: f64 = 0.30;

fn other_part(part: Cause, trial: usize) -> Cause {
    let others = PARTS.into_iter().filter(|other| *other != part);
    others.cycle().nth(trial % (PARTS.len() - 1)).unwrap_or(part)
}
