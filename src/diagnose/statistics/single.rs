//! Single precision, in which snapshots store values, as it halves them. 1e-7 of a logarithm, a variance, a temperature
//! or a position is far below any scatter.

#[expect(clippy::cast_possible_truncation, reason = "rounding is the purpose")]
pub(crate) fn to_f32(value: f64) -> f32 {
    value as f32
}

/// A value rounded to 1e-4, below any relevant scatter of a logarithm: a number of few digits in the snapshot.
pub(crate) fn to_rounded_f32(value: f64) -> f32 {
    to_f32((1e4 * value).round() / 1e4)
}
