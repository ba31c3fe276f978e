//! The effect of temperature on the coefficients of a direction, learned from the baseline and from later throws.
//!
//! In logarithms x = centre + level + f(T - reference), with f(d) = k d + c d²/2. A baseline rarely spans a year, so it
//! hardly determines f. Later throws improve f when they leave the longest window. The centre does not change, so at
//! the reference temperature a drift stays visible; elsewhere f can hide [`MOST_PER_K`] times the distance at most. The
//! covariance of every window contains the uncertainty of f there.
//!
//! A fault changes a coefficient for good and must not count as an effect of the temperature. Therefore the model has a
//! level, which is estimated with f by a Kalman filter (Kalman 1960) and wanders: it takes a slow change that the
//! temperature does not explain day by day. When a drift is suspected, has an alarm or ends, the level may have changed
//! by any amount. What was learned at other temperatures stays, so a fault that grows as the temperature rises cannot
//! pass for a curve that the physics of grease excludes.

use std::mem;

use nalgebra::{Matrix3, RowVector3, Vector3};
use serde::{Deserialize, Serialize};

use crate::diagnose::{
    Settings,
    statistics::{LONGEST_WINDOW, Scatter, Sym3, is_default, median, serial_inflation},
};

/// Source of the temperature coefficients of a baseline.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TemperatureSource {
    /// No compensation: no coefficients are configured, and the temperature span is too small for a fit.
    #[default]
    None,
    /// Configured coefficients.
    Configured,
    /// Coefficients fitted to the throws of the machine.
    Fitted,
}

/// Slopes of ln b0, ln a1, ln a0 by magnets, grease and rails \[per K\]: standard deviation between machines.
const TYPICAL_PER_K: [f64; 3] = [0.002, 0.01, 0.002];
/// Change of these slopes \[per K²\]: standard deviation between machines. Friction A + B exp(-k T) has the curve
/// k² p (1 - p), where p is the part of the grease in it: 0.0001 with a third of grease that loses 2 % per K.
const TYPICAL_CURVE: [f64; 3] = [5e-6, 1e-4, 5e-6];
/// Largest physically possible slopes \[per K\]: magnets lose 0.2 %/K, grease becomes three times as thick over 40 K.
const MOST_PER_K: [f64; 3] = [0.005, 0.025, 0.005];
/// Wandering of the level per throw, in standard deviations of a throw. In simulated seasons, 0.05 named no more of the
/// faults that grow with the temperature, and more healthy machines were not monitored.
const WANDERS_SD: f64 = 0.03;
/// The same in the [`CHANGING`] throws after a drift alarm: the drift may grow.
const GROWS_SD: f64 = 0.3;
/// Throws of a direction within which a drift grows. If the level wandered longer, a lasting fault would make the
/// dependence on the temperature unknown.
const CHANGING: u32 = 120;
/// Throws of a direction that are left out after the suspicion of a drift changed: those that leave the longest window
/// then were made before, or while the level changed.
const PAUSE: u32 = LONGEST_WINDOW + LONGEST_WINDOW / 4;
/// Standard deviation of a change of the level by the beginning or the end of a drift, in standard deviations of a
/// throw.
const STEP_SD: f64 = 5.0;
/// The same for a drift without an alarm.
const SMALL_STEP_SD: f64 = 2.0;
/// Largest residual in standard deviations. Larger ones are clipped, so that an outlier has little effect.
const CLIP_SD: f64 = 3.5;

/// Least number of throws with a temperature for a fit: the least number in a baseline. With fewer, the scatter is that
/// of all throws.
const LEAST_KNOWN: usize = 12;

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
    pub(crate) fn is_none(self) -> bool {
        self == Self::None
    }
}

/// Level, slope \[per K\] and curve \[per K²\] of a coefficient over the distance from the reference temperature.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
struct Line {
    mean: [f64; 3],
    covariance: Sym3,
}

