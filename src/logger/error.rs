//! Errors of the simulated logger.

use crate::{
    bus::BusError,
    throw::{InvalidTrace, OutOfRange},
};

/// An error that ends the publishing of throws.
#[derive(Debug, thiserror::Error)]
pub enum LoggerError {
    /// A parameter of the simulated fleet is out of its range.
    #[error("the simulated fleet: {0}")]
    Simulation(#[from] OutOfRange),
    /// Zenoh refused a session, a token or a query.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Zenoh refused a publisher, a queryable or a publication.
    #[error("zenoh: {0}")]
    Zenoh(#[from] zenoh::Error),
    /// A sample of a prepared trace is out of range.
    #[error("the prepared trace: {0}")]
    Trace(#[from] InvalidTrace),
    /// The operating system did not start a thread.
    #[error("cannot start the publishing thread: {0}")]
    Spawn(#[from] std::io::Error),
    /// The publishing thread ended without a result.
    #[error("the publishing thread died")]
    Thread,
}
