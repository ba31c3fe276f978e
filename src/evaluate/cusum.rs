//! The CUSUM comparator: one two-sided cumulative sum on each coefficient and direction (Page 1954).
//!
//! The reference value of a coefficient is half the warning limit of its cause, the textbook choice for a shift of this
//! size. The decision limit is H standard deviations of the baseline. H is tuned once for each noise, on healthy
//! machines with the same scatter, until their alarms have the rate of the monitor's false-alarm budget.
//!
//! When a sum passes its limit the rule waits for [`CONFIRM_THROWS`] more throws of that direction, so that slower
//! coefficients can follow. Then it names a cause: that of the only coefficient beyond its limit; inertia if all three
//! are beyond it on the same side; otherwise none. The sums restart from zero.

use nalgebra::Vector3;

use super::{
    comparator::{Baseline, Normal, Rule},
    parameter::ParameterMachine,
    random::stream,
    scatter::Scatter,
    scenario::{Limits, Noise},
};
use crate::diagnose::Cause;

/// Throws of a direction from the first sum beyond its limit to the verdict.
const CONFIRM_THROWS: usize = 3;

/// Sensitivity of the sums.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Design {
    /// Reference values, in logarithms.
    reference: Vector3<f64>,
    /// H: decision limit in standard deviations of the baseline.
    decision_sd: f64,
}

#[derive(Debug, Clone, Default)]
struct Sums {
    high: Vector3<f64>,
    low: Vector3<f64>,
    /// For each coefficient: sign of its sum beyond the limit, or 0; with the number of throws since the first one.
    passed: Option<([i8; 3], usize)>,
}

impl Sums {
    /// Adds a deviation; returns the verdict when it is due, [`Cause::Unattributed`] for no name.
    fn add(&mut self, deviation: Vector3<f64>, sd: Vector3<f64>, design: &Design) -> Option<Cause> {
        self.high = (self.high + deviation - design.reference).map(|s| s.max(0.0));
        self.low = (self.low - deviation - design.reference).map(|s| s.max(0.0));
        let limit = sd * design.decision_sd;
        let side = |i: usize| i8::from(self.high[i] > limit[i]) - i8::from(self.low[i] > limit[i]);
        let sides = [side(0), side(1), side(2)];
        let (mut passed, throws) = match self.passed {
            Some((passed, throws)) => (passed, throws + 1),
            None if sides == [0; 3] => return None,
            None => ([0; 3], 0),
        };
        for (latched, side) in passed.iter_mut().zip(sides) {
            *latched = if *latched == 0 { side } else { *latched };
        }
        self.passed = Some((passed, throws));
        if throws < CONFIRM_THROWS {
            return None;
        }
        *self = Self::default();
        Some(name(passed))
    }
}

fn name(passed: [i8; 3]) -> Cause {
    match passed {
        [1, 1, 1] | [-1, -1, -1] => Cause::Inertia,
        [_, 0, 0] => Cause::Kt,
        [0, _, 0] => Cause::Friction,
        [0, 0, _] => Cause::Stiffness,
        _ => Cause::Unattributed,
    }
}

/// The rule on one direction of a machine.
#[derive(Debug, Clone)]
pub(super) struct Cusum {
    design: Design,
    sums: Sums,
}

impl Cusum {
    pub(super) fn new(design: Design) -> Self {
        Self { design, sums: Sums::default() }
    }
}

impl Rule for Cusum {
    fn judge(
        &mut self,
        log_theta: Vector3<f64>,
        _: &Baseline,
        (mean, sd): Normal,
        last: Option<Cause>,
    ) -> Option<Cause> {
        let verdict = self.sums.add(log_theta - mean, sd, &self.design);
        // While the rule waits for more throws, its last verdict stays.
        verdict.or(last.filter(|_| self.sums.passed.is_some()))
    }
}

/// Number of machines for the tuning of H, and of throws in each direction.
const TUNING: (usize, usize) = (100, 2500);
/// Range of H \[standard deviations\], and number of steps of the bisection.
const DECISION_SD: (f64, f64, usize) = (0.0, 100.0, 14);

