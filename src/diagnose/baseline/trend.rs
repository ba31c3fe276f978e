//! A trend in the throws of a baseline: wear that had begun before the first throw.
//!
//! The evidence compares two models of a coefficient's logarithm. The first has a level for each direction and, if it
//! is known, the effect of the temperature. The second has a slope in addition. A slope must also explain the throws
//! better than a step does. The evidence is that of [`Series`].

use nalgebra::Vector3;

use crate::diagnose::statistics::{Series, ln_sum};

/// Throws from which a trend can be found.
const LEAST_THROWS: usize = 24;
/// Bounds above which a baseline has a trend.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bound {
    /// Logarithm of the Bayes factor of slope against levels.
    pub(crate) evidence: f64,
    /// Change over all throws of the baseline, as part of the warning limit.
    pub(super) part_of_limit: f64,
}
/// The bounds while a baseline fills. A part of a serially correlated series often looks like a slope, so the change
/// must also be near the warning limit. Only wear counts.
pub(super) const WHILE_FILLING: Bound = Bound { evidence: 1.0, part_of_limit: 0.65 };
/// The bounds for a full baseline. With a trend it stays provisional. Simulated: of 4,000 series of 100 healthy throws
/// with lag-1 correlations from 0 to 0.9, about 1 % or fewer reach them.
pub(super) const AT_THE_END: Bound = Bound { evidence: 2.7, part_of_limit: 1.0 / 3.0 };
/// Number of equal parts of the series; a step may be between any two of them.
const STEPS: usize = 12;
/// Least logarithm of the Bayes factor of slope against step. A step is left to the drift rule.
const STEP_BOUND: f64 = 1.0;
/// Largest residual in robust standard deviations; larger ones are clipped.
const CLIP_SD: f64 = 3.5;

/// A throw of a baseline, of either direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TrendThrow {
    /// Number of the throw, counted by the machine's monitor.
    pub(crate) order: u32,
    /// Index of its direction, 0 or 1.
    pub(crate) side: usize,
    /// Difference of the logarithms from the centre of the direction.
    pub(crate) residual: Vector3<f64>,
    pub(crate) temperature_c: Option<f64>,
}

/// The throws of both baselines while they fill, in the order of the machine.
#[derive(Debug)]
pub(crate) struct Filling {
    pub(crate) throws: Vec<TrendThrow>,
    /// Robust standard deviations of one throw.
    sd: [f64; 3],
    /// Part of the estimates' errors in the variances.
    pub(crate) error_part: [f64; 3],
}

impl Filling {
    /// Sorts the throws by their numbers. `variance`: variances of ln b0, ln a1, ln a0 of one throw; `sensor`: the part
    /// of each variance that the errors of the estimates cause.
    pub(crate) fn new(mut throws: Vec<TrendThrow>, variance: [f64; 3], sensor: [f64; 3]) -> Self {
        throws.sort_unstable_by_key(|throw| throw.order);
        let error_part = std::array::from_fn(|i| (sensor[i] / variance[i].max(f64::MIN_POSITIVE)).min(0.9));
        Self { throws, sd: variance.map(f64::sqrt), error_part }
    }

    pub(crate) fn len(&self) -> usize {
        self.throws.len()
    }

    /// Number of directions with throws.
    pub(crate) fn directions(&self) -> usize {
        [0, 1].into_iter().filter(|side| self.throws.iter().any(|throw| throw.side == *side)).count()
    }

    /// The residuals of coefficient `i`, clipped; `reach`: least bound of the clipping.
    pub(crate) fn values(&self, i: usize, reach: f64) -> Vec<f64> {
        let reach = reach.max(CLIP_SD * self.sd[i]);
        self.throws.iter().map(|throw| throw.residual[i].clamp(-reach, reach)).collect()
    }

    /// Time of the throws, by their numbers, from -1/2 to 1/2.
    pub(crate) fn time(&self) -> Vec<f64> {
        let since = |throw: &TrendThrow| f64::from(throw.order - self.throws[0].order);
        self.throws.iter().map(|throw| since(throw) / self.range() - 0.5).collect()
    }

