//! Common parts of both comparators: their baselines, from the same throws as the monitor's baseline, and their calls.

use nalgebra::Vector3;

use super::judge::Call;
use crate::diagnose::{Cause, Observation};

/// Least standard deviation of the logarithm of a coefficient; prevents a division by zero.
const LEAST_SD: f64 = 1e-4;

/// Mean and standard deviation of (ln b0, ln a1, ln a0) in a baseline.
pub(super) type Normal = (Vector3<f64>, Vector3<f64>);

/// The first throws of a direction, as (ln b0, ln a1, ln a0).
#[derive(Debug, Clone)]
pub(super) struct Baseline {
    wanted: usize,
    throws: Vec<Vector3<f64>>,
    normal: Option<Normal>,
}

impl Baseline {
    /// A baseline over the first `wanted` throws, at least 2.
    pub(super) fn new(wanted: usize) -> Self {
        Self { wanted: wanted.max(2), throws: Vec::new(), normal: None }
    }

    /// Adds a throw and returns `None` while the baseline is incomplete; then returns mean and standard deviation.
    pub(super) fn take(&mut self, log_theta: Vector3<f64>) -> Option<Normal> {
        if self.normal.is_none() {
            self.throws.push(log_theta);
            if self.throws.len() == self.wanted {
                let mean = self.throws.iter().sum::<Vector3<f64>>() / self.wanted as f64;
                let squares = self.throws.iter().map(|x| (x - mean).component_mul(&(x - mean)));
                let variance = squares.sum::<Vector3<f64>>() / (self.wanted - 1) as f64;
                self.normal = Some((mean, variance.map(|v| v.sqrt().max(LEAST_SD))));
            }
            return None;
        }
        self.normal
    }

    pub(super) fn throws(&self) -> &[Vector3<f64>] {
        &self.throws
    }
}

/// A rule for the throws of one direction.
pub(super) trait Rule {
    /// The verdict after a throw with the logarithms `log_theta`, against the complete baseline with this normal.
    fn judge(&mut self, log_theta: Vector3<f64>, baseline: &Baseline, normal: Normal) -> Option<Cause>;
}

/// A rule on one machine.
#[derive(Debug, Clone)]
pub(super) struct Comparator<R> {
    rules: [R; 2],
    baselines: [Baseline; 2],
    /// Present verdict of each direction.
    verdicts: [Option<Cause>; 2],
    /// The calls: one for each new verdict that is not the present verdict of the other direction.
    pub(super) calls: Vec<Call>,
}

impl<R: Rule + Clone> Comparator<R> {
    /// The rule with a baseline of `baseline` throws in each direction.
    pub(super) fn new(rule: R, baseline: usize) -> Self {
        let (rules, baselines) = ([rule.clone(), rule], [Baseline::new(baseline), Baseline::new(baseline)]);
        Self { rules, baselines, verdicts: [None; 2], calls: Vec::new() }
    }

    /// Applies the rule to throw `at` of the machine. A throw without direction or coefficients is left out.
    pub(super) fn observe(&mut self, at: usize, observation: &Observation) {
        let (Some(estimate), Some(direction)) = (observation.estimate(), observation.direction) else { return };
        let theta = estimate.coefficients;
        if theta.iter().any(|coefficient| *coefficient <= 0.0 || coefficient.is_nan()) {
            return;
        }
        let (side, log_theta) = (direction.side(), Vector3::from(theta).map(f64::ln));
        let Some(normal) = self.baselines[side].take(log_theta) else { return };
        let verdict = self.rules[side].judge(log_theta, &self.baselines[side], normal);
        if let Some(cause) = verdict
            && !self.verdicts.contains(&verdict)
        {
            self.calls.push(Call { at, cause, critical: false, or_sensor: false });
        }
        self.verdicts[side] = verdict;
    }
}
