//! Limits of the drift statistic, computed from the budget of false alarms.
//!
//! If the covariance V were known, T = m' V^-1 m of the mean m of one window would be chi-square distributed with three
//! degrees of freedom. V comes from a finite baseline, so with nu degrees of freedom of V, T follows Hotelling's law
//! instead: T (nu - 2) / (3 nu) is F(3, nu - 2) distributed. In addition, the uncertain serial correlation makes V
//! wrong by a factor with a known distribution; the tail of T is the mean of Hotelling's law over this distribution.
//! Innovations are clipped, so tails heavier than Gauss's hardly affect T.
//!
//! Every throw tests several windows of several streams (each direction alone, and both), which share the budget. A
//! share is a rate of *new* crossings: consecutive windows overlap, so one crossing lasts some throws and counts once.

use serde::{Deserialize, Serialize};
use statrs::function::beta::checked_beta_reg;

use crate::diagnose::statistics::{Factor, Scatter, WINDOWS};

/// Crossings of a limit for each alarm: the other crossings end within the on delay, or have no stable name. Measured
/// on simulated healthy fleets without warning limits.
const CROSSINGS_PER_ALARM: f64 = 48.0;
/// Coefficients in a residual.
const DIMENSIONS: f64 = 3.0;

/// Limits of T for each of [`WINDOWS`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Thresholds {
    /// The budget from which the limits were computed \[false alarms per throw\].
    budget: f64,
    limits: [f64; 4],
}

impl Thresholds {
    /// Computes the limits for `budget` false alarms per throw of a stream; its windows share them.
    pub(crate) fn compute(scatter: &Scatter, budget: f64) -> Self {
        let share = CROSSINGS_PER_ALARM * budget / WINDOWS.len() as f64;
        Self { budget, limits: WINDOWS.map(|w| limit(share, &scatter.factors(w))) }
    }

    /// Whether the limits were computed for this budget.
    #[expect(clippy::float_cmp, reason = "any change of the setting asks for new limits")]
    pub(crate) fn are_for(&self, budget: f64) -> bool {
        self.budget == budget
    }

    /// The limit of the window `WINDOWS[at]`.
    pub(crate) fn of(&self, at: usize) -> f64 {
        self.limits[at]
    }
}

/// The value that T exceeds with probability `alpha`; `factors`: possible factors on the covariance V.
fn limit(alpha: f64, factors: &[Factor]) -> f64 {
    /// Logarithm of the largest limit.
    const MOST_LOG: f64 = 12.0;
    /// Accepted relative error of the probability.
    const PRECISION: f64 = 1e-4;
    /// Bound on the number of steps; five or six are enough.
    const MOST_STEPS: usize = 30;
    let hotelling = |t: f64, degrees_of_freedom: f64| {
        let second = (degrees_of_freedom - DIMENSIONS + 1.0).max(2.0);
        let nu = second + DIMENSIONS - 1.0;
        let f = t * second / (DIMENSIONS * nu);
        checked_beta_reg(second / 2.0, DIMENSIONS / 2.0, second / (second + DIMENSIONS * f)).unwrap_or(0.0)
    };
    let exceeds = |t: f64| -> f64 {
        factors.iter().map(|factor| factor.probability * hotelling(t / factor.ratio, factor.freedom)).sum()
    };
    let above = |log: f64| (exceeds(log.exp()).max(f64::MIN_POSITIVE) / alpha).ln();
    let (mut low, mut at_low) = (0.0, above(0.0));
    let (mut high, mut at_high) = (1.0, above(1.0));
    while at_high > 0.0 && high < MOST_LOG {
        (low, at_low) = (high, at_high);
        high += 1.0;
        at_high = above(high);
    }
    if at_low <= 0.0 || at_high >= 0.0 {
        return if at_low <= 0.0 { low.exp() } else { high.exp() };
    }
    // Between `low` and `high` the logarithm of the tail is nearly straight, so its chord has nearly the same root. If
    // the same end stays twice, its value is halved (Illinois method), so that both ends approach the root.
    let mut stayed = 0;
    for _ in 0..MOST_STEPS {
        let middle = (low * at_high - high * at_low) / (at_high - at_low);
        let at_middle = above(middle);
        if at_middle.abs() < PRECISION {
            return middle.exp();
        }
        if at_middle > 0.0 {
            (low, at_low) = (middle, at_middle);
            at_high *= if stayed > 0 { 0.5 } else { 1.0 };
            stayed = 1;
        } else {
            (high, at_high) = (middle, at_middle);
            at_low *= if stayed < 0 { 0.5 } else { 1.0 };
            stayed = -1;
        }
    }
    high.exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The only factor on a covariance whose serial correlation is known.
    fn known(freedom: f64) -> [Factor; 1] {
        [Factor { ratio: 1.0, probability: 1.0, freedom }]
    }

    #[test]
    fn with_many_degrees_of_freedom_the_limit_is_that_of_chi_square() {
        // Chi-square with three degrees of freedom, upper tails from a table.
        for (alpha, expected) in [(0.05, 7.815), (0.001, 16.266)] {
            let limit = limit(alpha, &known(1e7));
            assert!((limit - expected).abs() < 2e-3, "{limit}");
        }
    }

    #[test]
    fn an_impossible_budget_has_the_nearest_limit() {
        for (alpha, expected) in [(2.0, 0.0), (1e-300, 12.0)] {
            assert!((limit(alpha, &known(12.0)).ln() - expected).abs() < 1e-9, "{alpha}");
        }
    }

    #[test]
    fn with_few_degrees_of_freedom_the_limit_is_that_of_f() {
        // F(3, 10), upper 1 %: 6.552 in the tables.
        let limit = limit(0.01, &known(12.0));
        assert!((limit - 3.0 * 12.0 / 10.0 * 6.552).abs() < 0.01);
    }
}