/// Compensation of temperature: the compensated x is x - f(T - reference).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "Stored")]
pub(crate) struct Temperature {
    pub(super) source: TemperatureSource,
    /// The reference temperature \[°C\]; `None` if no throw of the baseline has a temperature.
    pub(crate) reference_c: Option<f64>,
    /// Of ln b0, ln a1 and ln a0.
    lines: [Line; 3],
    /// The suspicion of a drift at the last throw.
    #[serde(skip_serializing_if = "is_default")]
    suspicion: Suspicion,
    /// Number of next throws in which a drift may begin, grow or end.
    #[serde(skip_serializing_if = "is_default")]
    changing: u32,
    /// Whether a drift was above its limit since the level last stepped.
    #[serde(skip_serializing_if = "is_default")]
    steps: bool,
}

impl Temperature {
    /// Learns the compensation from the throws of a baseline: their logarithms, and temperatures \[°C\] if known.
    pub(crate) fn learn(throws: &[(Vector3<f64>, Option<f64>)], settings: &Settings) -> Self {
        let mut known: Vec<f64> = throws.iter().filter_map(|(_, celsius)| *celsius).collect();
        if known.is_empty() {
            return Self::default();
        }
        let reference = median(&mut known);
        let none = Self { reference_c: Some(reference), ..Self::default() };
        if let Some(t) = &settings.temperature {
            let per_k = [t.b0_pct_per_k, t.a1_pct_per_k, t.a0_pct_per_k].map(|pct| pct / 100.0);
            let lines = per_k.map(|k| Line { mean: [0.0, k, 0.0], ..Line::default() });
            return Self { source: TemperatureSource::Configured, lines, ..none };
        }
        // The first throws may be without a temperature: later ones without it have that of the throw before.
        let few = known.len() < LEAST_KNOWN;
        let with_distance = throws.iter().filter_map(|(x, celsius)| match celsius {
            None if few => Some((0.0, x)),
            celsius => Some((celsius.as_ref()? - reference, x)),
        });
        let throws_used: Vec<(f64, &Vector3<f64>)> = with_distance.collect();
        let n = throws_used.len() as f64;
        let t_mean = throws_used.iter().map(|(t, _)| t).sum::<f64>() / n;
        let x_mean = throws_used.iter().map(|(_, x)| *x).sum::<Vector3<f64>>() / n;
        let information: f64 = throws_used.iter().map(|(t, _)| (t - t_mean).powi(2)).sum();
        let together: Vector3<f64> = throws_used.iter().map(|(t, x)| (*x - x_mean) * (t - t_mean)).sum();
        let slope = together / information.max(f64::MIN_POSITIVE);
        let rest: Vec<Vector3<f64>> = throws_used.iter().map(|(t, x)| *x - x_mean - slope * (t - t_mean)).collect();
        let square: Vector3<f64> = rest.iter().map(|r| r.component_mul(r)).sum();
        let lagged: Vector3<f64> = rest.iter().zip(&rest[1..]).map(|(a, b)| a.component_mul(b)).sum();
        let variance = square / (n - 2.0).max(1.0);
        let lag1 = |i: usize| lagged[i] / square[i].max(f64::MIN_POSITIVE) + 2.0 / n;
        let noise = Vector3::from_fn(|i, _| variance[i] * serial_inflation(lag1(i)));
        let spans = known[known.len() - 1] - known[0] >= settings.temperature_span_k;
        let is_fitted = spans && !few && throws.len() >= settings.baseline_throws;
        let lines = std::array::from_fn(|i| {
            let mut line = Line::unknown(i, noise[i]);
            for (t, x) in &throws_used {
                line.follow(WANDERS_SD * WANDERS_SD * variance[i], *t, x[i] - x_mean[i], noise[i]);
            }
            line.set_level(noise[i] / n);
            if is_fitted { line } else { line.without_slope() }
        });
        let source = if is_fitted { TemperatureSource::Fitted } else { TemperatureSource::None };
        Self { source, lines, ..none }
    }

