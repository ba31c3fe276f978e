//! Common parts of both comparators: the baseline, from the same throws as that of the monitor, and the calls.

use nalgebra::Vector3;

use super::judge::Call;
use crate::{
    diagnose::{Cause, Observation},
    throw::Direction,
};

/// Least standard deviation of a coefficient; prevents a division by zero.
const LEAST_SD: f64 = 1e-4;

/// Mean and standard deviation of (ln b0, ln a1, ln a0) over the first throws of a direction.
#[derive(Debug, Clone)]
pub(super) struct Baseline {
    wanted: usize,
    throws: Vec<Vector3<f64>>,
    normal: Option<(Vector3<f64>, Vector3<f64>)>,
}

impl Baseline {
    /// A baseline over the first `wanted` throws, at least 2.
    pub(super) fn new(wanted: usize) -> Self {
        Self { wanted: wanted.max(2), throws: Vec::new(), normal: None }
    }

    /// Adds a throw while the baseline is incomplete and returns `None`; then returns mean and standard deviation.
    pub(super) fn take(&mut self, log_theta: Vector3<f64>) -> Option<(Vector3<f64>, Vector3<f64>)> {
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

    /// The throws of the baseline.
    pub(super) fn throws(&self) -> &[Vector3<f64>] {
        &self.throws
    }
}

/// Index of the direction and logarithms of the coefficients; `None` if the throw lacks one of them.
pub(super) fn log_theta(observation: &Observation) -> Option<(usize, Vector3<f64>)> {
    let (theta, _) = observation.estimate?;
    let direction = match observation.direction? {
        Direction::NormalToReverse => 0,
        Direction::ReverseToNormal => 1,
    };
    theta.iter().all(|coefficient| *coefficient > 0.0).then(|| (direction, Vector3::from(theta).map(f64::ln)))
}

/// Turns the verdicts of a rule into calls: a call for each new cause, as long as no direction has it already.
#[derive(Debug, Clone, Default)]
pub(super) struct Caller {
    thinks: [Option<Cause>; 2],
    /// The calls so far.
    pub(super) calls: Vec<Call>,
}

impl Caller {
    /// Records the verdict of the rule on `direction` after throw `at`.
    pub(super) fn note(&mut self, direction: usize, at: usize, thinks: Option<Cause>) {
        if let Some(cause) = thinks
            && !self.thinks.contains(&thinks)
        {
            self.calls.push(Call { at, cause, critical: false, or_sensor: false });
        }
        self.thinks[direction] = thinks;
    }
}
