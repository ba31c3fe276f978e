//! Limits of the drift statistic, computed from the budget of false alarms.
//!
//! T = m' V^-1 m of one window would be chi-square with three degrees of freedom if V were known. V comes from a finite
//! baseline, so T follows Hotelling's law instead: T (nu - 2) / (3 nu) is F(3, nu - 2). And V errs with the serial
//! correlation, by a factor with a known distribution: the tail of T is the mean of Hotelling's over this distribution.
//! Innovations are clipped, so tails heavier than Gauss's hardly affect T. Every throw tests several windows of several
//! streams, which share the budget. Each share is a rate of *new* crossings: consecutive windows overlap, so a crossing
//! lasts some throws and counts once.

use serde::{Deserialize, Serialize};
use statrs::function::beta::ln_beta;

use super::scatter::{Doubt, Scatter};

/// Window lengths \[throws\].
pub(super) const WINDOWS: [usize; 4] = [3, 6, 12, 24];
/// Crossings of a limit per alarm: the others end within the on delay, or have no stable name. Measured on simulated
/// healthy fleets without warning limits.
const CROSSINGS_PER_ALARM: f64 = 30.0;
/// Coefficients in a residual.
const DIMENSIONS: f64 = 3.0;

/// Limits of T for the four windows, and the budget for which they were computed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Thresholds {
    budget: f64,
    limits: [f64; 4],
}

impl Thresholds {
    /// Computes the limits for `budget` false alarms per throw of the stream, shared among its windows.
    pub(super) fn compute(scatter: &Scatter, budget: f64) -> Self {
        let share = CROSSINGS_PER_ALARM * budget / WINDOWS.len() as f64;
        Self { budget, limits: WINDOWS.map(|w| limit(share, &scatter.doubt(w))) }
    }

    /// Whether the limits were computed for this budget.
    #[expect(clippy::float_cmp, reason = "any change of the setting asks for new limits")]
    pub(super) fn are_for(&self, budget: f64) -> bool {
        self.budget == budget
    }

    /// The limit of the window `WINDOWS[at]`.
    pub(super) fn of(&self, at: usize) -> f64 {
        self.limits[at]
    }
}

/// The value that T exceeds with probability `alpha`, for a covariance with the uncertainty `doubt`.
fn limit(alpha: f64, doubt: &Doubt) -> f64 {
    /// Largest limit, as its logarithm.
    const MOST_LOG: f64 = 12.0;
    /// Relative error of the probability.
    const PRECISION: f64 = 1e-4;
    /// Steps, of which five or six are needed.
    const MOST_STEPS: usize = 30;
    let laws: Vec<_> =
        doubt.factors.iter().map(|(factor, share, freedom)| (factor, share, Hotelling::new(*freedom))).collect();
    let exceeds = |t: f64| -> f64 { laws.iter().map(|(factor, share, law)| *share * law.exceeds(t / *factor)).sum() };
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
    // Between both, the logarithm of the tail is nearly straight, so its chord has nearly the same root. The value at an end
    // that stays is halved (Illinois), so that both approach the root.
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

/// Hotelling's law of T: its tail is `I_x`(a, 3/2), the regularised incomplete beta function, at x = 1 / (1 + T / nu). The
/// logarithm of B(a, 3/2) is most of the work, and is the same for every T.
struct Hotelling {
    /// Half of the second degrees of freedom of F.
    a: f64,
    /// Logarithm of B(a, 3/2).
    ln_beta: f64,
}

impl Hotelling {
    const B: f64 = DIMENSIONS / 2.0;

    fn new(degrees_of_freedom: f64) -> Self {
        let a = (degrees_of_freedom - DIMENSIONS + 1.0).max(2.0) / 2.0;
        Self { a, ln_beta: ln_beta(a, Self::B) }
    }

    /// Probability of a larger value than `t`.
    fn exceeds(&self, t: f64) -> f64 {
        let Self { a, ln_beta } = *self;
        let y = 1.0 / (1.0 + (2.0 * a + DIMENSIONS - 1.0) / t);
        let x = 1.0 - y;
        let front = (a * (-y).ln_1p() + Self::B * y.ln() - ln_beta).exp();
        // The fraction converges fast on this side of the mean, and by symmetry on the other.
        if x < (a + 1.0) / (a + Self::B + 2.0) {
            front * continued_fraction(a, Self::B, x) / a
        } else {
            1.0 - front * continued_fraction(Self::B, a, y) / Self::B
        }
    }
}

/// The continued fraction of the incomplete beta function (Lentz; Press et al., Numerical Recipes, 6.4).
fn continued_fraction(a: f64, b: f64, x: f64) -> f64 {
    const MOST_STEPS: u32 = 140;
    /// Relative error of the probability.
    const PRECISION: f64 = 1e-12;
    let away_from_0 = |v: f64| if v.abs() < f64::MIN_POSITIVE { f64::MIN_POSITIVE } else { v };
    let (mut c, mut d) = (1.0, 1.0 / away_from_0(1.0 - (a + b) * x / (a + 1.0)));
    let mut value = d;
    for m in (1..MOST_STEPS).map(f64::from) {
        let last = value;
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        for term in [even, odd] {
            d = 1.0 / away_from_0(1.0 + term * d);
            c = away_from_0(1.0 + term / c);
            value *= c * d;
        }
        if (value - last).abs() < PRECISION * value.abs() {
            break;
        }
    }
    value
}

#[cfg(test)]
mod tests {
    use statrs::function::beta::beta_reg;

    use super::*;

    #[test]
    fn with_many_degrees_of_freedom_the_limit_is_that_of_chi_square() {
        // Chi-square with three degrees of freedom, upper tails from a table.
        for (alpha, expected) in [(0.05, 7.815), (0.001, 16.266)] {
            let limit = limit(alpha, &Doubt { factors: vec![(1.0, 1.0, 1e7)] });
            assert!((limit - expected).abs() < 2e-3, "{limit}");
        }
    }

    #[test]
    fn an_impossible_budget_has_the_nearest_limit() {
        let doubt = Doubt { factors: vec![(1.0, 1.0, 12.0)] };
        for (alpha, expected) in [(2.0, 0.0), (1e-300, 12.0)] {
            assert!((limit(alpha, &doubt).ln() - expected).abs() < 1e-9, "{alpha}");
        }
    }

    #[test]
    fn the_tail_is_that_of_the_regularised_beta_function() {
        for freedom in [1.0, 4.5, 12.0, 60.0, 3_000.0] {
            let law = Hotelling::new(freedom);
            for t in [1e-3, 0.5, 3.0, 16.0, 200.0, 1e5] {
                let f = t * law.a / (3.0 * (law.a + 1.0));
                let expected = beta_reg(law.a, 1.5, law.a / (law.a + 1.5 * f));
                let tail = law.exceeds(t);
                assert!((tail - expected).abs() <= 1e-9 * expected, "{freedom} {t}: {tail} {expected}");
            }
        }
    }

    #[test]
    fn with_few_it_is_that_of_f() {
        // F(3, 10), upper 1 %: 6.552 in the tables.
        let limit = limit(0.01, &Doubt { factors: vec![(1.0, 1.0, 12.0)] });
        assert!((limit - 3.0 * 12.0 / 10.0 * 6.552).abs() < 0.01);
    }
}
