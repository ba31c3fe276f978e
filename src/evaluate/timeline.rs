//! Timeline of a life: the weather, faults and repair at each throw.

use nalgebra::Vector3;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use super::{
    scenario::{Growth, Scenario, Situation, displacement},
    weather::{Climate, SEASON_THROWS, SWING_THROWS, WetSpells},
};
use crate::diagnose::Cause;

/// Throws of a life after the fault is complete.
const WATCH_THROWS: usize = 120;
/// Throws before the fault in a row with a short baseline: 15 of each direction.
const SHORT_BASELINE_THROWS: usize = 30;
/// In a life with a repair: throws with the first fault, and throws from the repair to the second fault.
const REPAIR_ACT_THROWS: usize = 60;
/// Throws from the first fault to the second one, in a life with two faults one after the other.
const EARLIER_THROWS: usize = 60;
/// Range of the random number of healthy throws between the baseline and the fault.
const HEALTHY_THROWS: std::ops::Range<usize> = 20..80;
/// Change of a part that wears from the first throw, as a fraction of nominal, after which a statement comes too late:
/// the default warning limit of friction.
const WORN: f64 = 0.15;

/// A fault of one part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LifeFault {
    pub(super) part: Cause,
    /// Final change, as a fraction of nominal.
    pub(super) size: f64,
    /// First throw with the fault, from 0.
    pub(super) onset: usize,
    /// First throw after the repair; `None` if the fault stays.
    pub(super) repaired: Option<usize>,
    pub(super) shape: Growth,
}

impl LifeFault {
    /// The change at throw `at`, as a fraction of nominal.
    pub(super) fn size_at(&self, at: usize) -> f64 {
        if at < self.onset || self.repaired.is_some_and(|end| at >= end) {
            return 0.0;
        }
        self.size * self.shape.part_at(at - self.onset + 1)
    }
}

/// Timeline of a life: faults, weather and length.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Timeline {
    pub(super) faults: Vec<LifeFault>,
    /// First throw of the judged fault or faults.
    pub(super) onset: usize,
    /// Number of throws.
    pub(super) throws: usize,
    /// Temperature; `None` if it has no effect.
    pub(super) climate: Option<Climate>,
    pub(super) wet: WetSpells,
    /// Change of ln b0 and ln a0, as part of a rise of ln friction. See [`LEAKAGE`].
    leakage: f64,
}

/// Range of the effect of dry friction on the other coefficients: it adds this part of its change of ln a1 to the
/// logarithms of all three. Simulated throws with stiff and soft toe drives gave 0.25 to 0.67.
const LEAKAGE: std::ops::Range<f64> = 0.25..0.67;

impl Timeline {
    /// Whether the fault exists from the first throw. The baseline contains it, and every alarm comes from scatter.
    pub(super) fn fault_is_in_baseline(&self) -> bool {
        self.onset == 0 && self.deadline().is_none()
    }

    /// First throw at which a statement about wear from the first throw is too late; `None` for other faults.
    pub(super) fn deadline(&self) -> Option<usize> {
        let wear = self.faults.iter().find(|fault| fault.shape == Growth::Wear)?;
        (wear.onset..self.throws).find(|&at| wear.size_at(at).abs() >= WORN)
    }

    /// A healthy life of `throws` throws.
    pub(super) fn healthy(throws: usize) -> Self {
        Self { faults: Vec::new(), onset: throws, throws, climate: None, wet: WetSpells::default(), leakage: 0.0 }
    }

    /// Timeline of life number `trial` of a scenario. `baseline` is the number of throws of the machine that the
    /// monitor needs for its baseline.
    ///
    /// The sign of the fault alternates from life to life: the part becomes weaker, or is replaced by a stronger one.
    pub(super) fn of(scenario: &Scenario, trial: usize, baseline: usize, random: &mut ChaCha8Rng) -> Self {
        let situation = scenario.situation;
        let healthy = random.random_range(HEALTHY_THROWS);
        let start = match situation {
            Situation::ShortBaseline => SHORT_BASELINE_THROWS,
            Situation::FromFirstThrow | Situation::Wear => 0,
            // A healthy machine first lives through a period of the temperature, or until summer.
            Situation::Temperature { .. } => baseline + SWING_THROWS + healthy,
            Situation::Season => baseline + SEASON_THROWS + healthy,
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
            faults.push(LifeFault { part: before, size: REPAIRED_SIZE, onset: start, repaired, shape: Growth::Step });
            onset = start + 2 * REPAIR_ACT_THROWS;
        }
        if let Some((part, size)) = scenario.earlier {
            let size = sign(scenario.faults.len(), size) * size;
            faults.push(LifeFault { part, size, onset: start, repaired: None, shape: Growth::Step });
            onset = start + EARLIER_THROWS;
        }
        for (bit, &(part, size)) in scenario.faults.iter().enumerate() {
            faults.push(LifeFault { part, size: sign(bit, size) * size, onset, repaired: None, shape: scenario.shape });
        }
        let climate = match situation {
            Situation::Temperature { measured } => Some(Climate::swing(measured, random)),
            Situation::Season => Some(Climate::summer(baseline)),
            _ => None,
        };
        let leakage = if situation == Situation::Leakage { random.random_range(LEAKAGE) } else { 0.0 };
        let throws = onset + scenario.shape.throws() + WATCH_THROWS;
        Self { faults, onset, throws, climate, wet: WetSpells::default(), leakage }
    }

    /// Change of (ln b0, ln a1, ln a0) at throw `at`, from faults and temperature.
    pub(super) fn displacement(&self, at: usize) -> Vector3<f64> {
        let drift: Vector3<f64> = self.faults.iter().map(|fault| displacement(fault.part, fault.size_at(at))).sum();
        // Less friction hardly changes the other coefficients.
        let leaked = Vector3::repeat(drift.y.max(0.0) * self.leakage);
        let warmth = self.climate.map_or_else(Vector3::zeros, |climate| climate.displacement(at));
        drift + leaked + warmth + self.wet.displacement(at)
    }

    /// The temperature that throw `at` publishes \[°C\].
    pub(super) fn temperature_c(&self, at: usize) -> Option<f64> {
        self.climate.filter(|climate| climate.measured).map(|climate| climate.temperature_c(at))
    }

    /// The parts whose fault begins at the onset.
    pub(super) fn truth(&self) -> impl Iterator<Item = Cause> {
        self.faults.iter().filter(|fault| fault.onset == self.onset).map(|fault| fault.part)
    }

    /// The part with a fault before the judged one. Its name is right before the onset.
    pub(super) fn earlier(&self) -> Option<Cause> {
        self.faults.iter().find(|fault| fault.onset < self.onset).map(|fault| fault.part)
    }

    /// The part whose earlier fault still exists. Its name is right before the onset, and no error after it.
    pub(super) fn lasting(&self) -> Option<Cause> {
        let lasts = |fault: &&LifeFault| fault.onset < self.onset && fault.repaired.is_none();
        self.faults.iter().find(lasts).map(|fault| fault.part)
    }
}

/// Largest loss of a part, as a fraction; a larger fault can only be an increase.
const LARGEST_LOSS: f64 = 0.5;

/// Size of the repaired fault, as a fraction of nominal: beyond the warning limit of every cause.
const REPAIRED_SIZE: f64 = 0.30;

fn other_part(part: Cause, trial: usize) -> Cause {
    let others = Cause::PHYSICAL.into_iter().filter(|other| *other != part);
    others.cycle().nth(trial % (Cause::PHYSICAL.len() - 1)).unwrap_or(part)
}
