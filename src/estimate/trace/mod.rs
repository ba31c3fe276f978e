//! The samples of a throw: checks, repairs, and the phases of the movement, before a model is estimated.

pub(super) mod completeness;
pub(super) mod damage;
pub(super) mod decimate;
pub(super) mod held;
pub(super) mod hum;
pub(super) mod missing;
pub(super) mod movement;
pub(super) mod noise;
pub(super) mod release;
pub(super) mod samples;
pub(super) mod window;
