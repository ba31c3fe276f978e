//! The estimator and the simulated machine against known answers.

mod covariance;
mod damaged;
mod emps;
mod identify;
mod machine;
mod sriv;
mod table1;
