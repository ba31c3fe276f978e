//! The course of a drift over the last throws: its present size, and a forecast.
//!
//! Along the effect of its cause, a throw at time t (in throws, now = 0) has the value y = o + s(t) + n. The offset o
//! is the error of the baseline's centre. The drift s begins at some throw tau: s(t) = 0 before it, and
//! `a + b (t - tau) + c (t - tau)^2` from it on, so that a step, a ramp and an accelerating wear are the same model. The noise n is an
//! autoregression of first order. Sizes are parts of nominal, as wear is linear in these and not in their logarithms.
//! With normal priors on o, a, b, c the problem is linear for a given tau (least squares on the whitened series). Each
//! tau of a grid gets the weight of its evidence; the mixture gives the present size, with an interval that assumes
//! neither shape nor beginning, and the throws until a limit.

use std::ops::Range;

use nalgebra::{Matrix4, Vector4};
use serde::{Deserialize, Serialize};
use statrs::function::erf::erf;

use super::{robust::median, scatter::inflation};

/// Forecast of the throws until a limit is reached.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LimitForecast {
    /// Lower end of the 95 % interval.
    pub low: f64,
    /// Median.
    pub mid: f64,
    /// Upper end of the 95 % interval.
    pub high: f64,
}

/// Prior standard deviations of step, slope and curvature: steps up to about half of nominal, ramps of days to weeks,
/// curvature that doubles a usual slope within fifty throws.
const STEP_SD: f64 = 0.4;
const SLOPE_SD: f64 = 0.004;
const CURVATURE_SD: [f64; 3] = [1e-6, 1e-5, 2e-4];
/// Largest distance of a value from the medians of its neighbours, in standard deviations; larger ones are clipped.
const CLIP_SD: f64 = 3.0;
/// Number of neighbours on each side.
const NEIGHBOURS: usize = 3;
/// Farthest forecast \[throws\].
const FARTHEST: f64 = 1000.0;
/// Onsets with less than this part of the best probability are left out, as they do not change an interval.
const NEGLIGIBLE: f64 = 1e-5;
/// Tail probability of each side of a 95 % interval.
const TAIL: f64 = 0.025;
/// Numbers of the last points, tried until the course fits the last throws: a ramp that has ended does not follow one
/// curve from its beginning.
const SPANS: [usize; 3] = [48, 24, 12];
/// Numbers of last throws that a course must fit, and their largest mean distance from it, in standard deviations.
const MUST_FIT: ([usize; 2], f64) = ([4, 12], 1.5);

/// A throw in the series, or the mean of some consecutive throws.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    /// Age in throws of the machine, 0 for now; of a mean that of the middle throw.
    pub(super) age: f64,
    /// Residual along the cause, a logarithm.
    pub(super) value: f64,
    /// Number of throws of the mean.
    pub(super) throws: f64,
}

/// Noise of the series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    /// Standard deviation of one value.
    pub(super) sd: f64,
    /// Correlation of consecutive values.
    pub(super) lag1: f64,
    /// Standard deviation of the baseline's centre and of the present effect of the temperature.
    pub(super) offset_sd: f64,
}

/// The drift for a given beginning.
#[derive(Debug, Clone, Copy)]
struct Begun {
    /// Age of the beginning.
    age: f64,
    weight: f64,
    /// o, a, b, c.
    mean: Vector4<f64>,
    covariance: Matrix4<f64>,
}

/// The course of a drift over the last throws.
#[derive(Debug, Clone)]
pub(super) struct Course(Vec<Begun>);

impl Course {
    /// Fits the course to the points, oldest first, where the last throws are single points; to the last points only,
    /// if one curve does not fit all. `None` for fewer than three.
    pub(super) fn of(points: &[Point], noise: Noise) -> Option<Self> {
        let mut course = Self::over(points, noise)?;
        for span in SPANS.into_iter().filter(|span| *span < points.len()) {
            if course.fits(points, noise) {
                break;
            }
            course = Self::over(&points[points.len() - span..], noise)?;
        }
        Some(course)
    }

