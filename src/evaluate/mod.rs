//! Scores the diagnosis on simulated fleets, compared with two other rules on the same throws.
//!
//! A [`Plan`] is a list of independent lives. A life is one machine that throws in alternating directions, at one of
//! two depths: coefficients drawn from a calibrated scatter, or complete simulated throws with the estimator. Each life
//! has its own random stream, derived from (seed, row, trial), so the report does not depend on the number of threads.
//!
//! # Definitions
//! A life begins with the healthy throws of the baseline and 20 to 80 more. Then the fault begins; the life ends 120
//! throws after the fault is complete. The sign of the fault alternates between lives. A **call** is a cause that a
//! rule names at a throw. The calls of a life are judged as follows:
//! - **right**: the first named part after the onset is the faulty part, and no other part is named at critical
//!   severity. With two causes: no part outside the two is named first or at critical severity, and either both are
//!   named or the alarm is unattributed.
//! - **wrong**: the first named part is another part; or another part is named at critical severity later; or an alarm
//!   came before the fault. A fault that exists from the first throw is part of the baseline, so any alarm is wrong:
//!   even the right name is a false alarm.
//! - **ambiguous**: an alarm without a name.
//! - **missed**: no alarm; with two causes, only one named.
//!
//! Faults of machines in the field:
//! - **baseline in winter, fault in summer**: the temperature is published. It rises from -10 to 29 °C over 600 throws,
//!   and the monitor learns its effect (friction -0.8 % a kelvin). The fault begins 20 to 80 throws later.
//! - **accelerating**: growth with the square of the throws, over 200 throws.
//! - **every fifth, every tenth**: an intermittent fault, followed for 320 throws from the onset.
//! - **wear from the first throw**: friction rises by 0.25 % a throw. Right is the name friction, or the monitor's
//!   statement that the baseline has a trend, before the friction is up by 15 %; a later one is missed. The other rules
//!   have no such statement, and their baselines are complete only after that.
//! - **second fault, the first still exists**: the second fault begins 60 throws after the first. Right is the name of
//!   the second. The name of the first is right before the onset of the second, and does not count after it.
//!
//! **Critical** counts the lives in which a healthy part was named at critical severity at any time.
//!
//! **Delay** is the number of throws of the machine, in both directions, from the first throw with the fault (1) to the
//! name. A ramp takes 100 throws to its full size, so its delay includes the time until it is relevant.
//!
//! **Interval** and **forecast**: the share of true statements about steps, ramps and accelerating faults. The 95 %
//! interval of the size has to contain the true size when the alarm is raised, and at every tenth throw of the fault
//! while the alarm is active. A forecast has to contain the true number of throws to the critical limit, at every tenth
//! throw before a growing fault reaches the limit. Faults that end below the limit have no true forecast and are left
//! out.
//!
//! **Plain** rows have steady weather, a full baseline, default or lower sensor noise, and a size of at least twice the
//! warning limit. All others are `hard`.
//!
//! **Healthy** machines: every alarm is false. Further fleets have scatter or weather that the diagnosis does not
//! assume, and no goals: strong serial correlation; heavy tails (Student's t with 3 degrees of freedom); three times
//! the usual scatter; 200 days of a year with a temperature swing of 20 K up and down, not published; wet spells of 15
//! throws with 20 % less friction, once in 20 days.
//!
//! **Budget**: with warning limits near 0, only the false-alarm budget of the drift rule prevents alarms. Lives end at
//! their first alarm, so the rate is alarms per throw.
//!
//! # Comparators
//! Both other rules, the paper's rule and the CUSUM, get the same throws and the same number of baseline throws as the
//! monitor; their files describe them. They have no severity, so a later wrong name does not count against them.

mod catalogue;
mod comparator;
mod coverage;
mod cusum;
mod healthy;
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
mod scatter;
mod scenario;
pub mod table1;
mod timeline;
mod trace;
mod weather;

pub use picture::picture;
pub use plan::{Amount, Outcome, Plan};
pub(crate) use report::quantile;
pub use report::{Budget, Healthy, Report, Row, Tally};
pub use scatter::Scatter;
pub use scenario::{Depth, Growth, Noise};

/// Kinds of runs; each kind has its own random streams.
mod domain {
    pub(super) const HEALTHY: u64 = 1;
    pub(super) const ROW: u64 = 2;
    pub(super) const TIMELINE: u64 = 3;
    pub(super) const BUDGET: u64 = 4;
    pub(super) const TUNING: u64 = 5;
    pub(super) const FLEET: u64 = 6;
    pub(super) const WEATHER: u64 = 7;
}
