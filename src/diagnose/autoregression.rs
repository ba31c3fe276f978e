//! The likelihood of a series of throws, whose scatter is an autoregression of first order beside independent errors.

/// A first-order autoregression, and independent errors.
pub(super) struct Autoregression {
    /// Lag-1 correlation of the autoregression.
    pub(super) phi: f64,
    /// Variance of the autoregression.
    pub(super) natural: f64,
    /// Variance of the errors.
    pub(super) error: f64,
}

impl Autoregression {
    /// The innovations of a series relative to their standard deviations (Kalman filter), and the logarithm of the
    /// determinant of its covariance.
    pub(super) fn whitened(&self, series: &[f64]) -> (Vec<f64>, f64) {
        let (mut mean, mut variance, mut ln_determinant) = (0.0, self.natural, 0.0);
        let innovation = |value: &f64| {
            let of_innovation = variance + self.error;
            let (innovation, gain) = (value - mean, variance / of_innovation);
            mean = self.phi * (mean + gain * innovation);
            variance = self.phi * self.phi * variance * (1.0 - gain) + self.natural * (1.0 - self.phi * self.phi);
            ln_determinant += of_innovation.ln();
            innovation / of_innovation.sqrt()
        };
        let white = series.iter().map(innovation).collect();
        (white, ln_determinant)
    }
}

/// Logarithm of the sum of numbers with these logarithms.
pub(super) fn ln_sum(logarithms: impl Iterator<Item = f64> + Clone) -> f64 {
    let largest = logarithms.clone().fold(f64::NEG_INFINITY, f64::max);
    largest + logarithms.map(|l| (l - largest).exp()).sum::<f64>().ln()
}

/// Scalar product.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
