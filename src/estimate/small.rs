//! Small dense algebra on arrays: the normal equations of a handful of parameters, and roots of short polynomials.

use nalgebra::Complex;

use super::filter::{normalised, root_radius};

/// Inverse and reciprocal condition of a matrix.
pub(super) struct Inverse<const P: usize> {
    pub(super) inverse: [[f64; P]; P],
    /// Reciprocal condition number (1-norm) of the matrix after scaling its rows and columns to unit maximum.
    pub(super) rcond: f64,
}

/// Inverts by Gauss-Jordan with partial pivoting after equilibration. `None` when singular or not finite.
pub(super) fn invert<const P: usize>(matrix: &[[f64; P]; P]) -> Option<Inverse<P>> {
    let amax = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, |max: f64, v| max.max(v.abs()));
    let rows: [f64; P] = std::array::from_fn(|i| amax(&mut matrix[i].iter().copied()));
    let cols: [f64; P] = std::array::from_fn(|j| amax(&mut (0..P).map(|i| matrix[i][j] / rows[i])));
    if rows.iter().chain(&cols).any(|scale| !scale.is_normal()) {
        return None;
    }
    let scaled: [[f64; P]; P] = std::array::from_fn(|i| std::array::from_fn(|j| matrix[i][j] / (rows[i] * cols[j])));
    let inverse = gauss_jordan(scaled)?;
    let rcond = 1.0 / (norm_1(&scaled) * norm_1(&inverse));
    let inverse = std::array::from_fn(|i| std::array::from_fn(|j| inverse[i][j] / (cols[i] * rows[j])));
    rcond.is_finite().then_some(Inverse { inverse, rcond })
}

fn gauss_jordan<const P: usize>(mut left: [[f64; P]; P]) -> Option<[[f64; P]; P]> {
    let mut right = [[0.0; P]; P];
    for (i, row) in right.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    for at in 0..P {
        let pivot = (at..P).max_by(|&i, &j| left[i][at].abs().total_cmp(&left[j][at].abs()))?;
        left.swap(at, pivot);
        right.swap(at, pivot);
        let scale = 1.0 / left[at][at];
        if !scale.is_finite() {
            return None;
        }
        left[at] = left[at].map(|v| v * scale);
        right[at] = right[at].map(|v| v * scale);
        for i in (0..P).filter(|&i| i != at) {
            let factor = left[i][at];
            for j in 0..P {
                left[i][j] -= factor * left[at][j];
                right[i][j] -= factor * right[at][j];
            }
        }
    }
    right.iter().flatten().all(|v| v.is_finite()).then_some(right)
}

fn norm_1<const P: usize>(matrix: &[[f64; P]; P]) -> f64 {
    (0..P).map(|j| (0..P).map(|i| matrix[i][j].abs()).sum()).fold(0.0, f64::max)
}

pub(super) fn times<const P: usize>(matrix: &[[f64; P]; P], vector: &[f64; P]) -> [f64; P] {
    std::array::from_fn(|i| matrix[i].iter().zip(vector).map(|(m, v)| m * v).sum())
}

/// A S Aᵀ.
pub(super) fn sandwich<const P: usize>(outer: &[[f64; P]; P], inner: &[[f64; P]; P]) -> [[f64; P]; P] {
    let half: [[f64; P]; P] =
        std::array::from_fn(|i| std::array::from_fn(|j| (0..P).map(|k| outer[i][k] * inner[k][j]).sum()));
    std::array::from_fn(|i| std::array::from_fn(|j| (0..P).map(|k| half[i][k] * outer[j][k]).sum()))
}

/// Whether every root of the monic polynomial with coefficients `a` has a negative real part (Routh's scheme).
pub(super) fn is_stable<const N: usize>(a: &[f64; N]) -> bool {
    if a.iter().any(|a| !a.is_finite() || *a <= 0.0) {
        return false;
    }
    let a = normalised(a, root_radius(a));
    let coefficient = |i: usize| if i == 0 { 1.0 } else { a.get(i - 1).copied().unwrap_or(0.0) };
    let mut upper: [f64; N] = std::array::from_fn(|j| coefficient(2 * j));
    let mut lower: [f64; N] = std::array::from_fn(|j| coefficient(2 * j + 1));
    for _ in 1..N {
        if lower[0] <= 0.0 {
            return false;
        }
        let ratio = upper[0] / lower[0];
        let next = std::array::from_fn(|j| {
            let after = |row: &[f64; N]| row.get(j + 1).copied().unwrap_or(0.0);
            after(&upper) - ratio * after(&lower)
        });
        (upper, lower) = (lower, next);
    }
    lower[0] > 0.0
}

/// `a` with the roots in the right half plane reflected to the left; unchanged when it is stable.
pub(super) fn reflected<const N: usize>(a: &[f64; N]) -> [f64; N] {
    let rho = root_radius(a);
    let mut roots = roots(&normalised(a, rho));
    for root in &mut roots {
        // A root on the axis would ring for ever: give it a little damping.
        root.re = -root.re.abs().max(1e-6);
    }
    let mut product = [Complex::new(0.0, 0.0); N];
    for (count, root) in roots.iter().enumerate() {
        for i in (0..=count).rev() {
            let before = if i == 0 { Complex::new(1.0, 0.0) } else { product[i - 1] };
            product[i] -= root * before;
        }
    }
    let mut power = 1.0;
    product.map(|c| {
        power *= rho;
        c.re * power
    })
}

/// Roots of the monic polynomial with coefficients `a` (Durand-Kerner from points on a spiral).
fn roots<const N: usize>(a: &[f64; N]) -> [Complex<f64>; N] {
    let seed = Complex::new(0.4, 0.9);
    let mut roots: [Complex<f64>; N] = std::array::from_fn(|i| (0..i).fold(seed, |power, _| power * seed));
    for _ in 0..200 {
        let mut change: f64 = 0.0;
        for i in 0..N {
            let value = a.iter().fold(Complex::new(1.0, 0.0), |value, a| value * roots[i] + a);
            let others =
                (0..N).filter(|&j| j != i).fold(Complex::new(1.0, 0.0), |product, j| product * (roots[i] - roots[j]));
            let step = if others.norm() > 0.0 { value / others } else { Complex::new(1e-6, 1e-6) };
            roots[i] -= step;
            change = change.max(step.norm());
        }
        if change < 1e-14 {
            break;
        }
    }
    roots
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn routh_agrees_with_the_roots() {
        assert!(is_stable(&[5.0, 408.0, 416.0, 1600.0]));
        assert!(is_stable(&[3.0]) && !is_stable(&[-3.0]) && is_stable(&[1.0, 4.0]));
        // (s² + s + 10)(s² - 0.1 s + 1): all coefficients positive, one pair unstable.
        let a = [0.9, 10.9, 0.0, 10.0];
        assert!(!is_stable(&a));
        let mirror = reflected(&a);
        // (s² + s + 10)(s² + 0.1 s + 1)
        for (got, want) in mirror.iter().zip([1.1, 11.1, 2.0, 10.0]) {
            assert!((got - want).abs() < 1e-9, "{mirror:?}");
        }
    }

    #[test]
    fn an_inverse_undoes_its_matrix_and_knows_its_condition() {
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
