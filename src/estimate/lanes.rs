//! Sums and largest values of samples, computed in independent lanes: the compiler then handles several samples at a
//! time.

/// Number of lanes.
pub(super) const LANES: usize = 8;

/// Folds the samples of signals with the same length, each lane from `start` on. The last value is that of the samples
/// after the last whole row of lanes.
fn fold<const N: usize>(signals: [&[f64]; N], start: f64, fold: impl Fn(f64, [f64; N]) -> f64) -> [f64; LANES + 1] {
    let mut lanes = [start; LANES + 1];
    let chunks = signals.map(|signal| signal.as_chunks::<LANES>());
    for at in 0..chunks[0].0.len() {
        let chunk = chunks.map(|(chunks, _)| &chunks[at]);
        for lane in 0..LANES {
            lanes[lane] = fold(lanes[lane], chunk.map(|samples| samples[lane]));
        }
    }
    lanes[LANES] = (0..chunks[0].1.len()).fold(start, |rest, at| fold(rest, chunks.map(|(_, rest)| rest[at])));
    lanes
}

/// Largest of the function's results for all samples of signals with the same length; negative infinity without
/// samples.
pub(super) fn largest<const N: usize>(signals: [&[f64]; N], of: impl Fn([f64; N]) -> f64) -> f64 {
    // Faster than `f64::max`, which treats NaN specially.
    let larger = |most: f64, value: f64| if value > most { value } else { most };
    let lanes = fold(signals, f64::NEG_INFINITY, |most, samples| larger(most, of(samples)));
    lanes.into_iter().fold(f64::NEG_INFINITY, f64::max)
}

/// Sum of the function's results for all samples of signals with the same length.
pub(super) fn sum<const N: usize>(signals: [&[f64]; N], of: impl Fn([f64; N]) -> f64) -> f64 {
    fold(signals, 0.0, |sum, samples| sum + of(samples)).into_iter().sum()
}
