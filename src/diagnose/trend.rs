//! When a drift reaches its next limit.

use serde::{Deserialize, Serialize};

/// Throws until a limit is reached, with an interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LimitForecast {
    /// Not sooner than this, 95 %.
    pub low: f64,
    /// Best guess.
    pub mid: f64,
    /// Not later than this, 95 %.
    pub high: f64,
}
