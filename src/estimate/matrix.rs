//! Dense algebra on small arrays, for the normal equations.

use nalgebra::SMatrix;

/// The inverse of a matrix, and the reciprocal condition number (1-norm) of the matrix after scaling its rows and columns
/// to unit maximum. `None` if it is singular or not finite.
pub(super) fn invert<const P: usize>(m: &SMatrix<f64, P, P>) -> Option<(SMatrix<f64, P, P>, f64)> {
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
    let inverse = SMatrix::from_fn(|i, j| inverse[(i, j)] / (columns[i] * rows[j]));
    rcond.is_finite().then_some((inverse, rcond))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_inverse_undoes_its_matrix_and_has_its_condition_number() {
        let m = SMatrix::from([[1e6, 2.0, 0.0], [3.0, 1e-6, 1.0], [0.0, 5.0, 2e3]]);
        let (inverse, _) = invert(&m).unwrap();
        assert!((m * inverse - SMatrix::identity()).amax() < 1e-9);
        // Norms of 1.5 and 2; then of 1 and 1, as the units of rows and columns do not count.
        for (m, expected) in [([[1.0, 0.5], [0.5, 1.0]], 1.0 / 3.0), ([[1e6, 0.0], [0.0, 1e-6]], 1.0)] {
            let (_, rcond) = invert(&SMatrix::from(m)).unwrap();
            assert!((rcond - expected).abs() < 1e-12, "{rcond}");
        }
        assert!(invert(&SMatrix::from([[1.0, 1.0], [1.0, 1.0]])).is_none_or(|(_, rcond)| rcond < 1e-15));
        assert!(invert(&SMatrix::from([[f64::NAN, 1.0], [1.0, 1.0]])).is_none());
    }
}
