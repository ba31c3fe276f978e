//! The effect of temperature on the coefficients of a direction, learned from the baseline and from later throws.
//!
//! In logarithms x = centre + k (T - reference). A baseline rarely spans a year, so it hardly determines the slope k.
//! Later throws improve k when they leave the longest window. The centre does not change, so at the reference
//! temperature a drift stays visible; elsewhere k can hide [`MOST_PER_K`] at most. The dependence is a curve and k is
//! its present slope, so old throws lose weight, within [`MEMORY`] throws. The covariance of every window contains the
//! uncertainty of k, times the distance from the reference.
//!
//! A fault changes a coefficient for good and must not count as an effect of the temperature. So the model contains a
//! level too, and the slope comes from the changes since an [`Anchor`]: the centre, or throws of a suspected drift. When
//! a drift is suspected, has an alarm or ends, the level may have changed, and a new anchor is taken.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::diagnose::{
    Settings,
    statistics::{LONGEST_WINDOW, Scatter, median, serial_inflation},
};

/// Source of the temperature coefficients of a baseline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TemperatureSource {
    /// No compensation: no coefficients are configured, and the temperature span is too small for a fit.
    None,
    /// Configured coefficients.
    Configured,
    /// Coefficients fitted to the throws of the machine.
    Fitted,
}

/// Slopes of ln b0, ln a1, ln a0 by magnets, grease and rails \[per K\]: standard deviation between machines.
const TYPICAL_PER_K: [f64; 3] = [0.002, 0.01, 0.002];
/// Largest physically possible slopes \[per K\]: magnets lose 0.2 %/K, grease becomes three times as thick over 40 K.
const MOST_PER_K: [f64; 3] = [0.005, 0.025, 0.005];
/// Throws of a direction after which an old throw has lost its weight: about a month, which is less than a season.
const MEMORY: f64 = 250.0;
/// Throws of a direction over which the usual temperature is a mean: some days.
const USUAL: f64 = 48.0;
/// Least distance from the usual temperature of a throw that counts fully \[K\]. A throw at the usual temperature says
/// nothing about the slope: what changes there is the machine, and counting it would hide a slow fault.
const COUNTS_FROM_K: f64 = 10.0;
/// Largest residual in standard deviations. Larger ones are clipped, so that an outlier has little effect.
const CLIP_SD: f64 = 3.5;

/// Throws of a suspected drift that determine its anchor. The same number of throws before them is left out: those
/// leave the longest window after the suspicion changed, but were made before.
const ANCHORED: u32 = LONGEST_WINDOW;
/// Change of the level since the anchor that counts as another lasting change, in standard deviations of the anchor.
const LEVEL_SD: f64 = 4.0;

/// Whether the last throws show a drift, which must not be learned as normal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Suspicion {
    /// No suspicion.
    #[default]
    None,
    /// The last throws may show a drift.
    Suspected,
    /// The last throws show a drift above its limit; its name is not stable yet.
    AboveLimit,
    /// A drift has an active alarm.
    Alarmed,
}

impl Suspicion {
    /// Whether nothing is suspected.
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
    pub(crate) fn is_none(&self) -> bool {
        *self == Self::None
    }
}

/// A known point of the line over the temperature, and sums over the throws since.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Anchor {
    /// Number of throws that determine the point; `None`, as by default, for the centre of the baseline.
    throws: Option<u32>,
    /// Mean distance of these throws from the reference \[K\].
    distance: f64,
    /// Mean residual of these throws.
    residual: [f64; 3],
    /// Number of later throws, with old ones weighted less.
    later: f64,
    /// Sum of the distances of the later throws from the point \[K\].
    distances: f64,
    /// Sum of their residuals, less that of the point.
    residuals: [f64; 3],
}

