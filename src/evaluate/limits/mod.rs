#![doc = include_str!("limits.md")]

mod finding;
mod findings;
mod trial;

use crate::throw::OutOfRange;

pub use finding::{Finding, Row};

/// Number of findings.
pub const FINDINGS: usize = 11;

/// Computes every finding, in the order of the tables above. `throws`: noisy throws of each row, in alternating
/// directions; `seed`: that of all random numbers. `is_done` is called after each finding, for a progress bar.
///
/// # Errors
/// When a machine cannot be simulated.
pub fn run(throws: usize, seed: u64, is_done: impl Fn()) -> Result<Vec<Finding>, OutOfRange> {
    let bench = &mut trial::Bench::new(seed);
    let mut all = Vec::with_capacity(FINDINGS);
    let mut add = |finding: Finding| {
        all.push(finding);
        is_done();
    };
    findings::sampling(bench)?.into_iter().for_each(&mut add);
    add(findings::mains(bench)?);
    add(findings::drive(bench)?);
    add(findings::load(bench)?);
    add(findings::noise(bench, throws)?);
    add(findings::offset(bench)?);
    add(findings::neutral(bench)?);
    add(findings::converters(bench, throws)?);
    add(findings::temperature(bench)?);
    Ok(all)
}
