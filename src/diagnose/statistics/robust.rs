//! Robust averages, which a single outlier hardly changes.

use crate::estimate::SD_PER_MEDIAN;

/// Largest distance from the median, in standard deviations; values farther away are clipped.
const CLIP_SD: f64 = 3.0;

/// Median. Sorts `values`, which must not be empty.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let middle = values.len() / 2;
    if values.len() % 2 == 1 { values[middle] } else { 0.5 * (values[middle - 1] + values[middle]) }
}

/// Mean of `values` clipped at three standard deviations `sd` around their median. Nearly as precise as the mean for
/// Gaussian scatter; one outlier of three changes it by one `sd` at most. Sorts `values`, which must not be empty.
pub(crate) fn clipped_mean(values: &mut [f64], sd: f64) -> f64 {
    let centre = median(values);
    let reach = CLIP_SD * sd;
    values.iter().map(|v| v.clamp(centre - reach, centre + reach)).sum::<f64>() / values.len() as f64
}

/// Robust centre and standard deviation of a sample. `values` must not be empty.
pub(crate) fn centre_and_sd(values: &[f64]) -> (f64, f64) {
    let mut sorted = values.to_vec();
    let middle = median(&mut sorted);
    let mut deviations: Vec<f64> = values.iter().map(|v| (v - middle).abs()).collect();
    let sd = SD_PER_MEDIAN * median(&mut deviations);
    // The median deviation is 0 if half of the values are equal, as quantised ones; the mean of the deviations is not.
    let sd = if sd > 0.0 { sd } else { deviations.iter().sum::<f64>() / deviations.len() as f64 };
    (clipped_mean(&mut sorted, sd), sd)
}

/// Standard deviation of a sample whose scatter may be skewed: from the deviation from `centre` that five in six values
/// do not exceed. The median deviation is 0 if half of the values are equal. `values` must not be empty.
pub(crate) fn skewed_sd(values: &[f64], centre: f64) -> f64 {
    /// Deviation that five in six values of a standard normal variable do not exceed.
    const FIVE_IN_SIX: f64 = 1.383;
    let mut deviations: Vec<f64> = values.iter().map(|v| (v - centre).abs()).collect();
    deviations.sort_unstable_by(f64::total_cmp);
    deviations[5 * values.len() / 6] / FIVE_IN_SIX
}

/// Standard deviation of series whose level may have a step: from the mean moving range, which is the distance of
/// consecutive values. 0 without consecutive values.
pub(crate) fn moving_range_sd(series: &[Vec<f64>]) -> f64 {
    /// Mean distance of two values of a standard normal variable: 2/√π.
    const RANGE_PER_SD: f64 = 1.128;
    let ranges = series.iter().flat_map(|values| values.array_windows().map(|[a, b]| (b - a).abs()));
    let (sum, count) = ranges.fold((0.0, 0), |(sum, count), range| (sum + range, count + 1));
    sum / f64::from(count.max(1)) / RANGE_PER_SD
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_skewed_sample_has_the_scatter_of_its_far_half() {
        let half_far: Vec<f64> = (0..24).map(|at| if at % 2 == 0 { 0.0 } else { 0.1 + 0.02 * f64::from(at) }).collect();
        assert!(skewed_sd(&half_far, 0.0) > 0.2);
        let two_outliers: Vec<f64> = (0..24).map(|at| if at % 12 == 0 { 5.0 } else { 0.01 }).collect();
        assert!(skewed_sd(&two_outliers, 0.0) < 0.01);
    }

    #[test]
    fn a_step_of_the_level_hardly_changes_the_moving_range() {
        let alternating: Vec<f64> = (0..12).map(|at| if at % 2 == 0 { 0.0 } else { 1.128 }).collect();
        assert!((moving_range_sd(std::slice::from_ref(&alternating)) - 1.0).abs() < 1e-12);
        let step: Vec<f64> = alternating.iter().enumerate().map(|(at, v)| if at < 6 { *v } else { v + 5.0 }).collect();
        assert!(moving_range_sd(&[step, vec![1.0]]) < 1.5);
        assert!(moving_range_sd(&[vec![3.0], vec![]]).abs() < 1e-12);
    }
}
