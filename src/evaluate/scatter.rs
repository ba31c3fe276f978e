//! Natural scatter of a machine from throw to throw.

use nalgebra::Vector3;

/// Natural scatter of ln b0, ln a1, ln a0 by weather and lubrication: a first-order autoregression over consecutive
/// throws of the machine, common to both directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scatter {
    /// Standard deviations of ln b0, ln a1, ln a0.
    pub sd: [f64; 3],
    /// Correlation of consecutive throws of the machine.
    pub phi: f64,
    /// Degrees of freedom, at least 3, if the innovations have Student's t distribution; `None` for a Gaussian one.
    pub tail: Option<u32>,
}

impl Scatter {
    /// The calibrated scatter of a usual machine.
    pub const USUAL: Self = Self { sd: [0.005, 0.03, 0.01], phi: 0.5, tail: None };

    /// The scatter of the next throw. `last`: that of the throw before; `normal`: a source of standard normal numbers.
    pub fn next(&self, last: Vector3<f64>, mut normal: impl FnMut() -> f64) -> Vector3<f64> {
        let innovation = (1.0 - self.phi * self.phi).sqrt();
        let fresh = Vector3::from_fn(|_, _| self.draw(&mut normal)).component_mul(&Vector3::from(self.sd));
        self.phi * last + innovation * fresh
    }

    /// A random number with unit variance, Gaussian or from Student's t distribution.
    fn draw(&self, mut normal: impl FnMut() -> f64) -> f64 {
        let gauss = normal();
        let Some(tail) = self.tail else { return gauss };
        let square: f64 = (0..tail).map(|_| normal().powi(2)).sum();
        let tail = f64::from(tail);
        gauss / (square / tail).sqrt() * ((tail - 2.0) / tail).sqrt()
    }
}