    /// Updates the compensation with a throw. `raw`: residual without compensation; `distance`: temperature from the
    /// reference \[K\]; `suspicion`: of a drift in the last throws; `scatter`: of the machine.
    pub(crate) fn learn_on(&mut self, raw: Vector3<f64>, distance: f64, suspicion: Suspicion, scatter: &Scatter) {
        if self.source == TemperatureSource::Configured || self.reference_c.is_none() {
            return;
        }
        let (variance, noise) = (scatter.of_one_throw().diagonal(), noise(scatter));
        if suspicion != self.suspicion {
            self.steps |= suspicion == Suspicion::Alarmed || self.suspicion == Suspicion::Alarmed;
            // A suspicion that ends without an alarm was chance.
            self.changing = if suspicion.is_none() && !self.steps { 0 } else { PAUSE + CHANGING };
            self.suspicion = suspicion;
        }
        self.changing = self.changing.saturating_sub(1);
        if self.changing > CHANGING {
            return;
        }
        if self.changing == CHANGING {
            let step_sd = if mem::take(&mut self.steps) { STEP_SD } else { SMALL_STEP_SD };
            self.lines.iter_mut().zip(&variance).for_each(|(line, variance)| line.step(step_sd * step_sd * variance));
        }
        let may_grow = self.changing > 0 && suspicion == Suspicion::Alarmed;
        let wanders_sd = if may_grow { GROWS_SD } else { WANDERS_SD };
        for (i, line) in self.lines.iter_mut().enumerate() {
            line.follow(wanders_sd * wanders_sd * variance[i], distance, raw[i], noise[i]);
        }
        self.source = TemperatureSource::Fitted;
    }

    /// Slopes at the reference temperature \[per K\].
    pub(super) fn per_k(&self) -> [f64; 3] {
        std::array::from_fn(|i| self.lines[i].mean[1].clamp(-MOST_PER_K[i], MOST_PER_K[i]))
    }

    /// Temperature from the reference \[K\]; 0 if one of the two is unknown.
    pub(crate) fn distance(&self, celsius: Option<f64>) -> f64 {
        celsius.zip(self.reference_c).map_or(0.0, |(now, reference)| now - reference)
    }

    /// Change of the logarithms at a temperature `distance` \[K\] from the reference.
    pub(crate) fn effect(&self, distance: f64) -> Vector3<f64> {
        let is_configured = self.source == TemperatureSource::Configured;
        Vector3::from_fn(|i, _| {
            let most = if is_configured { f64::INFINITY } else { MOST_PER_K[i] * distance.abs() };
            self.lines[i].effect(distance).clamp(-most, most)
        })
    }

    /// Standard deviation of [`Self::effect`], negative below the reference: the errors of both directions have the
    /// same sign then, as both have the same weather.
    pub(crate) fn effect_sd(&self, distance: f64) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.lines[i].effect_sd(distance).copysign(distance))
    }
}

impl Line {
    /// Nothing is known but the variety of machines; `noise`: variance of one throw.
    fn unknown(coefficient: usize, noise: f64) -> Self {
        if noise == 0.0 {
            // b0 of a baseline of ratios, which does not change.
            return Self::default();
        }
        let known = [1.0, TYPICAL_PER_K[coefficient], TYPICAL_CURVE[coefficient]];
        Self { covariance: Matrix3::from_diagonal(&Vector3::from(known).map(|sd| sd * sd)).into(), ..Self::default() }
    }

    /// A step of the level with this variance.
    fn step(&mut self, variance: f64) {
        let mut covariance = Matrix3::from(self.covariance);
        covariance[(0, 0)] += variance;
        self.covariance = covariance.into();
    }

    /// Prediction and update of the Kalman filter: the level wanders by a variance `wanders`, then `value` is measured
    /// at `distance` \[K\] from the reference, with variance `noise`.
    fn follow(&mut self, wanders: f64, distance: f64, value: f64, noise: f64) {
        self.step(wanders);
        let (mean, covariance) = (Vector3::from(self.mean), Matrix3::from(self.covariance));
        let h = Vector3::new(1.0, distance, 0.5 * distance * distance);
        let gain = covariance * h;
        let variance = h.dot(&gain) + noise;
        if variance <= 0.0 {
            return;
        }
        let reach = CLIP_SD * variance.sqrt();
        let innovation = (value - h.dot(&mean)).clamp(-reach, reach);
        self.mean = (mean + gain * (innovation / variance)).into();
        self.covariance = (covariance - gain * gain.transpose() / variance).into();
    }