impl Design {
    /// Tunes H to one alarm in `throws_per_false_alarm` throws of healthy machines.
    pub(super) fn tuned(seed: u64, noise: Noise, limits: Limits, baseline: usize, throws_per_false_alarm: f64) -> Self {
        let reference = Vector3::new(limits[0], limits[1], limits[2]) / 2.0;
        let lives = tuning_lives(seed, noise, baseline);
        let watched = 2.0 * (TUNING.0 * TUNING.1) as f64;
        let (mut low, mut high, halvings) = DECISION_SD;
        for _ in 0..halvings {
            let middle = f64::midpoint(low, high);
            let design = Self { reference, decision_sd: middle };
            let alarms: usize = lives.iter().map(|life| alarms(life, &design)).sum();
            if alarms as f64 > watched / throws_per_false_alarm {
                low = middle;
            } else {
                high = middle;
            }
        }
        Self { reference, decision_sd: high }
    }
}

/// Deviations of a direction from its baseline, and the standard deviations of the baseline.
type TuningLife = (Vec<Vector3<f64>>, Vector3<f64>);

fn tuning_lives(seed: u64, noise: Noise, baseline: usize) -> Vec<TuningLife> {
    let mut lives = Vec::new();
    for machine_no in 0..TUNING.0 {
        let random = stream(seed, super::domain::TUNING, noise as usize, machine_no);
        let mut machine = ParameterMachine::new(random, noise, Scatter::USUAL);
        let mut directions = [(); 2].map(|()| (Baseline::new(baseline), Vec::new(), Vector3::zeros()));
        for throw in 0..2 * (baseline + TUNING.1) {
            let (theta, _) = machine.throw(throw % 2, Vector3::zeros());
            let (reference, deviations, baseline_sd) = &mut directions[throw % 2];
            let log_theta = Vector3::from(theta).map(f64::ln);
            if let Some((mean, sd)) = reference.take(log_theta) {
                deviations.push(log_theta - mean);
                *baseline_sd = sd;
            }
        }
        lives.extend(directions.map(|(_, deviations, sd)| (deviations, sd)));
    }
    lives
}

fn alarms((deviations, sd): &TuningLife, design: &Design) -> usize {
    let mut sums = Sums::default();
    deviations.iter().filter(|deviation| sums.add(**deviation, *sd, design).is_some()).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = [0.05, 0.15, 0.10, 0.05];
    const BASELINE: usize = 50;

    fn alarms_per_throw(design: &Design, seed: u64) -> f64 {
        let lives = tuning_lives(seed, Noise::Default, BASELINE);
        let throws: usize = lives.iter().map(|(deviations, _)| deviations.len()).sum();
        lives.iter().map(|life| alarms(life, design)).sum::<usize>() as f64 / throws as f64
    }

    #[test]
    fn tuning_meets_its_budget_on_machines_that_it_has_not_seen() {
        let budget = 2_000.0;
        let design = Design::tuned(1, Noise::Default, LIMITS, BASELINE, budget);
        let ratio = alarms_per_throw(&design, 2) * budget;
        assert!((0.5..2.0).contains(&ratio), "{ratio} times the budget");
    }

    #[test]
    fn a_shift_of_one_coefficient_is_its_cause_and_of_all_three_inertia() {
        let design = Design { reference: Vector3::new(0.025, 0.075, 0.05), decision_sd: 4.0 };
        let sd = Vector3::repeat(0.01);
        let named = |shift: Vector3<f64>| {
            let mut sums = Sums::default();
            (0..20).find_map(|_| sums.add(shift, sd, &design))
        };
        assert_eq!(named(Vector3::new(-0.1, 0.0, 0.0)), Some(Cause::Kt));
        assert_eq!(named(Vector3::new(0.0, 0.2, 0.0)), Some(Cause::Friction));
        assert_eq!(named(Vector3::new(0.0, 0.0, 0.2)), Some(Cause::Stiffness));
        assert_eq!(named(Vector3::repeat(-0.2)), Some(Cause::Inertia));
        assert_eq!(named(Vector3::new(0.2, 0.0, -0.2)), Some(Cause::Unattributed));
        assert_eq!(named(Vector3::new(0.02, 0.07, -0.04)), None);
    }
}