/// Compensation of temperature: the compensated x is x - `per_k` (T - reference).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Temperature {
    pub(super) source: TemperatureSource,
    /// Slopes of ln b0, ln a1, ln a0 \[per K\].
    pub(crate) per_k: [f64; 3],
    per_k_variance: [f64; 3],
    /// The reference temperature \[°C\]; `None` if no throw of the baseline has a temperature.
    pub(crate) reference_c: Option<f64>,
    /// Sum of squared distances from the anchor \[K²\].
    information: f64,
    /// Sum of distances from the anchor times residuals \[K\].
    product: [f64; 3],
    /// Number of throws in the baseline. Early snapshots do not contain it: the usual number.
    throws: f64,
    anchor: Anchor,
    /// Distance of the usual temperature of the learned throws from the reference \[K\].
    usual: f64,
    /// The suspicion of a drift at the last throw.
    #[serde(skip_serializing_if = "Suspicion::is_none")]
    suspicion: Suspicion,
    /// Throws since the suspicion changed, and the anchor from the second half of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    next: Option<Box<(u32, Anchor)>>,
}

impl Default for Temperature {
    /// No compensation.
    fn default() -> Self {
        Self {
            source: TemperatureSource::None,
            per_k: [0.0; 3],
            per_k_variance: [0.0; 3],
            reference_c: None,
            information: 0.0,
            product: [0.0; 3],
            throws: 50.0,
            anchor: Anchor::default(),
            usual: 0.0,
            suspicion: Suspicion::None,
            next: None,
        }
    }
}

impl Temperature {
    /// Learns the compensation from the throws of a baseline: their logarithms, and temperatures \[°C\] if known.
    pub(crate) fn learn(throws: &[(Vector3<f64>, Option<f64>)], settings: &Settings) -> Self {
        let mut known: Vec<f64> = throws.iter().filter_map(|(_, celsius)| *celsius).collect();
        if known.is_empty() {
            return Self::default();
        }
        let reference = median(&mut known);
        let none = Self { reference_c: Some(reference), throws: throws.len() as f64, ..Self::default() };
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
        if spans && throws.len() >= settings.baseline_throws {
            fitted.solve(noise);
        } else {
            // The unused slopes count as uncertainty.
            let (slope, variance) = fitted.posterior(noise);
            fitted.per_k_variance = std::array::from_fn(|i| variance[i] + slope[i].powi(2));
        }
        fitted
    }

    /// Adds the sums of a fitted slope, which snapshots of version 1 do not contain.
    pub(crate) fn add_sums(&mut self, scatter: &Scatter) {
        if self.source == TemperatureSource::Fitted {
            self.information = noise(scatter)[1] / self.per_k_variance[1].max(f64::MIN_POSITIVE);
            self.product = self.per_k.map(|k| k * self.information);
        }
    }

    /// Updates the compensation with a throw. `raw`: residual without compensation; `distance`: temperature from the
    /// reference \[K\]; `suspicion`: of a drift in the last throws; `scatter`: of the machine.
    pub(crate) fn learn_on(&mut self, raw: Vector3<f64>, distance: f64, suspicion: Suspicion, scatter: &Scatter) {
        if self.source == TemperatureSource::Configured || self.reference_c.is_none() {
            return;
        }
        let (variance, noise) = (scatter.of_one_throw().diagonal(), noise(scatter));
        if suspicion != self.suspicion {
            self.suspicion = suspicion;
            // A suspicion that ends before it has an anchor was chance.
            let is_chance = suspicion.is_none() && self.anchor.throws.is_none();
            self.next = (!is_chance).then(Box::default);
        }
        if self.is_moving(&raw, distance) {
            return;
        }
        let (slope, _) = self.posterior(noise);
        let origin = Vector3::from(self.anchor.residual) + self.change(slope);
        let from_anchor = distance - self.anchor.distance;
        let expected = origin + Vector3::from(slope) * from_anchor;
        let reach = variance.map(|v| CLIP_SD * v.sqrt())
            + Vector3::from(self.per_k_variance).map(|v| CLIP_SD * v.sqrt() * distance.abs());
        let rest = raw - expected;
        let clipped = expected + Vector3::from_fn(|i, _| rest[i].clamp(-reach[i], reach[i]));
        let weight = ((distance - self.usual) / COUNTS_FROM_K).powi(2).min(1.0);
        self.usual += (distance - self.usual) / USUAL;
        let keep = 1.0 - weight / MEMORY;
        let anchor = &mut self.anchor;
        anchor.later = keep * anchor.later + weight;
        anchor.distances = keep * anchor.distances + weight * from_anchor;
        self.information = keep * self.information + weight * from_anchor * from_anchor;
        for i in 0..3 {
            let residual = clipped[i] - anchor.residual[i];
            anchor.residuals[i] = keep * anchor.residuals[i] + weight * residual;
            self.product[i] = keep * self.product[i] + weight * from_anchor * residual;
        }
        self.solve(noise);
        let change = self.change(self.per_k);
        if !suspicion.is_none() && (0..3).any(|i| change[i].abs() > LEVEL_SD * (noise[i] / self.anchor_throws()).sqrt())
        {
            // Another fault, or the repair of a part.
            self.next = Some(Box::new((ANCHORED, Anchor::default())));
        }
    }

