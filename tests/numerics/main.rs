//! The estimator and the simulated machine against known answers.

mod identify;
mod machine;
mod table1;
