//! The sums of the normal equations over filter states and samples, and their conversion to derivatives.

use nalgebra::{SMatrix, SVector};

use super::{
    block::{BLOCK, Block, Samples},
    filter::Readout,
};

/// Number of partial sums of a sum, as a single chain of additions is slow.
const LANES: usize = 4;

/// The partial sums of one sum.
type Lanes = [f64; LANES];

/// Both sides of the instrumental-variable equations, summed over the samples in one pass.
pub(crate) struct Sums<const P: usize> {
    /// Σ z φ'.
    pub(crate) normal: SMatrix<f64, P, P>,
    /// Σ z (y - `c_N` `y_eq,f`).
    pub(crate) right: SVector<f64, P>,
}

/// Sums of products before the conversion to derivatives. The rows are the instrument (numerator columns, states of
/// x̂), `y_eq,f` and x̂. `T` is [`Lanes`] while the sums are formed, then a number.
pub(crate) struct Raw<const P: usize, T> {
    rows: [Row<P, T>; P],
    shift: Row<P, T>,
    model: Row<P, T>,
}

/// Sums of the products of one row with the regressor (numerator columns, states of y), with y, and with `y_eq,f`.
#[derive(Clone, Copy)]
struct Row<const P: usize, T> {
    columns: [T; P],
    output: T,
    shift: T,
}

impl<const P: usize> Raw<P, Lanes> {
    pub(super) const ZERO: Self = Self { rows: [Row::ZERO; P], shift: Row::ZERO, model: Row::ZERO };

    pub(crate) fn add<const IV: bool, const APART: bool, const SHIFTED: bool, const N: usize, const S: usize>(
        &mut self,
        block: &Block<N, S, P>,
    ) {
        for (i, row) in self.rows.iter_mut().enumerate() {
            row.add::<SHIFTED, N, S>(block.instrument::<IV>(i), block);
        }
        if SHIFTED {
            self.shift.add::<SHIFTED, N, S>(&block.shift, block);
        }
        if APART || !IV {
            self.model.add::<SHIFTED, N, S>(&block.model, block);
        }
    }

    pub(crate) fn total(&self) -> Raw<P, f64> {
        let Self { rows, shift, model } = self;
        Raw { rows: rows.each_ref().map(Row::total), shift: shift.total(), model: model.total() }
    }
}

impl<const P: usize> Row<P, Lanes> {
    const ZERO: Self = Self { columns: [[0.0; LANES]; P], output: [0.0; LANES], shift: [0.0; LANES] };

    fn add<const SHIFTED: bool, const N: usize, const S: usize>(&mut self, values: &Samples, block: &Block<N, S, P>) {
        // A local copy stays in registers.
        let mut row = *self;
        for from in (0..BLOCK).step_by(LANES) {
            for (sum, phi) in row.columns.iter_mut().zip(&block.phi) {
                add_products(sum, values, phi, from);
            }
            add_products(&mut row.output, values, &block.output, from);
            if SHIFTED {
                add_products(&mut row.shift, values, &block.shift, from);
            }
        }
        *self = row;
    }

    fn total(&self) -> Row<P, f64> {
        let total = |lanes: Lanes| lanes.iter().sum();
        Row { columns: self.columns.map(total), output: total(self.output), shift: total(self.shift) }
    }
}

/// Adds the products of the samples from `from` on, one to each partial sum.
#[inline]
fn add_products(sums: &mut Lanes, left: &Samples, right: &Samples, from: usize) {
    for lane in 0..LANES {
        sums[lane] += left[from + lane] * right[from + lane];
    }
}

impl<const P: usize> Row<P, f64> {
    fn add_scaled(&mut self, factor: f64, other: &Self) {
        for (sum, column) in self.columns.iter_mut().zip(&other.columns) {
            *sum += factor * column;
        }
        self.output += factor * other.output;
        self.shift += factor * other.shift;
    }
}

impl<const P: usize> Raw<P, f64> {
    /// Computes the sums of x̂ = Σ numerator · column + `a_N` `y_eq,f` from those of the columns and of `y_eq,f`. Valid
    /// if the auxiliary model has the denominator of the filter.
    pub(super) fn set_model(&mut self, numerators: &[f64], a_last: f64) {
        self.model.add_scaled(a_last, &self.shift);
        for (row, numerator) in self.rows.iter().zip(numerators) {
            self.model.add_scaled(*numerator, row);
        }
    }

    /// Converts the sums from states to derivatives; `c_last` is the last coefficient of C.
    pub(crate) fn sums<const N: usize>(&self, linear: &Readout<N>, c_last: f64) -> Sums<P> {
        let columns = |row: &Row<P, f64>| regressor(&row.columns, linear, row.output, row.shift);
        let right = |row: &Row<P, f64>| row.output - c_last * row.shift;
        let (rows, model, shift) = (self.rows.each_ref().map(columns), columns(&self.model), columns(&self.shift));
        let column = |j: usize| regressor(&rows.map(|row| row[j]), linear, model[j], shift[j]);
        let normal = std::array::from_fn(column).into();
        let right = regressor(&self.rows.each_ref().map(right), linear, right(&self.model), right(&self.shift));
        Sums { normal, right: right.into() }
    }
}

/// Converts a vector (columns, states of the filter of a signal v) to (columns, -`v_f⁽ᴺ⁻¹⁾` … -(`v_f` - `y_eq,f`)),
/// with the value `sample` of v and `shift` of `y_eq,f`.
#[inline]
pub(super) fn regressor<const N: usize, const P: usize>(
    raw: &[f64; P],
    linear: &Readout<N>,
    sample: f64,
    shift: f64,
) -> [f64; P] {
    let mut regressor = *raw;
    for i in 0..N {
        let mut derivative = linear.through[i] * sample;
        for j in 0..N {
            derivative += linear.state[i][j] * raw[P - N + j];
        }
        regressor[P - 1 - i] = -derivative;
    }
    regressor[P - 1] += shift;
    regressor
}
