//! Natural scatter of a machine from throw to throw.

use nalgebra::Vector3;

/// Natural scatter of ln b0, ln a1, ln a0 (weather, lubrication): a first-order autoregression over consecutive throws,
/// common to both directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scatter {
    /// Standard deviations.
    pub sd: [f64; 3],
    /// Serial correlation between consecutive throws of the machine.
    pub phi: f64,
    /// Degrees of freedom of Student's t of the innovations, at least 3; `None`: Gauss.
    pub tail: Option<u32>,
}

impl Scatter {
    /// The calibrated scatter.
    pub const USUAL: Self = Self { sd: [0.005, 0.03, 0.01], phi: 0.5, tail: None };

    /// The scatter of the throw after one with scatter `last`; `normal` gives standard normal numbers.
    pub fn next(&self, last: Vector3<f64>, mut normal: impl FnMut() -> f64) -> Vector3<f64> {
        let innovation = (1.0 - self.phi * self.phi).sqrt();
        let fresh = Vector3::from_fn(|_, _| self.draw(&mut normal)).component_mul(&Vector3::from(self.sd));
        self.phi * last + innovation * fresh
    }

    /// A random number with unit variance: Gauss or Student.
    fn draw(&self, mut normal: impl FnMut() -> f64) -> f64 {
        let gauss = normal();
        let Some(tail) = self.tail else { return gauss };
        let square: f64 = (0..tail).map(|_| normal().powi(2)).sum();
        let tail = f64::from(tail);
        gauss / (square / tail).sqrt() * ((tail - 2.0) / tail).sqrt()
    }
}