    /// Adds a throw to the next anchor. Returns whether the throw was used for this, or left out. Without a suspicion,
    /// the next anchor is the centre of the baseline.
    fn is_moving(&mut self, raw: &Vector3<f64>, distance: f64) -> bool {
        let Some((throws, next)) = self.next.as_deref_mut() else { return false };
        *throws += 1;
        if *throws == ANCHORED && self.suspicion.is_none() {
            self.next = None;
            self.move_anchor(Anchor::default());
            return true;
        }
        if *throws > ANCHORED {
            let count = f64::from(*throws - ANCHORED);
            next.distance += (distance - next.distance) / count;
            next.residual = std::array::from_fn(|i| next.residual[i] + (raw[i] - next.residual[i]) / count);
        }
        if *throws == 2 * ANCHORED {
            let next = Anchor { throws: Some(ANCHORED), ..next.clone() };
            self.move_anchor(next);
            self.next = None;
        }
        true
    }

    /// Replaces the anchor; keeps the information of the throws about the slopes.
    fn move_anchor(&mut self, to: Anchor) {
        (self.information, self.product) = self.sums();
        self.anchor = to;
    }

    fn anchor_throws(&self) -> f64 {
        self.anchor.throws.map_or(self.throws, f64::from)
    }

    /// Change of the level since the anchor, for given slopes.
    fn change(&self, slope: [f64; 3]) -> Vector3<f64> {
        let Anchor { later, distances, residuals, .. } = &self.anchor;
        Vector3::from_fn(|i, _| (residuals[i] - slope[i] * distances) / (self.anchor_throws() + later))
    }

    /// Sum of squared distances \[K²\] and sums of distances times residuals \[K\], about the present level.
    fn sums(&self) -> (f64, [f64; 3]) {
        let Anchor { later, distances, residuals, .. } = &self.anchor;
        let mean = distances / (self.anchor_throws() + later);
        (self.information - mean * distances, std::array::from_fn(|i| self.product[i] - mean * residuals[i]))
    }

    /// Slopes and their variances, with a prior around zero. `noise`: variance of one throw with serial correlation.
    fn posterior(&self, noise: Vector3<f64>) -> ([f64; 3], [f64; 3]) {
        let (information, product) = self.sums();
        // The sum is 0 for b0 of ratios, which has no noise, at a constant temperature.
        let total = |i: usize| (information + noise[i] / TYPICAL_PER_K[i].powi(2)).max(f64::MIN_POSITIVE);
        let slope = |i: usize| (product[i] / total(i)).clamp(-MOST_PER_K[i], MOST_PER_K[i]);
        let variance = |i: usize| noise[i] / total(i);
        (std::array::from_fn(slope), std::array::from_fn(variance))
    }