    /// Whether the last throws scatter around the course.
    fn fits(&self, points: &[Point], noise: Noise) -> bool {
        let (lengths, most) = MUST_FIT;
        let level = |age: f64| self.0.iter().map(|part| part.weight * part.level(age)).sum::<f64>();
        lengths.into_iter().all(|throws| {
            let last = &points[points.len().saturating_sub(throws)..];
            let count = last.len() as f64;
            let off = last.iter().map(|point| point.value - level(point.age).max(-0.99).ln_1p()).sum::<f64>() / count;
            off.abs() < most * noise.sd * (inflation(noise.lag1, count) / count).sqrt()
        })
    }

    fn over(points: &[Point], noise: Noise) -> Option<Self> {
        let n = points.len();
        if n < 3 || noise.sd <= 0.0 || noise.sd.is_nan() {
            return None;
        }
        let calm = calmed(points, CLIP_SD * noise.sd);
        // The scatter is that of a logarithm, so it grows with the size.
        let scale: Vec<f64> = calm.iter().map(|value| value.exp()).collect();
        let values: Vec<f64> = calm.iter().map(|value| value.exp_m1()).collect();
        let fresh_sd = noise.sd * (1.0 - noise.lag1 * noise.lag1).sqrt();
        // Row of a point: offset, 1, t, t^2, and the value.
        let row = |at: usize| {
            let t = -points[at].age;
            (Vector4::new(1.0, 1.0, t, t * t), values[at])
        };
        // The whitened row: means of several throws are independent, single throws are an autoregression. The second
        // row is for a drift that begins at this point, with only the offset before it.
        let whitened = |at: usize| {
            let ((x, y), throws) = (row(at), points[at].throws);
            if throws > 1.0 {
                let sd = scale[at] * noise.sd * (inflation(noise.lag1, throws) / throws).sqrt();
                (x / sd, x / sd, y / sd)
            } else if at == 0 || points[at - 1].throws > 1.0 {
                let sd = scale[at] * noise.sd;
                (x / sd, x / sd, y / sd)
            } else {
                let sd = scale[at] * fresh_sd;
                let (before, y_before) = row(at - 1);
                let began = Vector4::new(x[0] - noise.lag1, x[1], x[2], x[3]);
                ((x - noise.lag1 * before) / sd, began / sd, (y - noise.lag1 * y_before) / sd)
            }
        };
        let rows: Vec<_> = (0..n).map(whitened).collect();
        let precisions = CURVATURE_SD.map(|curvature_sd| {
            let prior = Vector4::new(noise.offset_sd.max(1e-6), STEP_SD, SLOPE_SD, curvature_sd);
            Matrix4::from_diagonal(&prior.map(|sd| (sd * sd).recip()))
        });
        // Before the drift there is only the offset.
        let (mut offset, mut offset_right): (f64, f64) =
            rows.iter().map(|(x, _, y)| (x[0] * x[0], x[0] * y)).fold((0.0, 0.0), |(a, b), (c, d)| (a + c, b + d));
        let (mut after, mut after_right) = (Matrix4::zeros(), Vector4::zeros());
        let mut begun: Vec<(Begun, f64)> = Vec::with_capacity(CURVATURE_SD.len() * n);
        for from in (0..n).rev() {
            let (x, began, y) = rows[from];
            offset -= x[0] * x[0];
            offset_right -= x[0] * y;
            if from + 1 < n {
                let mut information = after + began * began.transpose();
                let mut right = after_right + began * y;
                information[(0, 0)] += offset;
                right[0] += offset_right;
                let age = points[from].age;
                let since_begin = since_begin(age);
                let information = since_begin.transpose() * information * since_begin;
                let right = since_begin.transpose() * right;
                for precision in &precisions {
                    let normal = information + precision;
                    let Some(factor) = normal.cholesky() else { continue };
                    let (mean, covariance) = (factor.solve(&right), factor.inverse());
                    // Twice the logarithm of the evidence, without common terms.
                    let evidence = right.dot(&mean) - factor.determinant().ln() + precision.determinant().ln();
                    begun.push((Begun { age, weight: 0.0, mean, covariance }, evidence));
                }
            }
            after += x * x.transpose();
            after_right += x * y;
        }
        let best = begun.iter().map(|(_, evidence)| *evidence).fold(f64::NEG_INFINITY, f64::max);
        let weighted =
            begun.into_iter().map(|(part, evidence)| Begun { weight: (0.5 * (evidence - best)).exp(), ..part });
        let mut parts: Vec<Begun> = weighted.filter(|part| part.weight > NEGLIGIBLE).collect();
        let total: f64 = parts.iter().map(|part| part.weight).sum();
        for part in &mut parts {
            part.weight /= total;
        }
        Some(Self(parts))
    }

