#![doc = include_str!("limits.md")]

mod closed_loop;
mod finding;
mod findings;
mod load;
mod trial;

use crate::throw::OutOfRange;

pub use finding::{Finding, NAMES, Row};

/// Computes every finding, in the order of the tables above. `throws`: noisy throws of each row, in alternating
/// directions; `seed`: that of all random numbers.
///
/// # Errors
/// When a machine cannot be simulated.
pub fn run(throws: usize, seed: u64) -> Result<Vec<Finding>, OutOfRange> {
    let bench = &mut trial::Bench::new(seed);
    let mut all = findings::sampling(bench)?;
    all.extend([
        findings::mains(bench)?,
        findings::drive(bench)?,
        load::torque(bench)?,
        load::fourth_coefficient(bench, throws)?,
        closed_loop::closed_loop(bench, throws)?,
        findings::noise(bench, throws)?,
        findings::offset(bench)?,
        findings::neutral(bench)?,
        findings::converters(bench, throws)?,
        findings::temperature(bench)?,
    ]);
    Ok(all)
}
