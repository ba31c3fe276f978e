//! What is normal for one machine and direction.

use jiff::Timestamp;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{
    Settings,
    monitor::Evaluated,
    robust::{centre_and_sd, median},
    scatter::Scatter,
    sym3::Sym3,
};
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

/// One throw that a baseline is learned from; `order` counts the machine's throws. Short names keep the state small.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Learned {
    #[serde(rename = "n")]
    order: u64,
    #[serde(rename = "x")]
    log: [f64; 3],
    #[serde(rename = "t", default, skip_serializing_if = "Option::is_none")]
    temperature_c: Option<f32>,
    #[serde(rename = "d", default, skip_serializing_if = "Option::is_none")]
    duration_s: Option<f32>,
}

/// Change of ln b0, ln a1, ln a0 with temperature \[per K\], as large as it usually is: magnets, grease, rails.
const TYPICAL_PER_K: [f64; 3] = [0.002, 0.01, 0.002];
/// Serial correlation that a fit of temperature believes in at most.
const MOST_LAG1: f64 = 0.8;

/// Compensation of temperature: x - `per_k` (T - reference).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Temperature {
    source: TemperatureSource,
    per_k: [f64; 3],
    per_k_variance: [f64; 3],
    reference_c: Option<f64>,
}

/// The baseline of one direction, in logarithms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Baseline {
    centre: [f64; 3],
    throws: usize,
    complete: bool,
    taken_at: Timestamp,
    temperature: Temperature,
    duration_s: Option<f64>,
    scatter: Scatter,
}

impl Learned {
    #[expect(clippy::cast_possible_truncation, reason = "1e-7 of a temperature or duration is far below any sensor")]
    pub(super) fn new(order: u64, throw: &Evaluated) -> Self {
        Self {
            order,
            log: throw.log,
            temperature_c: throw.temperature_c.map(|t| t as f32),
            duration_s: throw.duration_s.map(|d| d as f32),
        }
    }
}

impl Temperature {
    fn learn(throws: &[Learned], settings: &Settings) -> Self {
        let mut known: Vec<f64> = throws.iter().filter_map(|t| t.temperature_c.map(f64::from)).collect();
        let none =
            Self { source: TemperatureSource::None, per_k: [0.0; 3], per_k_variance: [0.0; 3], reference_c: None };
        if known.is_empty() {
            return none;
        }
        let reference = median(&mut known);
        let none = Self { reference_c: Some(reference), ..none };
        if let Some(t) = &settings.temperature {
            let per_k = [t.b0_pct_per_k, t.a1_pct_per_k, t.a0_pct_per_k].map(|pct| pct / 100.0);
            return Self { source: TemperatureSource::Configured, per_k, ..none };
        }
        if known.len() < throws.len() {
            return none;
        }
        let spans = known[known.len() - 1] - known[0] >= settings.temperature_span_k;
        let fitted = Self::fit(throws, reference);
        if spans && throws.len() >= settings.baseline_throws {
            return fitted;
        }
        // Not compensated: what the fit would take out counts as doubt instead.
        let doubt = |i: usize| fitted.per_k_variance[i] + fitted.per_k[i].powi(2);
        Self { per_k_variance: [doubt(0), doubt(1), doubt(2)], ..none }
    }

    /// Least squares of each logarithm on temperature, drawn to zero by what such slopes are at most. The variance of
    /// the slope counts that scatter is serially correlated, and so slow as the weather itself.
    fn fit(throws: &[Learned], reference: f64) -> Self {
        let n = throws.len() as f64;
        let t: Vec<f64> = throws.iter().map(|l| l.temperature_c.map_or(0.0, |c| f64::from(c) - reference)).collect();
        let t_mean = t.iter().sum::<f64>() / n;
        let t_square: f64 = t.iter().map(|v| (v - t_mean).powi(2)).sum();
        let mut per_k = [0.0; 3];
        let mut per_k_variance = [0.0; 3];
        for i in 0..3 {
            let x: Vec<f64> = throws.iter().map(|l| l.log[i]).collect();
            let x_mean = x.iter().sum::<f64>() / n;
            let together: f64 = t.iter().zip(&x).map(|(t, x)| (t - t_mean) * (x - x_mean)).sum();
            let slope = together / t_square.max(f64::MIN_POSITIVE);
            let rest: Vec<f64> = t.iter().zip(&x).map(|(t, x)| x - x_mean - slope * (t - t_mean)).collect();
            let square: f64 = rest.iter().map(|r| r * r).sum();
            let lagged: f64 = rest.iter().zip(&rest[1..]).map(|(a, b)| a * b).sum();
            let lag1 = (lagged / square.max(f64::MIN_POSITIVE) + 2.0 / n).clamp(0.0, MOST_LAG1);
            let noise = square / (n - 2.0) * (1.0 + lag1) / (1.0 - lag1);
            let prior = TYPICAL_PER_K[i].powi(-2);
            let information = t_square / noise.max(f64::MIN_POSITIVE);
            per_k[i] = slope * information / (information + prior);
            per_k_variance[i] = (information + prior).recip();
        }
        Self { source: TemperatureSource::Fitted, per_k, per_k_variance, reference_c: Some(reference) }
    }

