//! Symmetric 3x3 matrices: storage as six numbers for the snapshot, and the inverse.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use super::to_f32;

/// The upper triangle, row by row: 00, 01, 02, 11, 12, 22.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub(crate) struct Sym3([f32; 6]);

impl From<Matrix3<f64>> for Sym3 {
    fn from(m: Matrix3<f64>) -> Self {
        Self([m[(0, 0)], m[(0, 1)], m[(0, 2)], m[(1, 1)], m[(1, 2)], m[(2, 2)]].map(to_f32))
    }
}

impl From<Sym3> for Matrix3<f64> {
    fn from(Sym3(packed): Sym3) -> Self {
        let [a, b, c, d, e, f] = packed.map(f64::from);
        Self::new(a, b, c, b, d, e, c, e, f)
    }
}

/// Inverse of a covariance; `None` if it is not positive definite, as after rounding beside a far larger variance.
pub(crate) fn inverse(covariance: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    Some(covariance.cholesky()?.inverse())
}
