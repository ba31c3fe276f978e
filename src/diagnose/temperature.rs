//! The effect of temperature on the coefficients of a machine and direction, from the baseline and from later throws.
//!
//! In logarithms x = centre + k (T - reference). A baseline rarely spans a year, so it hardly determines k; throws that
//! leave the longest window without a suspicion improve it. The centre does not change: at the reference temperature a
//! drift stays visible, and elsewhere k can hide at most [`MOST_PER_K`]. Old throws lose weight over [`MEMORY`], as the
//! dependence is a curve and k its present slope. The uncertainty of k, times the distance from the reference, is part
//! of the covariance of every window.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{
    robust::median,
    scatter::{Scatter, serial_inflation},
    settings::Settings,
};

/// Source of the temperature coefficients of a baseline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TemperatureSource {
    /// No compensation: no configured coefficients, and too small a temperature span for a fit.
    None,
    /// From the configuration.
    Configured,
    /// Fitted to the throws of the machine.
    Fitted,
}

/// Standard deviation between machines of the change of ln b0, ln a1, ln a0 with temperature \[per K\]: magnets,
/// grease, rails.
const TYPICAL_PER_K: [f64; 3] = [0.002, 0.01, 0.002];
/// Largest physical change of the same \[per K\]: magnets lose 0.2 %/K, grease thickens threefold over 40 K.
const MOST_PER_K: [f64; 3] = [0.005, 0.025, 0.005];
/// Throws of a direction after which old ones have lost their weight: about a month of a usual machine, less than a
/// season.
const MEMORY: f64 = 250.0;
/// Largest residual in standard deviations; larger ones are clipped, so that an outlier has little effect.
const CLIP_SD: f64 = 3.5;

/// Compensation of temperature: x - `per_k` (T - reference).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Temperature {
    source: TemperatureSource,
    per_k: [f64; 3],
    per_k_variance: [f64; 3],
    reference_c: Option<f64>,
    /// Sum of squared distances from the reference \[K²\], and of distances times residuals \[K\].
    #[serde(default)]
    information: f64,
    #[serde(default)]
    product: [f64; 3],
}

impl Temperature {
    const NONE: Self = Self {
        source: TemperatureSource::None,
        per_k: [0.0; 3],
        per_k_variance: [0.0; 3],
        reference_c: None,
        information: 0.0,
        product: [0.0; 3],
    };

    /// Computes the compensation from the throws of a baseline: logarithms, and temperatures \[°C\] if known.
    pub(super) fn learn(throws: &[(Vector3<f64>, Option<f64>)], settings: &Settings) -> Self {
        let mut known: Vec<f64> = throws.iter().filter_map(|(_, celsius)| *celsius).collect();
        if known.is_empty() {
            return Self::NONE;
        }
        let reference = median(&mut known);
        let none = Self { reference_c: Some(reference), ..Self::NONE };
        if let Some(t) = &settings.temperature {
            let per_k = [t.b0_pct_per_k, t.a1_pct_per_k, t.a0_pct_per_k].map(|pct| pct / 100.0);
            return Self { source: TemperatureSource::Configured, per_k, ..none };
        }
        if known.len() < throws.len() {
            return none;
        }
        let n = throws.len() as f64;
        let t: Vec<f64> = throws.iter().map(|(_, celsius)| celsius.unwrap_or(reference) - reference).collect();
        let t_mean = t.iter().sum::<f64>() / n;
        let x_mean = throws.iter().map(|(x, _)| x).sum::<Vector3<f64>>() / n;
        let information: f64 = t.iter().map(|t| (t - t_mean).powi(2)).sum();
        let together: Vector3<f64> = t.iter().zip(throws).map(|(t, (x, _))| (x - x_mean) * (t - t_mean)).sum();
        let slope = together / information.max(f64::MIN_POSITIVE);
        let rest: Vec<Vector3<f64>> =
            t.iter().zip(throws).map(|(t, (x, _))| x - x_mean - slope * (t - t_mean)).collect();
        let noise = Vector3::from_fn(|i, _| {
            let square: f64 = rest.iter().map(|r| r[i] * r[i]).sum();
            let lagged: f64 = rest.iter().zip(&rest[1..]).map(|(a, b)| a[i] * b[i]).sum();
            let lag1 = lagged / square.max(f64::MIN_POSITIVE) + 2.0 / n;
            square / (n - 2.0).max(1.0) * serial_inflation(lag1)
        });
        let mut fitted = Self { information, product: together.into(), ..none };
        let spans = known[known.len() - 1] - known[0] >= settings.temperature_span_k;
        fitted.solve(noise, spans && throws.len() >= settings.baseline_throws);
        fitted
    }

