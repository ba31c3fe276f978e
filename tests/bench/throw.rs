//! Time of one throw: identification and its peer, simulation and its reference.

#![expect(clippy::expect_used, reason = "a benchmark may stop on an error")]

mod estimator;
mod simulator;

criterion::criterion_group!(benches, estimator::estimation, simulator::simulator);
criterion::criterion_main!(benches);
