//! Sums of the products of several signals.

use std::ops::Range;

use super::lanes::LANES;

/// Number of samples that are multiplied at a time.
const BLOCK: usize = 64;
/// The partial sums of one sum.
type Lanes = [f64; LANES];

/// Sums of the products of each two of N signals, sample by sample. The samples are collected in blocks, one array a
/// signal, as the compiler then computes several products at a time.
pub(super) struct Products<const N: usize> {
    block: [[f64; BLOCK]; N],
    /// The sum for each two signals, the earlier signal first.
    lanes: [[Lanes; N]; N],
}

impl<const N: usize> Products<N> {
    pub(super) const ZERO: Self = Self { block: [[0.0; BLOCK]; N], lanes: [[[0.0; LANES]; N]; N] };

    /// The sum of the products of the signals `i` and `j`.
    pub(super) fn sum(&self, i: usize, j: usize) -> f64 {
        self.lanes[i.min(j)][i.max(j)].iter().sum()
    }

    /// The sum for each two signals. The matrix is symmetric.
    pub(super) fn sums(&self) -> [[f64; N]; N] {
        std::array::from_fn(|i| std::array::from_fn(|j| self.sum(i, j)))
    }

    /// Adds the products of these samples to the sums. `at` gives the value of each signal at a sample; it is called in
    /// the order of the samples.
    #[inline]
    pub(super) fn add(&mut self, samples: Range<usize>, mut at: impl FnMut(usize) -> [f64; N]) {
        for from in samples.clone().step_by(BLOCK) {
            for (place, sample) in (0..BLOCK).zip(from..samples.end) {
                for (signal, value) in self.block.iter_mut().zip(at(sample)) {
                    signal[place] = value;
                }
            }
            self.multiply(BLOCK.min(samples.end - from));
        }
    }

    /// Adds the products of the first `used` samples of the block to the sums.
    fn multiply(&mut self, used: usize) {
        let padded = used.next_multiple_of(LANES);
        for signal in &mut self.block {
            signal[used..padded].fill(0.0);
        }
        for i in 0..N {
            for j in i..N {
                add_products(&mut self.lanes[i][j], &self.block[i][..padded], &self.block[j][..padded]);
            }
        }
    }
}

/// Adds the products of two signals of the same length, a multiple of [`LANES`], to the partial sums.
fn add_products(sums: &mut Lanes, left: &[f64], right: &[f64]) {
    // A local copy stays in registers.
    let mut lanes = *sums;
    for (left, right) in left.as_chunks::<LANES>().0.iter().zip(right.as_chunks::<LANES>().0) {
        for lane in 0..LANES {
            lanes[lane] += left[lane] * right[lane];
        }
    }
    *sums = lanes;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The sums of small whole numbers are exact in any order.
    #[test]
    fn sums_are_those_of_all_samples() {
        let sample = |k: usize| [1.0, k as f64, ((k * k) % 7) as f64];
        for count in [0, 1, 7, 8, 63, 64, 65, 200] {
            let mut products = Products::<3>::ZERO;
            products.add(0..count / 3, sample);
            products.add(count / 3..count, sample);
            let sum = |i: usize, j: usize| (0..count).map(|k| sample(k)[i] * sample(k)[j]).sum::<f64>();
            let expected: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| sum(i, j)));
            assert_eq!(products.sums(), expected, "{count} samples");
        }
    }
}