    /// Present size of the drift as part of nominal, and its standard deviation.
    pub(super) fn now(&self) -> (f64, f64) {
        let mean: f64 = self.0.iter().map(|part| part.weight * part.at(0.0).0).sum();
        let spread = |part: &Begun| {
            let (m, variance) = part.at(0.0);
            part.weight * (variance + (m - mean).powi(2))
        };
        (mean, self.0.iter().map(spread).sum::<f64>().sqrt())
    }

    /// Throws until the drift reaches `limit`, a part of nominal with the sign of the drift. `None` if it may never do
    /// so, or has done so.
    pub(super) fn reaches(&self, limit: f64) -> Option<LimitForecast> {
        let above = |ahead: f64| -> f64 {
            let part = |part: &Begun| {
                let (mean, variance) = part.at(-ahead);
                part.weight * normal_below((mean - limit) * limit.signum() / variance.sqrt())
            };
            self.0.iter().map(part).sum()
        };
        if above(0.0) > 0.5 {
            return None;
        }
        let low = first(&above, TAIL)?;
        let mid = first(&above, 0.5)?;
        let high = first(&above, 1.0 - TAIL)?;
        Some(LimitForecast { low, mid, high })
    }
}

impl Begun {
    /// Expected value at an age, with the offset.
    fn level(&self, age: f64) -> f64 {
        regressors(self.age, age).dot(&self.mean)
    }

    /// Mean and variance of the drift at an age; negative ages are in the future.
    fn at(&self, age: f64) -> (f64, f64) {
        let mut x = regressors(self.age, age);
        x[0] = 0.0;
        (x.dot(&self.mean), (x.transpose() * self.covariance * x).x)
    }
}

/// Regressors of o, a, b, c at an age, for a drift that began at the age `begun`.
fn regressors(begun: f64, age: f64) -> Vector4<f64> {
    let since = begun - age;
    if since < 0.0 { Vector4::new(1.0, 0.0, 0.0, 0.0) } else { Vector4::new(1.0, 1.0, since, since * since) }
}

/// Converts o, a, b, c of a drift that began at an age to the coefficients of offset, 1, t and t^2.
fn since_begin(age: f64) -> Matrix4<f64> {
    let tau = -age;
    Matrix4::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, -tau, tau * tau, 0.0, 0.0, 1.0, -2.0 * tau, 0.0, 0.0, 0.0, 1.0)
}

/// First number of throws ahead at which `share` is reached, by growing steps and bisection.
fn first(above: &dyn Fn(f64) -> f64, share: f64) -> Option<f64> {
    let (mut low, mut high) = (0.0, 1.0);
    if above(0.0) >= share {
        return Some(0.0);
    }
    while above(high) < share {
        (low, high) = (high, 1.5 * high);
        if high > FARTHEST {
            return None;
        }
    }
    for _ in 0..20 {
        let middle = f64::midpoint(low, high);
        if above(middle) < share { low = middle } else { high = middle }
    }
    Some(high)
}

