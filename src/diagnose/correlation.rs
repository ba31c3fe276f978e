//! The paper's cross-correlation of the three inertia estimates.

use serde::{Deserialize, Serialize};

/// The paper's cross-correlation of the three inertia estimates, pairwise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// Between J from b0 and J from a1.
    pub b0_a1: f64,
    /// Between J from b0 and J from a0.
    pub b0_a0: f64,
    /// Between J from a1 and J from a0.
    pub a1_a0: f64,
}
