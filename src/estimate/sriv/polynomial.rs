//! Monic polynomials A(s) = s^N + `a_1` s^(N-1) + … + `a_N`, given by \[`a_1` … `a_N`\]: stability, and reflection of
//! roots.

use nalgebra::Complex;

/// Whether every root of the polynomial has a negative real part (Routh's scheme).
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

/// The polynomial whose roots are those of `a`, with the roots in the right half plane reflected to the left.
pub(super) fn reflected<const N: usize>(a: &[f64; N]) -> [f64; N] {
    let rho = root_radius(a);
    let mut roots = roots(&normalised(a, rho));
    for root in &mut roots {
        // A root on the imaginary axis gets a little damping, so that the filter decays.
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

/// Roots of the polynomial (Durand and Kerner's iteration, from points on a spiral).
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

/// The largest |`a_i|^(1/i)`, which is the largest magnitude of a root up to a factor of two; 1 if all coefficients are
/// 0.
pub(super) fn root_radius<const N: usize>(a: &[f64; N]) -> f64 {
    let radius = (1..).zip(a).fold(0.0, |radius: f64, (i, a)| radius.max(a.abs().powf(1.0 / f64::from(i))));
    if radius > 0.0 { radius } else { 1.0 }
}

/// The coefficients of A(ρ s) / ρ^N.
pub(super) fn normalised<const N: usize>(a: &[f64; N], rho: f64) -> [f64; N] {
    let mut power = 1.0;
    std::array::from_fn(|i| {
        power *= rho;
        a[i] / power
    })
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
}
