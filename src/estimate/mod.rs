//! The estimator: from a throw to b0, a1, a0 with their covariance (SRIV in continuous time).

mod acceptance;
mod armature;
mod brake;
mod course;
mod covariance;
mod current_only;
mod damage;
mod decimate;
mod features;
mod filter;
mod hum;
mod identification;
mod identifier;
mod lateness;
mod missing;
mod movement;
mod noise;
mod pass;
mod polynomial;
mod problem;
mod ratios;
mod refined;
mod rejection;
mod release;
mod settings;
mod small;
pub mod sriv;
mod start;
mod window;

pub use covariance::Noise;
pub use features::Features;
pub use filter::Hold;
pub use identification::{Estimate, Grade, Identification};
pub use identifier::Identifier;
pub use rejection::{Channel, Rejection};
pub use settings::{Motor, Settings};
