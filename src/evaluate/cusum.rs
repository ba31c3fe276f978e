//! The CUSUM comparator: one two-sided cumulative sum for each coefficient and direction (Page 1954).
//!
//! The reference value of a coefficient is half the warning limit of its cause, the textbook choice for a shift of this
//! size. The decision limit is H standard deviations of the baseline. H is tuned once for each sensor noise, on healthy
//! machines with the same scatter, so that their alarms have the rate of the monitor's false-alarm budget.
//!
//! When a sum exceeds its limit, the rule waits for [`CONFIRM_THROWS`] more throws of that direction, so that the sums
//! of slower coefficients can follow. Then it names a cause. If one coefficient alone is beyond its limit, the cause is
//! that of this coefficient. If all three are, on the same side, the cause is inertia. Otherwise there is no name. Then
//! the sums restart from zero.

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

/// Parameters of the sums.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Design {
    /// Reference values for ln b0, ln a1, ln a0.
    reference: Vector3<f64>,
    /// H: decision limit in standard deviations of the baseline.
    decision_sd: f64,
}

/// The rule for one direction of a machine, with its cumulative sums.
#[derive(Debug, Clone)]
pub(super) struct Cusum {
    design: Design,
    /// Sums of the deviations upwards.
    high: Vector3<f64>,
    /// Sums of the deviations downwards.
    low: Vector3<f64>,
    /// For each coefficient, the side of its sum beyond the limit: 1, -1, or 0 for none. With the number of throws
    /// since the first such sum. `None` while no sum is beyond its limit.
    passed: Option<([i8; 3], usize)>,
    /// The last verdict, which stays while the rule waits for more throws.
    verdict: Option<Cause>,
}

impl Cusum {
    pub(super) fn new(design: Design) -> Self {
        Self { design, high: Vector3::zeros(), low: Vector3::zeros(), passed: None, verdict: None }
    }

    /// Adds a deviation. Returns the verdict when it is due; [`Cause::Unattributed`] stands for no name.
    fn add(&mut self, deviation: Vector3<f64>, sd: Vector3<f64>) -> Option<Cause> {
        self.high = (self.high + deviation - self.design.reference).map(|s| s.max(0.0));
        self.low = (self.low - deviation - self.design.reference).map(|s| s.max(0.0));
        let limit = sd * self.design.decision_sd;
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
        *self = Self::new(self.design);
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

impl Rule for Cusum {
    fn judge(&mut self, log_theta: Vector3<f64>, _: &Baseline, (mean, sd): Normal) -> Option<Cause> {
        self.verdict = self.add(log_theta - mean, sd).or(self.verdict.filter(|_| self.passed.is_some()));
        self.verdict
    }
}

/// Fleet for the tuning of H: number of machines, and number of throws in each direction.
const TUNING: (usize, usize) = (100, 2500);
/// Bisection for H: least and largest value \[standard deviations\], and number of steps.
const DECISION_SD: (f64, f64, usize) = (0.0, 100.0, 14);

impl Design {
    /// Tunes H so that healthy machines have one alarm in `throws_per_false_alarm` throws.
    pub(super) fn tuned(seed: u64, noise: Noise, limits: Limits, baseline: usize, throws_per_false_alarm: f64) -> Self {
        let reference = Vector3::new(limits[0], limits[1], limits[2]) / 2.0;
        let lives = tuning_lives(seed, noise, baseline);
        let watched = 2.0 * (TUNING.0 * TUNING.1) as f64;
        let (mut low, mut high, halvings) = DECISION_SD;
        for _ in 0..halvings {
            let middle = f64::midpoint(low, high);
            let design = Self { reference, decision_sd: middle };
            let alarms: usize = lives.iter().map(|life| alarms(life, design)).sum();
            if alarms as f64 > watched / throws_per_false_alarm {
                low = middle;
            } else {
                high = middle;
            }
        }
        Self { reference, decision_sd: high }
    }
}

/// One direction of a healthy machine: deviations from its baseline, and standard deviations of the baseline.
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

fn alarms((deviations, sd): &TuningLife, design: Design) -> usize {
    let mut cusum = Cusum::new(design);
    deviations.iter().filter(|deviation| cusum.add(**deviation, *sd).is_some()).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = [0.05, 0.15, 0.10, 0.05];
    const BASELINE: usize = 50;

    fn alarms_per_throw(design: Design, seed: u64) -> f64 {
        let lives = tuning_lives(seed, Noise::Default, BASELINE);
        let throws: usize = lives.iter().map(|(deviations, _)| deviations.len()).sum();
        lives.iter().map(|life| alarms(life, design)).sum::<usize>() as f64 / throws as f64
    }

    #[test]
    fn tuning_meets_its_budget_on_machines_that_it_has_not_seen() {
        let budget = 2_000.0;
        let design = Design::tuned(1, Noise::Default, LIMITS, BASELINE, budget);
        let ratio = alarms_per_throw(design, 2) * budget;
        assert!((0.5..2.0).contains(&ratio), "{ratio} times the budget");
    }

    #[test]
    fn a_shift_of_one_coefficient_is_its_cause_and_of_all_three_inertia() {
        let design = Design { reference: Vector3::new(0.025, 0.075, 0.05), decision_sd: 4.0 };
        let sd = Vector3::repeat(0.01);
        let named = |shift: Vector3<f64>| {
            let mut cusum = Cusum::new(design);
            (0..20).find_map(|_| cusum.add(shift, sd))
        };
        assert_eq!(named(Vector3::new(-0.1, 0.0, 0.0)), Some(Cause::Kt));
        assert_eq!(named(Vector3::new(0.0, 0.2, 0.0)), Some(Cause::Friction));
        assert_eq!(named(Vector3::new(0.0, 0.0, 0.2)), Some(Cause::Stiffness));
        assert_eq!(named(Vector3::repeat(-0.2)), Some(Cause::Inertia));
        assert_eq!(named(Vector3::new(0.2, 0.0, -0.2)), Some(Cause::Unattributed));
        assert_eq!(named(Vector3::new(0.02, 0.07, -0.04)), None);
    }
}