    /// Updates the compensation with a throw: residual `raw` without compensation, `distance` \[K\] from the reference,
    /// scatter of the machine.
    pub(super) fn learn_on(&mut self, raw: Vector3<f64>, distance: f64, scatter: &Scatter) {
        if self.source == TemperatureSource::Configured || self.reference_c.is_none() {
            return;
        }
        let variance = scatter.of_one_throw().diagonal();
        let lag1 = Vector3::from(scatter.lag1());
        let noise = Vector3::from_fn(|i, _| variance[i] * serial_inflation(lag1[i]));
        if self.information == 0.0 && self.source == TemperatureSource::Fitted {
            // A snapshot of version 1 has the slope, but not its sums.
            self.information = noise[1] / self.per_k_variance[1].max(f64::MIN_POSITIVE);
            self.product = self.per_k.map(|k| k * self.information);
        }
        let expected = Vector3::from(self.posterior(noise).0) * distance;
        let reach = variance.map(|v| CLIP_SD * v.sqrt())
            + Vector3::from(self.per_k_variance).map(|v| CLIP_SD * v.sqrt() * distance.abs());
        let rest = raw - expected;
        let clipped = expected + Vector3::from_fn(|i, _| rest[i].clamp(-reach[i], reach[i]));
        let keep = 1.0 - 1.0 / MEMORY;
        self.information = keep * self.information + distance * distance;
        for i in 0..3 {
            self.product[i] = keep * self.product[i] + distance * clipped[i];
        }
        self.solve(noise, true);
    }

    /// Slopes and their variances, with a prior around zero; `noise` is the variance of one throw, with serial
    /// correlation.
    fn posterior(&self, noise: Vector3<f64>) -> ([f64; 3], [f64; 3]) {
        let prior = |i: usize| noise[i] / TYPICAL_PER_K[i].powi(2);
        let slope = |i: usize| (self.product[i] / (self.information + prior(i))).clamp(-MOST_PER_K[i], MOST_PER_K[i]);
        let variance = |i: usize| noise[i] / (self.information + prior(i)).max(f64::MIN_POSITIVE);
        (std::array::from_fn(slope), std::array::from_fn(variance))
    }

    /// Sets the slopes if there are `enough` throws; otherwise their effect counts as uncertainty.
    fn solve(&mut self, noise: Vector3<f64>, enough: bool) {
        let (slope, variance) = self.posterior(noise);
        if enough {
            (self.source, self.per_k, self.per_k_variance) = (TemperatureSource::Fitted, slope, variance);
        } else {
            self.per_k_variance = std::array::from_fn(|i| variance[i] + slope[i].powi(2));
        }
    }

    /// Distance from the reference \[K\]; 0 if one of them is unknown.
    pub(super) fn distance(&self, celsius: Option<f64>) -> f64 {
        celsius.zip(self.reference_c).map_or(0.0, |(now, reference)| now - reference)
    }

    /// Effect of the temperature at this distance \[K\] on the logarithms.
    pub(super) fn effect(&self, distance: f64) -> Vector3<f64> {
        Vector3::from(self.per_k) * distance
    }

    /// Standard deviation of [`Self::effect`], with the sign of the distance, as the weather is common to both
    /// directions.
    pub(super) fn effect_sd(&self, distance: f64) -> Vector3<f64> {
        Vector3::from(self.per_k_variance).map(f64::sqrt) * distance
    }

    pub(super) fn source(&self) -> TemperatureSource {
        self.source
    }

    pub(super) fn pct_per_k(&self) -> [f64; 3] {
        self.per_k.map(|k| 100.0 * k)
    }

    pub(super) fn reference_c(&self) -> Option<f64> {
        self.reference_c
    }
}

/// Covariance of a mean, from the standard deviation of the temperature's effect.
pub(super) fn doubt(sd: Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_diagonal(&sd.component_mul(&sd))
}
