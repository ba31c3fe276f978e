//! Dense algebra on small arrays, for the normal equations.

use nalgebra::{SMatrix, SVector};

/// Inverse of a matrix, and its reciprocal condition number.
pub(super) struct Inverse<const P: usize> {
    pub(super) inverse: [[f64; P]; P],
    /// Reciprocal condition number (1-norm) of the matrix after scaling its rows and columns to unit maximum.
    pub(super) rcond: f64,
}

/// Inverts after scaling rows and columns to unit maximum; `None` if singular or not finite.
pub(super) fn invert<const P: usize>(matrix: &[[f64; P]; P]) -> Option<Inverse<P>> {
    let m = SMatrix::<f64, P, P>::from_fn(|i, j| matrix[i][j]);
    let rows: [f64; P] = std::array::from_fn(|i| m.row(i).amax());
    let columns: [f64; P] =
        std::array::from_fn(|j| (0..P).fold(0.0, |max: f64, i| max.max((m[(i, j)] / rows[i]).abs())));
    if rows.iter().chain(&columns).any(|scale| !scale.is_normal()) {
        return None;
    }
    let scaled = SMatrix::<f64, P, P>::from_fn(|i, j| m[(i, j)] / (rows[i] * columns[j]));
    let inverse = scaled.try_inverse()?;
    let norm_1 = |m: &SMatrix<f64, P, P>| m.column_iter().fold(0.0, |max: f64, column| max.max(column.lp_norm(1)));
    let rcond = 1.0 / (norm_1(&scaled) * norm_1(&inverse));
    let inverse = std::array::from_fn(|i| std::array::from_fn(|j| inverse[(i, j)] / (columns[i] * rows[j])));
    rcond.is_finite().then_some(Inverse { inverse, rcond })
}

/// Scales the matrix of normal equations to a diagonal of 1, as its columns have different units. Returns it with the
/// scale of each column.
pub(super) fn unit_diagonal<const P: usize>(normal: &SMatrix<f64, P, P>) -> (SMatrix<f64, P, P>, SVector<f64, P>) {
    let scale = normal.diagonal().map(|square| square.sqrt().recip());
    (SMatrix::from_fn(|i, j| normal[(i, j)] * scale[i] * scale[j]), scale)
}

pub(super) fn times<const P: usize>(matrix: &[[f64; P]; P], vector: &[f64; P]) -> [f64; P] {
    std::array::from_fn(|i| matrix[i].iter().zip(vector).map(|(m, v)| m * v).sum())
}

pub(super) fn product<const P: usize>(left: &[[f64; P]; P], right: &[[f64; P]; P]) -> [[f64; P]; P] {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..P).map(|k| left[i][k] * right[k][j]).sum()))
}

/// The product A S Aᵀ of `outer` A and `inner` S.
pub(super) fn sandwich<const P: usize>(outer: &[[f64; P]; P], inner: &[[f64; P]; P]) -> [[f64; P]; P] {
    let half = product(outer, inner);
    std::array::from_fn(|i| std::array::from_fn(|j| (0..P).map(|k| half[i][k] * outer[j][k]).sum()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_inverse_undoes_its_matrix_and_has_its_condition_number() {
        let m = [[1e6, 2.0, 0.0], [3.0, 1e-6, 1.0], [0.0, 5.0, 2e3]];
        let inverse = invert(&m).unwrap().inverse;
        for i in 0..3 {
            for j in 0..3 {
                let product: f64 = (0..3).map(|k| m[i][k] * inverse[k][j]).sum();
                assert!((product - f64::from(u8::from(i == j))).abs() < 1e-9);
            }
        }
        assert!(invert(&[[1.0, 1.0], [1.0, 1.0]]).is_none_or(|i| i.rcond < 1e-15));
        assert!(invert(&[[f64::NAN, 1.0], [1.0, 1.0]]).is_none());
    }
}
