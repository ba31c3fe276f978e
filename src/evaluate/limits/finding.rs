//! Findings: tables of cases with the errors of their estimates.

use serde::Serialize;

/// One limit of the method: a table of simulated cases.
#[derive(Debug, Clone, Serialize)]
pub struct Finding {
    /// Identifier, for JSON.
    pub name: &'static str,
    /// Title of the table.
    pub title: &'static str,
    /// Meaning of the numbers, as a sentence.
    pub about: &'static str,
    /// Parameter of the rows, with its unit.
    pub label: &'static str,
    /// The cases.
    pub rows: Vec<Row>,
}

/// One case of a finding: the errors of its estimates.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Value of the parameter.
    pub label: String,
    /// Number of throws.
    pub throws: usize,
    /// Whether the sensors had noise, so that the errors are random.
    pub noisy: bool,
    /// Errors of b0, a1, a0 in each accepted throw \[%\].
    pub errors_pct: Vec<[f64; 3]>,
    /// Mean of the standard deviations that the estimator states \[%\].
    pub stated_sd_pct: [f64; 3],
    /// Code of the last rejection; `None` if every throw was accepted.
    pub refusal: Option<String>,
}

impl Row {
    /// A case without estimates yet.
    pub(super) fn new(label: impl Into<String>, throws: usize) -> Self {
        let (errors_pct, stated_sd_pct) = (Vec::new(), [0.0; 3]);
        Self { label: label.into(), throws, noisy: true, errors_pct, stated_sd_pct, refusal: None }
    }

    /// Mean errors of b0, a1, a0 \[%\]; `None` if every throw was rejected.
    pub fn mean_pct(&self) -> Option<[f64; 3]> {
        let count = self.errors_pct.len() as f64;
        (count > 0.0).then(|| std::array::from_fn(|at| self.errors_pct.iter().map(|e| e[at]).sum::<f64>() / count))
    }

    /// Largest errors of b0, a1, a0 by magnitude \[%\]; `None` if every throw was rejected.
    pub fn worst_pct(&self) -> Option<[f64; 3]> {
        let larger = |a: f64, b: f64| if b.abs() > a.abs() { b } else { a };
        self.errors_pct.iter().copied().reduce(|a, b| std::array::from_fn(|at| larger(a[at], b[at])))
    }

    /// Standard deviation of the errors over the throws \[%\]; `None` for fewer than three accepted throws.
    pub fn sd_pct(&self) -> Option<[f64; 3]> {
        let mean = self.mean_pct().filter(|_| self.errors_pct.len() > 2)?;
        let count = self.errors_pct.len() as f64;
        let square = |at: usize| self.errors_pct.iter().map(|e| (e[at] - mean[at]).powi(2)).sum::<f64>();
        Some(std::array::from_fn(|at| (square(at) / (count - 1.0)).sqrt()))
    }

    /// Adds the estimate `found` with its stated standard deviations; the error is counted from `reference`.
    pub(super) fn add(&mut self, found: [f64; 3], sd: [f64; 3], reference: [f64; 3]) {
        self.errors_pct.push(std::array::from_fn(|at| (found[at] / reference[at] - 1.0) * 100.0));
        let count = self.errors_pct.len() as f64;
        for at in 0..3 {
            self.stated_sd_pct[at] += (sd[at] / found[at] * 100.0 - self.stated_sd_pct[at]) / count;
        }
    }
}
