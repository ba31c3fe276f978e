#![doc = include_str!("limits.md")]

mod closed_loop;
mod finding;
mod findings;
mod load;
mod trial;

use crate::throw::OutOfRange;

pub use finding::{Finding, NAMES, Row};

/// Settings of the runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Runs {
    /// Noisy throws of each row, in alternating directions.
    pub throws: usize,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Computes every finding, in the order of the tables above.
///
/// # Errors
/// When a machine cannot be simulated.
pub fn run(runs: Runs) -> Result<Vec<Finding>, OutOfRange> {
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
