//! The paper's rule in continuous operation, applied to each direction after every throw.
//!
//! The paper uses six tests; here the last six throws of a direction take their place. A coefficient has moved if the
//! mean of the six throws departs from the baseline by more than the warning limit of its cause (b0: motor, a1:
//! friction, a0: stiffness; for inertia, b0 with the limit of inertia). If none has moved, there is no alarm. Otherwise
//! the rule computes the correlation of the three inertia estimates, over these six throws and the last six throws of
//! the baseline. If all pairs are correlated by at least 0.8, the cause is inertia. Else, if one coefficient alone
//! moved, the cause is that of this coefficient. Else there is no name.
//!
//! The baseline throws are necessary, as six throws after a step differ by noise only; equal halves show a step best.

use nalgebra::Vector3;

use super::{
    comparator::{Baseline, Normal, Rule},
    scenario::Limits,
    table1::{CORRELATION_LIMIT, correlations},
};
use crate::diagnose::Cause;

/// Number of tests in the paper's rule.
const TESTS: usize = 6;

/// The paper's rule for one direction of a machine.
#[derive(Debug, Clone)]
pub(super) struct PaperRule {
    pub(super) limits: Limits,
    /// The last throws, up to [`TESTS`], as (ln b0, ln a1, ln a0).
    pub(super) recent: Vec<Vector3<f64>>,
}

impl Rule for PaperRule {
    fn judge(&mut self, log_theta: Vector3<f64>, baseline: &Baseline, (mean, _): Normal) -> Option<Cause> {
        self.recent.push(log_theta);
        if self.recent.len() > TESTS {
            self.recent.remove(0);
        }
        let before = baseline.throws();
        let before = before[before.len().saturating_sub(TESTS)..].iter();
        let tests: Vec<_> = before.chain(&self.recent).copied().collect();
        let change = self.recent.iter().sum::<Vector3<f64>>() / TESTS as f64 - mean;
        verdict(change, &tests, self.limits).filter(|_| self.recent.len() == TESTS)
    }
}

/// Verdict on a `change` of (ln b0, ln a1, ln a0); `tests`: the logarithms for the correlation of the inertia estimates.
fn verdict(change: Vector3<f64>, tests: &[Vector3<f64>], limits: Limits) -> Option<Cause> {
    let size = change.map(|x| x.exp_m1().abs());
    let [kt, friction, stiffness, inertia] = limits;
    let tests: Vec<[f64; 3]> = tests.iter().map(|log_theta| log_theta.map(f64::exp).into()).collect();
    let alone: Vec<Cause> =
        (0..3).filter(|&i| size[i] >= [kt, friction, stiffness][i]).map(|i| Cause::PHYSICAL[i]).collect();
    if alone.is_empty() && size[0] < inertia {
        None
    } else if correlations(&tests, 0.0).iter().all(|pair| *pair >= CORRELATION_LIMIT) {
        Some(Cause::Inertia)
    } else if let [cause] = alone[..] {
        Some(cause)
    } else {
        Some(Cause::Unattributed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = [0.05, 0.15, 0.10, 0.05];

    /// Tests as in the paper's Table 1: ln(b0, a1, a0) relative to nominal. `ratios`: values of the parameter relative
    /// to nominal; `along`: the effect of the parameter's logarithm.
    fn tests(ratios: &[f64], along: Vector3<f64>) -> Vec<Vector3<f64>> {
        // Small extra differences, as a constant series has no correlation.
        let ripple = |at: usize| {
            Vector3::new(1.0, (at % 2) as f64, (at / 2 % 2) as f64)
                * 1e-3
                * if at.is_multiple_of(3) { 1.0 } else { -1.0 }
        };
        ratios.iter().enumerate().map(|(at, ratio)| along * ratio.ln() + ripple(at)).collect()
    }

    fn named(ratios: &[f64], along: Vector3<f64>) -> Option<Cause> {
        let tests = tests(ratios, along);
        verdict(*tests.last().unwrap(), &tests, LIMITS)
    }

    #[test]
    fn the_four_cases_of_the_study_are_distinguished() {
        let kt = [1.0, 0.626, 0.752, 0.877, 1.127, 1.253];
        assert_eq!(named(&kt, Vector3::x()), Some(Cause::Kt));
        assert_eq!(named(&[1.0, 1.01, 1.05, 1.2, 1.5, 1.99], Vector3::y()), Some(Cause::Friction));
        assert_eq!(named(&[1.0, 3.1, 5.1, 7.2, 9.2, 11.2], Vector3::z()), Some(Cause::Stiffness));
        assert_eq!(named(&[1.0, 0.97, 0.81, 0.61, 0.49, 0.425], Vector3::repeat(1.0)), Some(Cause::Inertia));
        assert_eq!(named(&[1.0, 1.01, 0.99, 1.0, 1.01, 1.01], Vector3::x()), None);
    }

    #[test]
    fn two_coefficients_that_move_apart_have_no_name() {
        let tests = tests(&[1.0, 1.1, 1.2, 1.3, 1.4, 1.5], Vector3::new(1.0, 0.0, -1.0));
        assert_eq!(verdict(*tests.last().unwrap(), &tests, LIMITS), Some(Cause::Unattributed));
    }
}
