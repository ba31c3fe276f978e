//! Life of a machine, throw by throw: weather, faults, repair.

use nalgebra::Vector3;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use super::scenario::{PARTS, RAMP_THROWS, Scenario, Shape, Situation, displacement};
use crate::diagnose::Cause;

/// Throws that a life is watched after its fault is complete.
const WATCH_THROWS: usize = 120;
/// Throws of the machine before the fault of a row with a short baseline: 15 in each direction.
const SHORT_BASELINE_THROWS: usize = 30;
/// Throws of each act of a life with a repair: the first fault, and the time after its repair.
const REPAIR_ACT_THROWS: usize = 60;
/// Healthy throws between the baseline and the fault: drawn from this range, so that no rule can count on it.
const HEALTHY_THROWS: std::ops::Range<usize> = 20..80;
/// A full swing of the temperature, in throws; the healthy part of its rows lasts at least as long.
const SWING_THROWS: usize = 240;

/// A part that changes from a throw on.
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
    /// Everything that changes.
    pub(super) faults: Vec<Fault>,
    /// First throw of the judged fault or faults.
    pub(super) onset: usize,
    /// Throws of the life.
    pub(super) throws: usize,
    climate: Option<Climate>,
    /// Share of ln friction that moves ln b0 and ln a0 too.
    leakage: f64,
}

/// Range of the leakage: complete throws with stiff and with soft toe drives gave 0.22 to 0.4.
const LEAKAGE: std::ops::Range<f64> = 0.2..0.4;

/// A temperature that swings, and what it does to the coefficients.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Climate {
    phase: f64,
    measured: bool,
}

/// Change of ln b0, ln a1 and ln a0 per kelvin: as it gets warmer magnets weaken, grease thins and thermal thrust softens
/// the rails.
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
    /// Whether the fault is there from the first throw: nothing departs from a baseline that has learned it, so an alarm
    /// comes from the scatter, whatever it names.
    pub(super) fn is_learned(&self) -> bool {
        self.onset == 0
    }

    /// A healthy life of `throws` throws.
    pub(super) fn healthy(throws: usize) -> Self {
        Self { faults: Vec::new(), onset: throws, throws, climate: None, leakage: 0.0 }
    }

    /// Life `trial` of a row, for a monitor whose baseline takes `baseline` throws of the machine.
    ///
    /// Faults of both signs come in turn: a part can weaken or be replaced by a stronger one.
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

    /// Displacement of (ln b0, ln a1, ln a0) at throw `at`, with what the temperature does.
    pub(super) fn displacement(&self, at: usize) -> Vector3<f64> {
        let drift: Vector3<f64> = self.faults.iter().map(|fault| displacement(fault.part, fault.size_at(at))).sum();
        let leaked = Vector3::new(drift.y, 0.0, drift.y) * self.leakage;
        drift + leaked + self.climate.map_or_else(Vector3::zeros, |climate| climate.displacement(at))
    }

    /// The temperature that throw `at` carries \[°C\].
    pub(super) fn temperature_c(&self, at: usize) -> Option<f64> {
        self.climate.filter(|climate| climate.measured).map(|climate| climate.temperature_c(at))
    }

    /// The parts that are truly at fault from the judged onset on.
    pub(super) fn truth(&self) -> impl Iterator<Item = Cause> {
        self.faults.iter().filter(|fault| fault.onset == self.onset).map(|fault| fault.part)
    }

    /// The part whose repair precedes the judged fault: naming it before the judged onset is right.
    pub(super) fn repaired(&self) -> Option<Cause> {
        self.faults.iter().find(|fault| fault.repaired.is_some()).map(|fault| fault.part)
    }
}

/// No part loses more than this fraction of itself: larger faults only grow.
const LARGEST_LOSS: f64 = 0.5;

/// Size of the fault that is repaired, as a fraction of nominal: beyond every cause's warning limit.
const REPAIRED_SIZE: f64 = 0.30;

fn other_part(part: Cause, trial: usize) -> Cause {
    let others = PARTS.into_iter().filter(|other| *other != part);
    others.cycle().nth(trial % (PARTS.len() - 1)).unwrap_or(part)
}
