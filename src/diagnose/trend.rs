//! When a drift reaches its next limit: a robust slope with its interval, or no forecast at all.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::robust::median;

/// Two-sided 95 % of a standard normal.
const NORMAL_97_5: f64 = 1.96;

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

/// Means of successive blocks of throws since the baseline. When all places are full, neighbours are joined and
/// blocks get twice as long, so that the whole life is always there, coarser as it gets longer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct History {
    length: u32,
    blocks: Vec<[f32; 3]>,
    filling: u32,
    sum: [f64; 3],
}

impl Default for History {
    fn default() -> Self {
        Self { length: Self::FIRST_LENGTH, blocks: Vec::new(), filling: 0, sum: [0.0; 3] }
    }
}

impl History {
    /// Places: even, so that all blocks have a neighbour to be joined with.
    const PLACES: usize = 48;
    /// Blocks that a trend is read from: half of a history that was just joined.
    const LATEST: usize = 12;
    /// Throws in a block at first: enough to average the scatter, few enough to see a fast ramp.
    const FIRST_LENGTH: u32 = 4;

    #[expect(clippy::cast_possible_truncation, reason = "1e-7 of a logarithm is far below any scatter")]
    pub(super) fn push(&mut self, residual: &Vector3<f64>) {
        for (sum, value) in self.sum.iter_mut().zip(residual.iter()) {
            *sum += value;
        }
        self.filling += 1;
        if self.filling < self.length {
            return;
        }
        self.blocks.push(self.sum.map(|sum| (sum / f64::from(self.length)) as f32));
        self.sum = [0.0; 3];
        self.filling = 0;
        if self.blocks.len() == Self::PLACES {
            let joined =
                self.blocks.chunks_exact(2).map(|pair| [0, 1, 2].map(|i| 0.5 * (pair[0][i] + pair[1][i]))).collect();
            self.blocks = joined;
            self.length *= 2;
        }
    }

    /// Throws that a block stands for, and the latest blocks along `weights`, oldest first.
    pub(super) fn along(&self, weights: &Vector3<f64>) -> (f64, Vec<f64>) {
        let project = |block: &[f32; 3]| weights.dot(&Vector3::from(block.map(f64::from)));
        let from = self.blocks.len().saturating_sub(Self::LATEST);
        (f64::from(self.length), self.blocks[from..].iter().map(project).collect())
    }
}

/// Forecast of when `series`, one value every `spacing` throws and oldest first, gets from its present level to
/// `limit` (both of one sign). `None` without a clear slope, or when a step explains the series better than a line.
pub(super) fn forecast(series: &[f64], spacing: f64, limit: f64) -> Option<LimitForecast> {
    const LEAST_POINTS: usize = 8;
    /// Beyond this many times the length of the series a straight line says nothing.
    const REACH: f64 = 20.0;
    if series.len() < LEAST_POINTS {
        return None;
    }
    let slopes = Slopes::of(series);
    let slope = slopes.middle();
    let inflation = serial_inflation(series, slope);
    let (low, high) = slopes.interval(inflation);
    if low * high <= 0.0 || slope * limit <= 0.0 {
        return None;
    }
    if step_misfit(series) <= line_misfit(series, slope) {
        return None;
    }
    let middle = (series.len() - 1) as f64 / 2.0;
    let mut levels: Vec<f64> =
        series.iter().enumerate().map(|(at, value)| value - slope * (at as f64 - middle)).collect();
    let now = median(&mut levels) + slope * middle;
    let left = limit - now;
    if left * limit <= 0.0 {
        return None;
    }
    // The end of the line errs twice as much as its middle, and in the direction in which the slope errs.
    let level_sd = 2.0 * (line_misfit(series, slope) * inflation).sqrt() / series.len() as f64;
    let reach = NORMAL_97_5 * level_sd / slope.abs() * spacing;
    let steps = |slope: f64| left / slope * spacing;
    let mid = steps(slope);
    let (steep, flat) = if slope > 0.0 { (high, low) } else { (low, high) };
    let soon = (steps(steep) - reach).max(0.0);
    let late = steps(flat) + reach;
    (late <= REACH * spacing * series.len() as f64).then_some(LimitForecast { low: soon, mid, high: late })
}

/// All pairwise slopes per step, sorted (Theil, Sen).
struct Slopes {
    sorted: Vec<f64>,
    points: f64,
}

