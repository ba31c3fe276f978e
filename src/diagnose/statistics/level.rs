//! A change with its uncertainty, as a logarithm and in per cent.

/// A change, mostly of a logarithm, with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Level {
    pub(crate) value: f64,
    pub(crate) sd: f64,
}

impl Level {
    /// Misfit to an expected value (chi-square), limited to `most`, so that a change for another reason does not decide
    /// alone.
    pub(crate) fn misfit(self, expected: f64, most: f64) -> f64 {
        /// Standard deviation of an expected value, as part of it.
        const EXPECTED_ERROR: f64 = 0.08;
        ((self.value - expected).powi(2) / (self.sd * self.sd + (EXPECTED_ERROR * expected).powi(2))).min(most)
    }

    /// Size of the change \[%\].
    pub(crate) fn pct(self) -> f64 {
        percent(self.value)
    }

    /// Standard deviation of the size \[%\].
    pub(crate) fn sd_pct(self) -> f64 {
        100.0 * self.sd * self.value.exp()
    }

    /// Half width of the 95 % interval of the size \[%\].
    pub(crate) fn half_width_pct(self) -> f64 {
        196.0 * self.sd * self.value.exp()
    }
}

/// Size of a change of a logarithm \[%\].
pub(crate) fn percent(log: f64) -> f64 {
    100.0 * log.exp_m1()
}
