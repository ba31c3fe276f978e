//! What is normal for one machine and direction.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::throw::Direction;

/// Where the temperature coefficients of a baseline come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TemperatureSource {
    /// No compensation: no coefficients configured, and the baseline's temperatures do not allow a fit.
    None,
    /// From the configuration.
    Configured,
    /// Fitted to the baseline's throws.
    Fitted,
}

/// A baseline as it is kept in history: what was normal for one machine and direction, from when on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BaselineRecord {
    /// The direction.
    pub direction: Direction,
    /// Start of the last throw that it is made of.
    pub taken_at: Timestamp,
    /// Throws that it is made of.
    pub throws: usize,
    /// Whether it is complete; before, it is usable with wider limits and will be replaced.
    pub complete: bool,
    /// Centre of b0, a1, a0, in their units.
    pub center: [f64; 3],
    /// Throw-to-throw covariance of (ln b0, ln a1, ln a0).
    pub log_covariance: [[f64; 3]; 3],
    /// Lag-1 correlation from throw to throw of each coefficient's natural scatter.
    pub lag1: [f64; 3],
    /// Where the temperature coefficients come from.
    pub temperature_source: TemperatureSource,
    /// Change of the coefficients with temperature \[% per K\]; zero without compensation.
    pub temperature_pct_per_k: [f64; 3],
    /// Temperature to which the centre belongs \[°C\], where it was measured.
    pub reference_c: Option<f64>,
    /// Centre of the throws' duration \[s\], where it was measured.
    pub duration_s: Option<f64>,
}