impl Slopes {
    fn of(series: &[f64]) -> Self {
        let n = series.len();
        let mut sorted = Vec::with_capacity(n * (n - 1) / 2);
        for (at, from) in series.iter().enumerate() {
            for (gap, to) in series[at + 1..].iter().enumerate() {
                sorted.push((to - from) / (gap + 1) as f64);
            }
        }
        sorted.sort_unstable_by(f64::total_cmp);
        Self { sorted, points: n as f64 }
    }

    fn at(&self, position: f64) -> f64 {
        let last = (self.sorted.len() - 1) as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped into the indices")]
        let index = position.clamp(0.0, last) as usize;
        self.sorted[index]
    }

    fn middle(&self) -> f64 {
        self.at(self.sorted.len() as f64 / 2.0)
    }

    /// Sen's 95 % interval from the rank of Kendall's S, whose variance grows by `inflation` in a correlated series.
    fn interval(&self, inflation: f64) -> (f64, f64) {
        let n = self.points;
        let kendall_variance = n * (n - 1.0) * (2.0 * n + 5.0) / 18.0;
        let reach = NORMAL_97_5 * (kendall_variance * inflation).sqrt();
        let count = self.sorted.len() as f64;
        (self.at((count - reach) / 2.0), self.at(f64::midpoint(count, reach)))
    }
}

/// By how much serial correlation of what the line leaves inflates the variance of a slope or a mean.
fn serial_inflation(series: &[f64], slope: f64) -> f64 {
    const MOST: f64 = 0.8;
    let n = series.len() as f64;
    let mut rest: Vec<f64> = series.iter().enumerate().map(|(at, value)| value - slope * at as f64).collect();
    let level = rest.iter().sum::<f64>() / n;
    for value in &mut rest {
        *value -= level;
    }
    let square: f64 = rest.iter().map(|v| v * v).sum();
    let lagged: f64 = rest.iter().zip(&rest[1..]).map(|(a, b)| a * b).sum();
    // A fitted line takes correlation away: about four parts of n.
    let lag1 = (lagged / square.max(f64::MIN_POSITIVE) + 4.0 / n).clamp(0.0, MOST);
    (1.0 + lag1) / (1.0 - lag1)
}

fn line_misfit(series: &[f64], slope: f64) -> f64 {
    let mut rest: Vec<f64> = series.iter().enumerate().map(|(at, value)| value - slope * at as f64).collect();
    let level = rest.iter().sum::<f64>() / rest.len() as f64;
    rest.iter_mut().map(|v| (*v - level).powi(2)).sum()
}

/// Least misfit of two constant levels, over all places of the step.
fn step_misfit(series: &[f64]) -> f64 {
    let spread = |part: &[f64]| {
        let mean = part.iter().sum::<f64>() / part.len() as f64;
        part.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
    };
    (1..series.len()).map(|at| spread(&series[..at]) + spread(&series[at..])).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_forecast_and_a_step_is_not() {
        let wiggle = |at: usize| 0.002 * ((at * 7919 % 13) as f64 / 6.5 - 1.0);
        let line: Vec<f64> = (0..40).map(|at| 0.001 * at as f64 + wiggle(at)).collect();
        let found = forecast(&line, 1.0, 0.1).unwrap();
        assert!(found.low <= found.mid && found.mid <= found.high);
        assert!((found.mid - 61.0).abs() < 6.0, "{found:?}");
        let step: Vec<f64> = (0..40).map(|at| if at < 20 { 0.0 } else { 0.05 } + wiggle(at)).collect();
        assert_eq!(forecast(&step, 1.0, 0.1), None);
        let flat: Vec<f64> = (0..40).map(wiggle).collect();
        assert_eq!(forecast(&flat, 1.0, 0.1), None);
    }

    #[test]
    fn the_history_covers_a_whole_life_in_bounded_space() {
        let mut history = History::default();
        for at in 0..10_000 {
            history.push(&Vector3::repeat(f64::from(at)));
        }
        let (length, series) = history.along(&Vector3::new(1.0, 0.0, 0.0));
        assert!(history.blocks.len() < History::PLACES);
        let first = (history.blocks.len() - series.len()) as f64;
        for (at, value) in series.iter().enumerate() {
            let expected = length * (first + at as f64) + (length - 1.0) / 2.0;
            assert!((value - expected).abs() < 1e-3 * expected.max(1.0));
        }
    }
}
