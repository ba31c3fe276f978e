//! Missing samples (NaN): a logger sends `null` for a sample that it did not measure.

use std::borrow::Cow;

use super::samples::every;
use crate::{
    estimate::rejection::Rejection,
    throw::{Channel, Trace},
};

/// Longest bridged gap \[s\]; one sample is always bridged. It is the period of a rectified supply, and shorter than any
/// change of the running current. A gap in the inrush, where the current changes faster, is a doubt (see [`within`]).
const LONGEST_GAP_S: f64 = 0.01;
/// Largest share of a channel that is bridged. If all bridged values are wrong by a third of the current, its integral,
/// and so b0, is wrong by 0.3 %, less than the scatter of healthy throws.
const LARGEST_SHARE: f64 = 0.01;

/// The channel with its missing samples replaced by a line between their neighbours (at the ends of the trace by the
/// next value). A channel with a gap longer than [`LONGEST_GAP_S`], or with more than [`LARGEST_SHARE`] missing, is
/// returned unchanged.
pub(crate) fn bridged(values: &[f64], interval_s: f64) -> Cow<'_, [f64]> {
    if every(values.iter().map(|v| !v.is_nan())) {
        return Cow::Borrowed(values);
    }
    let longest = (LONGEST_GAP_S / interval_s + 1e-9).floor().max(1.0);
    let mut whole = values.to_vec();
    let (mut from, mut missing) = (0, 0);
    for stretch in values.chunk_by(|a, b| a.is_nan() == b.is_nan()) {
        let to = from + stretch.len();
        if stretch[0].is_nan() {
            let (before, after) = (values[..from].last(), values.get(to));
            let (Some(before), Some(after)) = (before.or(after), after.or(before)) else {
                return Cow::Borrowed(values);
            };
            for (at, value) in whole[from..to].iter_mut().enumerate() {
                *value = before + (after - before) * (at + 1) as f64 / (stretch.len() + 1) as f64;
            }
            missing += stretch.len();
            if stretch.len() as f64 > longest || missing as f64 > LARGEST_SHARE * values.len() as f64 {
                return Cow::Borrowed(values);
            }
        }
        from = to;
    }
    Cow::Owned(whole)
}

/// The rejection for the first missing sample between two times \[s\]; `None` if there is none. In the inrush the slope
/// of the current changes within milliseconds, so a line between its samples falsifies the common scale of b0, a1 and
/// a0.
pub(crate) fn within(trace: &Trace, from_s: f64, to_s: f64) -> Option<Rejection> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the samples of the trace")]
    let sample = |at_s: f64| ((at_s * trace.sample_rate_hz()).max(0.0) as usize).min(trace.len());
    let (from, to) = (sample(from_s), sample(to_s));
    let missing = |channel: Channel, values: &[f64]| {
        let sample = from + values[from..to.max(from)].iter().position(|v| v.is_nan())?;
        Some(Rejection::NotFinite { channel, sample, at_s: sample as f64 / trace.sample_rate_hz() })
    };
    let position = || missing(Channel::Position, trace.position_mm()).filter(|_| trace.has_position());
    missing(Channel::Current, trace.current_a()).or_else(position)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_gaps_are_bridged_and_long_or_many_are_not() {
        let line: Vec<f64> = (0..1000).map(f64::from).collect();
        let without = |missing: &[usize]| {
            let mut values = line.clone();
            for at in missing {
                values[*at] = f64::NAN;
            }
            values
        };
        let damaged = without(&[0, 5, 6, 7, 100]);
        let whole = bridged(&damaged, 1e-3);
        assert!(whole.iter().zip(&line).skip(1).all(|(a, b)| (a - b).abs() < 1e-9) && whole[0] > 0.5, "{whole:?}");
        for missing in [(5..16).collect::<Vec<_>>(), (0..11).map(|at| 50 * at).collect()] {
            assert!(bridged(&without(&missing), 1e-3).iter().any(|v| v.is_nan()), "{missing:?}");
        }
        assert!(bridged(&[f64::NAN; 3], 1e-3)[0].is_nan());
    }
}
