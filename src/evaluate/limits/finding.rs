//! A finding: a table of cases with the errors of their estimates.

use serde::Serialize;

/// Names of the coefficients, in the order of every triple here.
pub const NAMES: [&str; 3] = ["b0", "a1", "a0"];

/// Answer to a question about the method, from simulated runs.
#[derive(Debug, Clone, Serialize)]
pub struct Finding {
    /// A word for files and programs.
    pub name: &'static str,
    /// The question.
    pub title: &'static str,
    /// Meaning of the numbers.
    pub about: &'static str,
    /// Quantity that distinguishes the rows, with its unit.
    pub label: &'static str,
    /// Rows, one a case.
    pub rows: Vec<Row>,
}

/// The estimates of one case.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// The case.
    pub label: String,
    /// Throws made.
    pub throws: usize,
    /// The sensors were noisy: the errors are random.
    pub noisy: bool,
    /// Errors of b0, a1, a0 in every throw that was accepted \[%\].
    pub errors_pct: Vec<[f64; 3]>,
    /// Standard deviations that the estimator stated, mean over the throws \[%\].
    pub stated_sd_pct: [f64; 3],
    /// Why throws were refused: the reason's code.
    pub refusal: Option<String>,
}

impl Row {
    /// Mean errors of b0, a1, a0 \[%\]; `None` when every throw was refused.
    #[must_use]
    pub fn mean_pct(&self) -> Option<[f64; 3]> {
        let count = self.errors_pct.len() as f64;
        (count > 0.0).then(|| std::array::from_fn(|at| self.errors_pct.iter().map(|e| e[at]).sum::<f64>() / count))
    }

    /// Error of largest magnitude of b0, a1, a0 \[%\]; `None` when every throw was refused.
    #[must_use]
    pub fn worst_pct(&self) -> Option<[f64; 3]> {
        let larger = |a: f64, b: f64| if b.abs() > a.abs() { b } else { a };
        self.errors_pct.iter().copied().reduce(|a, b| std::array::from_fn(|at| larger(a[at], b[at])))
    }

    /// Standard deviation of the errors over the throws \[%\]; `None` for fewer than three.
    #[must_use]
    pub fn sd_pct(&self) -> Option<[f64; 3]> {
        let mean = self.mean_pct().filter(|_| self.errors_pct.len() > 2)?;
        let count = self.errors_pct.len() as f64;
        let square = |at: usize| self.errors_pct.iter().map(|e| (e[at] - mean[at]).powi(2)).sum::<f64>();
        Some(std::array::from_fn(|at| (square(at) / (count - 1.0)).sqrt()))
    }

    pub(super) fn add(&mut self, found: [f64; 3], sd: [f64; 3], reference: [f64; 3]) {
        self.errors_pct.push(std::array::from_fn(|at| (found[at] / reference[at] - 1.0) * 100.0));
        for at in 0..3 {
            self.stated_sd_pct[at] += sd[at] / found[at] * 100.0;
        }
    }

    /// Makes the mean of what the estimates stated from their sum.
    pub(super) fn finish(&mut self) {
        let count = self.errors_pct.len().max(1) as f64;
        self.stated_sd_pct = self.stated_sd_pct.map(|sum| sum / count);
    }
}
