//! The likelihood of a series of throws whose scatter is the sum of a first-order autoregression and independent
//! errors.

/// A process: the sum of a first-order autoregression and independent errors.
pub(crate) struct Autoregression {
    /// Lag-1 correlation of the autoregression.
    pub(crate) phi: f64,
    /// Variance of the autoregression.
    pub(super) natural: f64,
    /// Variance of the errors.
    pub(crate) error: f64,
}

/// Relative change of the variance from which the filter is stationary: the rounding error of a few steps.
const STATIONARY: f64 = 1e-15;

/// The Kalman filter of an [`Autoregression`]. Its weights depend only on the length of the series, so one filter
/// serves many series.
pub(crate) struct Whitening {
    /// For each value: the weights of its prediction and of the value itself in the next prediction, and the standard
    /// deviation of the innovation (value minus prediction). The last entry serves all further values, too.
    steps: Vec<[f64; 3]>,
    /// Logarithm of the determinant of the covariance of a series.
    pub(super) ln_determinant: f64,
}

impl Autoregression {
    /// The filter for series of this length.
    pub(super) fn whitening(&self, len: usize) -> Whitening {
        let (mut variance, mut ln_determinant) = (self.natural, 0.0);
        let mut steps = Vec::new();
        for at in 0..len {
            let of_innovation = variance + self.error;
            let gain = variance / of_innovation;
            steps.push([self.phi * (1.0 - gain), self.phi * gain, of_innovation.sqrt()]);
            let next = self.phi * self.phi * variance * (1.0 - gain) + self.natural * (1.0 - self.phi * self.phi);
            if (next - variance).abs() <= STATIONARY * variance {
                ln_determinant += (len - at) as f64 * of_innovation.ln();
                break;
            }
            ln_determinant += of_innovation.ln();
            variance = next;
        }
        Whitening { steps, ln_determinant }
    }
}

impl Whitening {
    /// The innovations of a series relative to their standard deviations.
    pub(crate) fn of(&self, series: &[f64]) -> Vec<f64> {
        let mut mean = 0.0;
        let innovation = |(value, [of_mean, of_value, sd]): (&f64, &[f64; 3])| {
            let innovation = (value - mean) / sd;
            mean = of_mean * mean + of_value * value;
            innovation
        };
        let stationary = self.steps.last().into_iter().cycle();
        series.iter().zip(self.steps.iter().chain(stationary)).map(innovation).collect()
    }
}

/// Logarithm of the sum of numbers with these logarithms.
pub(crate) fn ln_sum(logarithms: impl Iterator<Item = f64> + Clone) -> f64 {
    let largest = logarithms.clone().fold(f64::NEG_INFINITY, f64::max);
    largest + logarithms.map(|l| (l - largest).exp()).sum::<f64>().ln()
}

/// Scalar product.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
