//! The errors of a logger.

use crate::{
    bus::BusError,
    throw::{InvalidTrace, OutOfRange},
};

/// An error that keeps a logger from publishing throws.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum LoggerError {
    #[error("the simulated fleet: {0}")]
    Simulation(#[from] OutOfRange),
    #[error(transparent)]
    Bus(#[from] BusError),
    #[error("zenoh: {0}")]
    Zenoh(#[from] zenoh::Error),
    #[error("the prepared trace: {0}")]
    Trace(#[from] InvalidTrace),
    #[error("cannot start the publishing thread: {0}")]
    Spawn(#[from] std::io::Error),
    #[error("the publishing thread died")]
    Thread,
}
