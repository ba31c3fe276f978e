#![doc = include_str!("limits.md")]

mod closed_loop;
mod findings;
mod load;
mod trial;

use serde::Serialize;

use crate::simulate::InvalidParameter;

/// Names of the coefficients, in the order of every triple here.
pub const NAMES: [&str; 3] = ["b0", "a1", "a0"];

/// One question about the method, answered by runs.
#[derive(Debug, Clone, Serialize)]
pub struct Finding {
    /// A word for files and programs.
    pub name: &'static str,
    /// The question.
    pub title: &'static str,
    /// What the numbers are.
    pub about: &'static str,
    /// What distinguishes the rows, with its unit.
    pub label: &'static str,
    /// One row a case.
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

    /// The error of largest magnitude of each \[%\]; `None` when every throw was refused.
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
}

/// How the runs are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Runs {
    /// Noisy throws a row, both directions in turn.
    pub throws: usize,
    /// Of everything random.
    pub seed: u64,
}

impl Default for Runs {
    fn default() -> Self {
        Self { throws: 60, seed: 1 }
    }
}

/// Every finding, in the order of the page.
///
/// # Errors
/// When a machine cannot be simulated.
pub fn run(runs: Runs) -> Result<Vec<Finding>, InvalidParameter> {
    let mut bench = trial::Bench::new(runs.seed);
    let mut findings = findings::sampling(&mut bench)?;
    findings.push(findings::mains(&mut bench)?);
    findings.push(findings::drive(&mut bench)?);
    findings.push(load::torque(&mut bench)?);
    findings.push(load::fourth_coefficient(&mut bench, runs.throws)?);
    findings.push(closed_loop::closed_loop(&mut bench, runs.throws)?);
    findings.push(findings::noise(&mut bench, runs.throws)?);
    findings.push(findings::offset(&mut bench)?);
    findings.push(findings::neutral(&mut bench)?);
    findings.push(findings::converters(&mut bench, runs.throws)?);
    findings.push(findings::temperature(&mut bench)?);
    Ok(findings)
}
