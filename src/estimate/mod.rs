//! The estimator: from a throw to b0, a1, a0 with their covariance (SRIV in continuous time).
//!
//! "Equation (n)" in this crate is that of Dutta, Ambur, Hamadache, Olaby, Shih, Stewart, Dixon: Health monitoring of a
//! railway track switch actuator based on continuous-time parameter estimation method.
//!
//! An [`Identifier`] makes an [`Identification`] from a throw: it calls the stages in their order.
//!
//! | module | contents |
//! |---|---|
//! | `trace` | checks and repairs of the samples, and the phases of the movement |
//! | [`sriv`] | the estimation of a continuous-time model, and its covariance |
//! | `acceptance` | whether the fitted model describes the movement, and how uncertain it is |
//! | `ratios`, `current_only` | estimates from throws whose start is unusable, and from throws without a toe position |
//! | `armature`, `load` | what a throw shows of motor and load beside the coefficients |
//! | `model` | the movement that the model gives for a current |

mod acceptance;
mod armature;
mod current_only;
mod features;
mod identification;
mod identifier;
mod lanes;
mod load;
mod matrix;
mod model;
mod products;
mod ratios;
mod rejection;
mod settings;
pub mod sriv;
mod trace;

pub use features::Features;
pub use identification::{Estimate, Fit, Grade, Identification, RunningRatios};
pub use identifier::Identifier;
pub(crate) use model::modelled_position_mm;
pub use rejection::Rejection;
pub(crate) use rejection::RejectionCode;
pub use settings::{Motor, Settings};
pub use sriv::covariance::Noise;
pub use sriv::filter::Hold;
pub(crate) use trace::{completeness::LONGEST_STALL_S, samples::SD_PER_MEDIAN};