    /// Counts the level from the centre of the baseline, known with this variance.
    fn set_level(&mut self, variance: f64) {
        let mut covariance = Matrix3::from(self.covariance);
        covariance.set_row(0, &RowVector3::zeros());
        covariance.set_column(0, &Vector3::new(variance, 0.0, 0.0));
        (self.mean[0], self.covariance) = (0.0, covariance.into());
    }

    /// The line without compensation: its slope and curve count as uncertainty.
    fn without_slope(self) -> Self {
        let [_, slope, curve] = self.mean;
        let unused = Matrix3::from_diagonal(&Vector3::new(0.0, slope * slope, curve * curve));
        Self { mean: [0.0; 3], covariance: (Matrix3::from(self.covariance) + unused).into() }
    }

    fn effect(&self, distance: f64) -> f64 {
        distance * (self.mean[1] + 0.5 * distance * self.mean[2])
    }

    fn effect_sd(&self, distance: f64) -> f64 {
        let h = Vector3::new(0.0, distance, 0.5 * distance * distance);
        h.dot(&(Matrix3::from(self.covariance) * h)).max(0.0).sqrt()
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

/// The compensation in a snapshot. Those of earlier versions have slopes with variances instead of lines, and the level
/// is unknown.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Stored {
    source: TemperatureSource,
    reference_c: Option<f64>,
    lines: Option<[Line; 3]>,
    suspicion: Suspicion,
    changing: u32,
    steps: bool,
    per_k: [f64; 3],
    per_k_variance: [f64; 3],
}

impl From<Stored> for Temperature {
    fn from(stored: Stored) -> Self {
        let Stored { source, reference_c, lines, suspicion, changing, steps, per_k, per_k_variance } = stored;
        let of_slope = |i: usize| {
            let curve_sd = if per_k_variance[i] > 0.0 { TYPICAL_CURVE[i] } else { 0.0 };
            let variances = Vector3::new(0.0, per_k_variance[i], curve_sd * curve_sd);
            Line { mean: [0.0, per_k[i], 0.0], covariance: Matrix3::from_diagonal(&variances).into() }
        };
        let (lines, changing, steps) = lines
            .map_or_else(|| (std::array::from_fn(of_slope), PAUSE + CHANGING, true), |lines| (lines, changing, steps));
        Self { source, reference_c, lines, suspicion, changing, steps }
    }
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

    /// The sensor began later than the logger, or was read again only after the first throws of a new baseline.
    #[test]
    fn first_throws_without_a_temperature_leave_its_effect_known_or_stated() {
        let celsius = |k: usize| f64::from(u32::try_from(k % 16).unwrap()) - 4.0;
        let logs: [_; 60] = std::array::from_fn(|k| {
            let scatter = 1e-3 * ((7 * k) % 13) as f64;
            Vector3::new(scatter, scatter - 0.01 * celsius(k), scatter)
        });
        let learn = |without: usize| {
            let throws: [_; 60] = std::array::from_fn(|k| (logs[k], (k >= without).then(|| celsius(k))));
            Temperature::learn(&throws, &Settings::default())
        };
        for without in [0, 1, 30] {
            let temperature = learn(without);
            let (effect, sd) = (temperature.effect(30.0).y, temperature.effect_sd(30.0));
            assert!((effect + 0.3).abs() < 2.0 * sd.y && sd.y < 0.15 && sd.min() > 0.0, "{without}: {effect} {sd:?}");
        }
        for without in [50, 58, 59] {
            let temperature = learn(without);
            assert_eq!(temperature.source, TemperatureSource::None, "{without}");
            assert!(temperature.effect_sd(30.0).y > 0.2, "{without}: {:?}", temperature.effect_sd(30.0));
        }
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
