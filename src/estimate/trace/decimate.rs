//! Decimation of high sampling rates to about 1 kHz, with the same anti-alias filter for both channels.
//!
//! The model is linear, so a filter may change the signals if it is the same for current and position. It is a
//! fourth-order Butterworth low-pass (two biquads by the bilinear transform) with a cut-off at 0.4 of the new rate.

/// Traces of twice this rate or more are decimated, to this rate or more \[Hz\].
pub(super) const TARGET_RATE_HZ: f64 = 1000.0;
/// Cut-off as a share of the new sampling rate.
pub(crate) const CUT_OFF_SHARE: f64 = 0.4;

/// Decimation factor for a sampling rate; 1 for no decimation.
pub(crate) fn factor(sample_rate_hz: f64) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "rates are positive and below 1e6")]
    let factor = (sample_rate_hz / TARGET_RATE_HZ) as usize;
    factor.max(1)
}

/// A second-order section in transposed direct form, with gain 1 at 0 Hz.
struct Biquad {
    b0: f64,
    b1: f64,
    a1: f64,
    a2: f64,
    state: [f64; 2],
}

impl Biquad {
    /// Low-pass with this quality factor and `warped` = tan(π f/fs), with cut-off f and sampling rate fs, in steady
    /// state for the constant `level`.
    fn low_pass(warped: f64, quality: f64, level: f64) -> Self {
        let square = warped * warped;
        let scale = 1.0 / (1.0 + warped / quality + square);
        let b0 = square * scale;
        let a1 = 2.0 * (square - 1.0) * scale;
        let a2 = (1.0 - warped / quality + square) * scale;
        Self { b0, b1: 2.0 * b0, a1, a2, state: [level * (1.0 - b0), level * (b0 - a2)] }
    }

    fn step(&mut self, x: f64) -> f64 {
        let y = self.b0 * x + self.state[0];
        self.state[0] = self.b1 * x - self.a1 * y + self.state[1];
        self.state[1] = self.b0 * x - self.a2 * y;
        y
    }
}

/// Filters `values` and keeps every `factor`-th, in place. The signal counts as `level` before the first value.
pub(crate) fn decimate(values: &mut Vec<f64>, factor: usize, level: f64) {
    if factor < 2 {
        return;
    }
    let warped = (std::f64::consts::PI * CUT_OFF_SHARE / factor as f64).tan();
    // Quality factors of the two pole pairs: 1 / (2 cos(π/8)) and 1 / (2 cos(3π/8)).
    let mut first = Biquad::low_pass(warped, 0.541_196_100_146_197, level);
    let mut second = Biquad::low_pass(warped, 1.306_562_964_876_377, level);
    let kept = values.len().div_ceil(factor);
    for k in 0..values.len() {
        let filtered = second.step(first.step(values[k]));
        if k % factor == 0 {
            values[k / factor] = filtered;
        }
    }
    values.truncate(kept);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_stays_and_the_cut_off_is_at_half_power() {
        let mut constant = vec![3.5; 1000];
        decimate(&mut constant, 10, 3.5);
        assert!(constant.iter().all(|v| (v - 3.5).abs() < 1e-12) && constant.len() == 100);

        // 10 kHz to 1 kHz: half the power of a 400 Hz tone is left.
        let mut tone: Vec<f64> = (0..20_000).map(|k| (std::f64::consts::TAU * 0.04 * f64::from(k)).sin()).collect();
        decimate(&mut tone, 10, 0.0);
        let power = tone[1000..].iter().map(|v| v * v).sum::<f64>() / 1000.0;
        assert!((power - 0.25).abs() < 1e-3, "{power}");
    }
}
