//! A machine at parameter depth: coefficients drawn from a calibrated scatter, without a simulated movement.
//!
//! The logarithms of (b0, a1, a0) of a throw are the sum of
//! - the nominal values of the machine, slightly different in the two directions,
//! - the drift of the life,
//! - natural scatter, usually with standard deviations of 0.5, 3 and 1 %,
//! - the error of the estimator, with the covariance measured on simulated throws. At the default sensor noise of 0.02
//!   A its standard deviations are 0.53, 0.60 and 0.52 %, and its correlations 0.97 (b0, a1), 0.91 (b0, a0) and 0.79
//!   (a1, a0). Each observation contains this covariance.

use nalgebra::{Matrix3, Vector3};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::{scatter::Scatter, scenario::Noise};

/// Nominal b0 \[rad s⁻² A⁻¹\], a1 \[s⁻¹\], a0 \[s⁻²\] of the simulated machine.
const NOMINAL: [f64; 3] = [203.0, 5.9, 1.56];
/// Standard deviations of the nominal logarithms between machines, and between the directions of one machine.
const SPREAD_SD: [f64; 2] = [0.05, 0.02];

/// Standard deviations of the estimator's errors of ln b0, ln a1, ln a0, measured at each noise of the current.
const fn estimator_sd(noise: Noise) -> [f64; 3] {
    match noise {
        Noise::Low => [0.0013, 0.0015, 0.0013],
        Noise::Default => [0.0053, 0.0060, 0.0052],
        Noise::High => [0.0132, 0.0151, 0.0129],
    }
}

/// Correlations of the estimator's errors.
const ESTIMATOR_CORRELATION: [[f64; 3]; 3] = [[1.0, 0.97, 0.91], [0.97, 1.0, 0.79], [0.91, 0.79, 1.0]];

/// A machine with random coefficients and natural scatter.
#[derive(Debug, Clone)]
pub(super) struct ParameterMachine {
    random: ChaCha8Rng,
    /// Logarithms of the nominal coefficients in each direction.
    nominal: [Vector3<f64>; 2],
    /// Natural scatter of the last throw.
    last_scatter: Vector3<f64>,
    scatter: Scatter,
    /// Covariance of the estimator's errors of the logarithms.
    estimator_covariance: Matrix3<f64>,
    /// Its Cholesky factor.
    estimator_factor: Matrix3<f64>,
}

impl ParameterMachine {
    /// A random machine with sensors of this `noise` and this natural `scatter`.
    pub(super) fn new(mut random: ChaCha8Rng, noise: Noise, scatter: Scatter) -> Self {
        let between_machines = draw(&mut random).map(|x| x * SPREAD_SD[0]);
        let nominal = [(); 2].map(|()| {
            let between_directions = draw(&mut random).map(|x| x * SPREAD_SD[1]);
            Vector3::from(NOMINAL).map(f64::ln) + between_machines + between_directions
        });
        let last_scatter = draw(&mut random).component_mul(&Vector3::from(scatter.sd));
        let sd = estimator_sd(noise);
        let estimator_covariance = Matrix3::from_fn(|i, j| sd[i] * sd[j] * ESTIMATOR_CORRELATION[i][j]);
        // The constants are positive definite. If they were not, the test below would find the missing errors.
        let estimator_factor = estimator_covariance.cholesky().map_or_else(Matrix3::zeros, |factor| factor.l());
        Self { random, nominal, last_scatter, scatter, estimator_covariance, estimator_factor }
    }

    /// Estimates (b0, a1, a0) of the next throw, with their covariance. `drift`: change of the true logarithms.
    pub(super) fn throw(&mut self, direction: usize, drift: Vector3<f64>) -> ([f64; 3], Matrix3<f64>) {
        self.last_scatter = self.scatter.next(self.last_scatter, || self.random.sample(StandardNormal));
        let error = self.estimator_factor * draw(&mut self.random);
        let theta = (self.nominal[direction] + drift + self.last_scatter + error).map(f64::exp);
        let scale = Matrix3::from_diagonal(&theta);
        (theta.into(), scale * self.estimator_covariance * scale)
    }
}

fn draw(random: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| random.sample(StandardNormal))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::random::stream;

    #[test]
    fn throws_scatter_as_calibrated() {
        let scatter = Scatter::USUAL;
        let mut machine = ParameterMachine::new(stream(7, 0, 0, 0), Noise::Default, scatter);
        let throws: Vec<Vector3<f64>> =
            (0..40_000).map(|_| Vector3::from(machine.throw(0, Vector3::zeros()).0).map(f64::ln)).collect();
        let mean = throws.iter().sum::<Vector3<f64>>() / throws.len() as f64;
        let covariance = |lag: usize| {
            let pairs = throws.iter().zip(&throws[lag..]);
            pairs.map(|(x, y)| (x - mean) * (y - mean).transpose()).sum::<Matrix3<f64>>() / (throws.len() - lag) as f64
        };
        let (now, next) = (covariance(0), covariance(1));
        let estimator = estimator_sd(Noise::Default);
        for i in 0..3 {
            let expected = scatter.sd[i].powi(2) + estimator[i].powi(2);
            assert!((now[(i, i)] / expected - 1.0).abs() < 0.05, "variance {i}: {} of {expected}", now[(i, i)]);
            let expected = scatter.phi * scatter.sd[i].powi(2);
            assert!((next[(i, i)] / expected - 1.0).abs() < 0.15, "lag 1 of {i}: {} of {expected}", next[(i, i)]);
        }
        let expected = 0.97 * estimator[0] * estimator[1];
        assert!((now[(0, 1)] / expected - 1.0).abs() < 0.1, "{} of {expected}", now[(0, 1)]);
    }
}