    /// Number of throws of the machine from the first to the last.
    pub(crate) fn range(&self) -> f64 {
        self.throws.first().zip(self.throws.last()).map_or(0.0, |(first, last)| f64::from(last.order - first.order))
    }

    /// Regressors: the level of each direction, and the temperature if it is known and changes.
    pub(crate) fn levels(&self) -> Vec<Vec<f64>> {
        let mut levels: Vec<Vec<f64>> = (0..2)
            .map(|side| self.throws.iter().map(|throw| f64::from(u8::from(throw.side == side))).collect())
            .filter(|level: &Vec<f64>| level.contains(&1.0))
            .collect();
        let celsius: Option<Vec<f64>> = self.throws.iter().map(|throw| throw.temperature_c).collect();
        levels.extend(celsius.filter(|celsius| celsius.iter().any(|c| (c - celsius[0]).abs() > 0.1)));
        levels
    }

    /// Slopes of ln b0, ln a1, ln a0 per throw of the machine; 0 without a trend. `evidence`: as in [`Bound`].
    pub(crate) fn slopes(&self, evidence: f64) -> [f64; 3] {
        if self.len() < LEAST_THROWS {
            return [0.0; 3];
        }
        let (time, levels) = (self.time(), self.levels());
        std::array::from_fn(|i| {
            // In a baseline of ratios to b0, that of b0 itself is constant.
            if self.sd[i] == 0.0 {
                return 0.0;
            }
            let change = slope(&self.values(i, 0.0), &time, &levels, self.error_part[i], evidence);
            change.map_or(0.0, |change| change / self.range())
        })
    }
}

/// The change over the whole series, if it has a trend.
fn slope(values: &[f64], time: &[f64], levels: &[Vec<f64>], error_part: f64, evidence: f64) -> Option<f64> {
    let may_have = Series::uncorrelated(values, levels, error_part).bayes_factor(time) >= evidence;
    if !may_have {
        return None;
    }
    let series = Series::new(values, levels, error_part);
    let sloped = series.with(time);
    if sloped.evidence - series.evidence() < evidence {
        return None;
    }
    let step = |at: usize| -> Vec<f64> { (0..values.len()).map(|t| if t < at { -0.5 } else { 0.5 }).collect() };
    let steps: Vec<f64> = (1..STEPS).map(|at| series.with(&step(at * values.len() / STEPS)).evidence).collect();
    let stepped = ln_sum(steps.into_iter()) - (STEPS as f64 - 1.0).ln();
    (sloped.evidence - stepped > STEP_BOUND).then_some(sloped.change)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Series of all lag-1 correlations and slopes: the quick test must find no slope refuted that the evidence shows.
    #[test]
    fn no_slope_with_evidence_is_refuted_before() {
        let (mut refuted, mut shown) = (0, 0);
        for seed in 0..3_000 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (phi, rise) = (rng.random_range(-0.3..0.95), rng.random_range(-3.0..3.0_f64));
            let length = rng.random_range(LEAST_THROWS..200);
            let error_part = rng.random_range(0.0..0.9);
            let time: Vec<f64> = (0..length).map(|t| t as f64 / (length as f64 - 1.0) - 0.5).collect();
            let levels: Vec<Vec<f64>> =
                (0..2).map(|side| (0..length).map(|t| f64::from(u8::from(t % 2 == side))).collect()).collect();
            let mut last = 0.0;
            let values: Vec<f64> = time
                .iter()
                .map(|t| {
                    let noise: f64 = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
                    last = phi * last + noise;
                    last + rise * t
                })
                .collect();
            for bound in [WHILE_FILLING.evidence, AT_THE_END.evidence] {
                let is_shown = Series::new(&values, &levels, error_part).bayes_factor(&time) >= bound;
                let may_be = Series::uncorrelated(&values, &levels, error_part).bayes_factor(&time) >= bound;
                assert!(may_be || !is_shown, "seed {seed}, phi {phi}, rise {rise}, {length} throws, bound {bound}");
                (shown, refuted) = (shown + u32::from(is_shown), refuted + u32::from(!may_be));
            }
        }
        assert!(shown > 500 && refuted > 500, "{shown} slopes shown, {refuted} refuted");
    }
}
