//! Errors of the simulated logger.

use crate::{
    bus::BusError,
    throw::{InvalidTrace, MachineId, OutOfRange},
};

/// An error that ends the publishing of throws.
#[derive(Debug, thiserror::Error)]
pub enum LoggerError {
    /// A parameter of the simulated fleet is out of its range.
    #[error("the simulated fleet: {0}")]
    Simulation(#[from] OutOfRange),
    /// Zenoh refused an action.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// No daemon subscribes to the throws of a machine.
    #[error("no daemon subscribes to the throws of {0}")]
    NoSubscriber(MachineId),
    /// A sample of a prepared trace is out of range.
    #[error("the prepared trace: {0}")]
    Trace(#[from] InvalidTrace),
    /// The operating system did not start a thread.
    #[error("cannot start the thread {thread}: {source}")]
    Spawn {
        /// Name of the thread.
        thread: &'static str,
        /// Error of the system.
        source: std::io::Error,
    },
    /// The publishing thread ended without a result.
    #[error("the publishing thread died")]
    Thread,
}