    /// Distance from the reference \[K\]; zero where either is unknown.
    fn distance(&self, temperature_c: Option<f64>) -> f64 {
        temperature_c.zip(self.reference_c).map_or(0.0, |(now, reference)| now - reference)
    }
}

impl Baseline {
    /// Learns from at least a dozen throws of one direction, whose estimates have the mean covariance `sensor`.
    pub(super) fn learn(throws: &[Learned], sensor: Sym3, taken_at: Timestamp, settings: &Settings) -> Self {
        let temperature = Temperature::learn(throws, settings);
        let logs: Vec<Vector3<f64>> = throws
            .iter()
            .map(|l| {
                Vector3::from(l.log)
                    - Vector3::from(temperature.per_k) * temperature.distance(l.temperature_c.map(f64::from))
            })
            .collect();
        let robust = [0, 1, 2].map(|i| centre_and_sd(&logs.iter().map(|x| x[i]).collect::<Vec<_>>()));
        let centre = robust.map(|(centre, _)| centre);
        let residuals: Vec<Vector3<f64>> = logs.iter().map(|x| clip(x - Vector3::from(centre), robust)).collect();
        let mut durations: Vec<f64> = throws.iter().filter_map(|l| l.duration_s.map(f64::from)).collect();
        Self {
            centre,
            throws: throws.len(),
            complete: throws.len() >= settings.baseline_throws,
            taken_at,
            temperature,
            duration_s: (!durations.is_empty()).then(|| median(&mut durations)),
            scatter: Scatter::learn(&residuals, sensor.into(), 1),
        }
    }

    /// Residual of a throw from the centre, temperature taken out, and its distance from the reference \[K\].
    pub(super) fn residual(&self, log: &[f64; 3], temperature_c: Option<f64>) -> (Vector3<f64>, f64) {
        let distance = self.temperature.distance(temperature_c);
        (Vector3::from(*log) - Vector3::from(self.centre) - Vector3::from(self.temperature.per_k) * distance, distance)
    }

    /// Standard deviation that the doubt about temperature coefficients adds at a mean `distance` \[K\] from the
    /// reference; with the sign of the distance, as both directions see the same weather.
    pub(super) fn temperature_sd(&self, distance: f64) -> Vector3<f64> {
        Vector3::from(self.temperature.per_k_variance).map(f64::sqrt) * distance
    }

    pub(super) fn scatter(&self) -> &Scatter {
        &self.scatter
    }

    pub(super) fn throws(&self) -> usize {
        self.throws
    }

    pub(super) fn is_complete(&self) -> bool {
        self.complete
    }

    pub(super) fn duration_s(&self) -> Option<f64> {
        self.duration_s
    }

    pub(super) fn record(&self, direction: Direction) -> BaselineRecord {
        let s = self.scatter.of_one_throw();
        BaselineRecord {
            direction,
            taken_at: self.taken_at,
            throws: self.throws,
            complete: self.complete,
            center: self.centre.map(f64::exp),
            log_covariance: [0, 1, 2].map(|i| [0, 1, 2].map(|j| s[(i, j)])),
            lag1: self.scatter.lag1(),
            temperature_source: self.temperature.source,
            temperature_pct_per_k: self.temperature.per_k.map(|k| 100.0 * k),
            reference_c: self.temperature.reference_c,
            duration_s: self.duration_s,
        }
    }
}

/// The scatter of both directions' throws in the order in which the machine made them.
pub(super) fn learn_mixed(learned: [&[Learned]; 2], baselines: [&Baseline; 2]) -> Scatter {
    let mut residuals: Vec<(u64, Vector3<f64>)> = Vec::new();
    let mut sensor = Matrix3::zeros();
    for (throws, baseline) in learned.into_iter().zip(baselines) {
        let sd = baseline.scatter.of_one_throw().diagonal().map(f64::sqrt);
        for throw in throws {
            let (r, _) = baseline.residual(&throw.log, throw.temperature_c.map(f64::from));
            residuals.push((throw.order, clip(r, [0, 1, 2].map(|i| (0.0, sd[i])))));
        }
        sensor += baseline.scatter.sensor() * throws.len() as f64;
    }
    residuals.sort_unstable_by_key(|(order, _)| *order);
    sensor /= residuals.len() as f64;
    let ordered: Vec<Vector3<f64>> = residuals.into_iter().map(|(_, r)| r).collect();
    Scatter::learn(&ordered, sensor, 2)
}

fn clip(residual: Vector3<f64>, robust: [(f64, f64); 3]) -> Vector3<f64> {
    const REACH_SD: f64 = 3.5;
    Vector3::from_fn(|i, _| residual[i].clamp(-REACH_SD * robust[i].1, REACH_SD * robust[i].1))
}
