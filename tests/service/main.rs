//! The real programs over loopback: daemon, logger, operators, foreign clients.

mod configuration;
mod operators;
mod python;
mod rig;
mod throws;
