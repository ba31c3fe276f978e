//! From one throw to b0, a1, a0 with their covariance (SRIV, continuous time).

mod checks;
mod covariance;
mod decimate;
mod features;
mod filter;
mod identifier;
mod movement;
mod pass;
mod refined;
mod rejection;
mod release;
mod settings;
mod small;
pub mod sriv;

pub use covariance::Noise;
pub use features::Features;
pub use filter::Hold;
pub use identifier::{Estimate, Identification, Identifier};
pub use refined::Refined;
pub use rejection::{Channel, Rejection};
pub use settings::{Motor, Settings};
