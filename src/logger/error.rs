//! Why a logger cannot publish.

use crate::{bus::BusError, throw::OutOfRange};

/// Why throws cannot be published.
#[derive(Debug, thiserror::Error)]
pub enum LoggerError {
    /// The simulated machine cannot be built or moved.
    #[error("the simulated fleet: {0}")]
    Simulation(#[from] OutOfRange),
    /// Zenoh cannot be used.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Zenoh refused something.
    #[error("zenoh: {0}")]
    Zenoh(#[from] zenoh::Error),
    /// The system gives no thread.
    #[error("the system gives no thread to publish from: {0}")]
    Spawn(#[from] std::io::Error),
    /// The publishing thread died.
    #[error("the publishing thread died")]
    Thread,
}