/// Distribution function of the standard normal.
fn normal_below(z: f64) -> f64 {
    0.5 * (1.0 + erf(z / std::f64::consts::SQRT_2))
}

/// The values, without single outliers: each is clipped to `reach` around the range between the medians of the values
/// before it and after it, so that a step passes from its second throw on.
///
/// The last value has no later one; the value before it takes this place, as two throws show a step.
fn calmed(points: &[Point], reach: f64) -> Vec<f64> {
    let n = points.len();
    let middle = |range: Range<usize>| {
        let mut values: Vec<f64> = points[range].iter().map(|point| point.value).collect();
        median(&mut values)
    };
    let calm = |at: usize| {
        let before = if at == 0 { 1..2 } else { at.saturating_sub(NEIGHBOURS)..at };
        let after = if at + 1 == n { at - 1..at } else { at + 1..n.min(at + 1 + NEIGHBOURS) };
        let (before, after) = (middle(before), middle(after));
        points[at].value.clamp(before.min(after) - reach, before.max(after) + reach)
    };
    (0..n).map(calm).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(shape: impl Fn(f64) -> f64) -> Vec<Point> {
        let wiggle = |at: u32| 0.004 * (f64::from(at * 7919 % 13) / 6.5 - 1.0);
        (0..48)
            .map(|at| Point { age: f64::from(47 - at), value: shape(f64::from(at)) + wiggle(at), throws: 1.0 })
            .collect()
    }

    const NOISE: Noise = Noise { sd: 0.003, lag1: 0.0, offset_sd: 0.001 };

    #[test]
    fn a_step_a_ramp_and_an_accelerating_wear_are_measured_at_their_last_throw() {
        let shapes: [fn(f64) -> f64; 3] =
            [|t| if t < 40.0 { 0.0 } else { 0.1 }, |t| 0.004 * (t - 20.0).max(0.0), |t| 5e-5 * t * t];
        for shape in shapes {
            let (size, sd) = Course::of(&series(shape), NOISE).unwrap().now();
            let truth = shape(47.0).exp_m1();
            assert!((size - truth).abs() < 3.0 * sd && sd < 0.01, "{size} ± {sd} for {truth}");
        }
    }

    /// A ramp over throws 50 to 80 and then constant; the first throws are means of twelve.
    #[test]
    fn a_ramp_that_has_ended_has_its_last_size() {
        let shape = |t: f64| (0.2 * ((t - 50.0) / 30.0).clamp(0.0, 1.0)).ln_1p();
        for now in [85.0, 95.0, 110.0, 130.0, 160.0] {
            let blocks =
                (0..).map(|block| f64::from(block).mul_add(12.0, 5.5)).take_while(|middle| *middle < now - 53.5);
            let mean = |middle: f64| Point { age: now - middle, value: shape(middle), throws: 12.0 };
            let single = series(|t| shape(t + now - 47.0));
            let points: Vec<Point> = blocks.map(mean).chain(single).collect();
            let (size, sd) = Course::of(&points, NOISE).unwrap().now();
            assert!((size - 0.2).abs() < 0.01 && sd < 0.01, "{size} ± {sd} at {now}");
        }
    }

    #[test]
    fn a_ramp_reaches_its_limit_when_it_does_and_a_step_does_not() {
        let ramp = Course::of(&series(|t| (0.004 * (t - 20.0).max(0.0)).ln_1p()), NOISE).unwrap();
        let found = ramp.reaches(0.15).unwrap();
        assert!(
            found.low < 10.5 && 10.5 < found.high && found.low <= found.mid && found.mid <= found.high,
            "{found:?}"
        );
        let step = Course::of(&series(|t| if t < 20.0 { 0.0 } else { 0.1 }), NOISE).unwrap();
        assert_eq!(step.reaches(0.15), None);
    }
}