    /// Computes the slopes.
    fn solve(&mut self, noise: Vector3<f64>) {
        let (slope, variance) = self.posterior(noise);
        (self.source, self.per_k, self.per_k_variance) = (TemperatureSource::Fitted, slope, variance);
    }

    /// Temperature from the reference \[K\]; 0 if one of the two is unknown.
    pub(crate) fn distance(&self, celsius: Option<f64>) -> f64 {
        celsius.zip(self.reference_c).map_or(0.0, |(now, reference)| now - reference)
    }

    /// Change of the logarithms at a temperature `distance` \[K\] from the reference.
    pub(crate) fn effect(&self, distance: f64) -> Vector3<f64> {
        Vector3::from(self.per_k) * distance
    }

    /// Standard deviation of [`Self::effect`], negative below the reference: the errors of both directions have the
    /// same sign then, as both have the same weather.
    pub(crate) fn effect_sd(&self, distance: f64) -> Vector3<f64> {
        Vector3::from(self.per_k_variance).map(f64::sqrt) * distance
    }
}

/// Variance of ln b0, ln a1, ln a0 of one throw, with serial correlation.
fn noise(scatter: &Scatter) -> Vector3<f64> {
    let variance = scatter.of_one_throw().diagonal();
    Vector3::from_fn(|i, _| variance[i] * serial_inflation(scatter.lag1[i]))
}

/// Covariance of a mean of throws by the temperature, from the standard deviation of its effect.
pub(crate) fn covariance_of_effect(sd: Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_diagonal(&sd.component_mul(&sd))
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;

    /// Throws at one temperature say nothing about the slopes, however many there are.
    #[test]
    fn throws_at_one_temperature_leave_the_slopes_unknown() {
        let logs: [_; 60] = std::array::from_fn(|k| Vector3::repeat(1e-3 * ((7 * k) % 13) as f64));
        let throws = logs.map(|log| (log, Some(20.0)));
        let mut temperature = Temperature::learn(&throws, &Settings::default());
        let before = temperature.effect_sd(10.0);
        let scatter = Scatter::learn(&logs, Matrix3::identity() * 1e-8, 1);
        for _ in 0..100 {
            temperature.learn_on(Vector3::zeros(), 0.0, Suspicion::None, &scatter);
        }
        let after = temperature.effect_sd(10.0);
        assert!(before.min() > 0.0 && (after - before).norm() < 1e-9, "{before:?} {after:?}");
    }

    /// After a season, a slow fault at a temperature that stays must not become an effect of the temperature.
    #[test]
    fn a_slow_change_at_the_usual_temperature_is_not_learned() {
        let logs: [_; 50] = std::array::from_fn(|k| Vector3::repeat(0.02 * (((7 * k) % 13) as f64 - 6.0) / 6.0));
        let mut temperature = Temperature::learn(&logs.map(|log| (log, Some(-10.0))), &Settings::default());
        let scatter = Scatter::learn(&logs, Matrix3::identity() * 1e-8, 1);
        let mut learn = |throw: u32, season_k: f64, fault: f64| {
            let distance = season_k + 4.0 * (f64::from(throw) / 10.0 * std::f64::consts::TAU).sin();
            let raw = Vector3::new(0.0, -0.008 * distance + fault, 0.0);
            temperature.learn_on(raw, distance, Suspicion::None, &scatter);
            temperature.effect(40.0).y
        };
        let after_season = (0..200).map(|throw| learn(throw, 0.2 * f64::from(throw), 0.0)).last().unwrap();
        assert!((after_season + 0.32).abs() < 0.03, "{after_season}");
        let after_fault = (200..500).map(|throw| learn(throw, 40.0, f64::from(throw - 200) / 750.0)).last().unwrap();
        assert!((after_fault - after_season).abs() < 0.06, "{after_season} {after_fault}");
    }
}
