//! Scores the diagnosis on simulated fleets, beside two comparators on the same throws.
//!
//! A [`Plan`] is a list of independent lives. Each draws from a stream of its own, derived from (seed, row, trial), so the
//! report is the same for any number of threads. A life is one machine thrown to and fro, at one of two depths: its
//! coefficients drawn from a calibrated scatter, or complete simulated throws through the estimator.
//!
//! # Definitions
//! A life begins with the healthy throws of the baseline and 20 to 80 more, then its fault begins, and it is watched for
//! 120 throws after the fault is complete. Faults of both signs take turns. What a rule said is judged like this:
//! - **right**: the first cause that it names after the onset is the part at fault, and it never names another part at
//!   critical severity. Of two causes at once: no first or critical name outside the two, and either both are named or
//!   the alarm says that no single cause explains the drift.
//! - **wrong**: the first name is another part, or another part is named at critical severity later, or there was an
//!   alarm before there was a fault, or any alarm where the fault was there from the first throw: nothing departs from
//!   the baseline then, and a right name is a false alarm that hit.
//! - **ambiguous**: an alarm, but no name.
//! - **missed**: no alarm at all; of two causes, only one.
//!
//! Of the wrong ones, **critical** counts the lives in which a sound part was named at critical severity at any time.
//!
//! **Delay** counts throws of the machine, both directions, from the first throw with the fault (1) to the name. A ramp
//! starts at nothing and takes 100 throws to its full size, so its delay includes the time until it matters.
//!
//! **Plain** rows have steady weather, a full baseline, default or lower sensor noise, and a size of at least twice the
//! warning limit. All others are `hard`.
//!
//! **Healthy** machines: every alarm of any kind is false. **Budget**: with limits that stop nothing, only the drift
//! rule's budget keeps alarms away; lives end at their first alarm, so alarms over throws watched is the rate.
//!
//! # Comparators
//! Both get the same throws and as many baseline throws as the monitor. The paper's bare rule and the CUSUM are described
//! in their files. They have no severity, so a later wrong name does not count against them.

mod comparator;
mod cusum;
mod judge;
mod life;
pub mod limits;
mod observation;
mod paper;
mod parameter;
mod picture;
mod plan;
mod random;
mod report;
mod scenario;
pub mod table1;
mod timeline;
mod trace;

pub use picture::picture;
pub use plan::{Amount, Outcome, Plan};
pub use report::{Budget, GOAL_BUDGET_FACTOR, GOAL_RIGHT, GOAL_STEP_DELAY, Healthy, Report, Row, Tally};
pub use scenario::{Depth, Noise, Shape};

/// Kind of run that a random stream belongs to, so that no two kinds share random numbers.
mod domain {
    pub(super) const HEALTHY: u64 = 1;
    pub(super) const ROW: u64 = 2;
    pub(super) const TIMELINE: u64 = 3;
    pub(super) const BUDGET: u64 = 4;
    pub(super) const TUNING: u64 = 5;
}
