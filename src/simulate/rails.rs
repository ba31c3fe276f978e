//! The switch rails: a beam of Euler-Bernoulli finite elements, clamped at the heel, reduced to a few vibration modes.
//!
//! Both rails move together and count as one beam with twice the mass and stiffness. Each element has cubic Hermite
//! shape functions, two degrees of freedom a node (deflection, slope) and a consistent mass matrix. The toe node
//! carries a lumped mass. With mass matrix M and stiffness matrix K, the eigenproblem K f = w² M f gives
//! mass-normalised modes f, of which those with the lowest frequencies w are kept. The slide chairs are at the nodes,
//! and each carries its share of the rails' weight.

use nalgebra::{Cholesky, DMatrix, SymmetricEigen};
use serde::{Deserialize, Serialize};

use crate::throw::{
    Range::{Above, AtLeast, Within},
    settings,
};

/// Acceleration of free fall \[m s⁻²\].
const GRAVITY: f64 = 9.81;
/// Largest number of modes, which sets the size of the state vector.
pub const MAX_MODES: usize = 6;
/// Largest number of finite elements, so that the eigenproblem takes milliseconds.
const MAX_ELEMENTS: usize = 40;

/// Model of the bending of the rails.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RailModel {
    /// The bending line of slow movement: a single mass, spring and chair.
    Lumped,
    /// Finite elements reduced to modes.
    #[default]
    Beam,
}

settings! {
    /// The two switch rails and their slide chairs.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    pub struct Rails {
        /// Model of the bending.
        pub model: RailModel = RailModel::Beam;
        /// Length from heel to toe \[m\].
        pub length_m: f64 = 6.5, Above(0.0);
        /// Mass of one rail per length \[kg/m\].
        pub mass_kg_m: f64 = 56.0, Above(0.0);
        /// Lateral bending stiffness EI of one rail \[N m²\].
        pub bending_stiffness_n_m2: f64 = 8.8e5, Above(0.0);
        /// Mass of stretcher bar and fittings at the toe \[kg\].
        pub toe_mass_kg: f64 = 40.0, AtLeast(0.0);
        /// Damping ratio of every mode.
        pub damping_ratio: f64 = 0.02, AtLeast(0.0);
        /// Coefficient mu of dry friction between rail and slide chair.
        pub slide_friction: f64 = 0.0, AtLeast(0.0);
        /// Number of finite elements, with a chair at the end of each (beam only).
        pub elements: usize = 13, Within(3.0, MAX_ELEMENTS as f64, "");
        /// Number of modes, 1 to 6 (beam only).
        pub modes: usize = 5, Within(1.0, MAX_MODES as f64, "");
    }
}

/// A slide chair.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chair {
    /// Deflection of each mode at the chair \[kg^-1/2\].
    pub shape: [f64; MAX_MODES],
    /// Weight on the chair \[N\].
    pub normal_n: f64,
}

/// Mass-normalised modes of the rails, with the heel clamped and the toe free.
#[derive(Debug, Clone)]
pub(super) struct Modes {
    pub count: usize,
    /// Stiffness of each mode, which is its squared natural frequency \[rad² s⁻²\].
    pub stiffness: [f64; MAX_MODES],
    /// Deflection of each mode at the toe \[kg^-1/2\].
    pub toe: [f64; MAX_MODES],
    pub chairs: Vec<Chair>,
}

/// Mass, damping and stiffness of the rails as seen at the toe in slow movement, and the weight on their chairs.
#[derive(Debug, Clone, Copy)]
pub(super) struct QuasiStatic {
    pub mass_kg: f64,
    pub damping_ns_m: f64,
    pub stiffness_n_m: f64,
    /// Sum of the weights on the chairs \[N\], each multiplied by the movement at the chair over that of the toe.
    pub normal_n: f64,
}

impl Rails {
    /// The modes of the rails. The parameters must have passed [`Rails::check_ranges`].
    pub(super) fn modes(&self) -> Modes {
        match self.model {
            RailModel::Lumped => self.lumped(),
            RailModel::Beam => self.beam(),
        }
    }

    /// A single mode: the static bending line s(z) = (3 z² - z³)/2 under a force at the toe, with the distance z from
    /// the heel over the length L. At the toe it has 33/140 of the rails' mass, the stiffness 3 EI/L³, and 3/8 of the
    /// weight.
    fn lumped(&self) -> Modes {
        let rails_kg = 2.0 * self.mass_kg_m * self.length_m;
        let mass = 33.0 / 140.0 * rails_kg + self.toe_mass_kg;
        let stiffness = 3.0 * 2.0 * self.bending_stiffness_n_m2 / self.length_m.powi(3);
        let single = |value: f64| {
            let mut array = [0.0; MAX_MODES];
            array[0] = value;
            array
        };
        let shape = single(mass.sqrt().recip());
        let chair = Chair { shape, normal_n: 3.0 / 8.0 * rails_kg * GRAVITY };
        Modes { count: 1, stiffness: single(stiffness / mass), toe: shape, chairs: vec![chair] }
    }

    fn beam(&self) -> Modes {
        let (mass, stiffness) = self.matrices();
        let freedoms = mass.nrows();
        let (values, vectors) = generalised_eigen(mass, &stiffness);
        let mut order: Vec<usize> = (0..freedoms).collect();
        order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
        let count = self.modes.min(freedoms);
        // A value of each mode that is kept, from the lowest frequency up.
        let of_modes = |value: &dyn Fn(usize) -> f64| -> [f64; MAX_MODES] {
            std::array::from_fn(|k| if k < count { value(order[k]) } else { 0.0 })
        };
        let shape_at = |freedom: usize| of_modes(&|mode| vectors[(freedom, mode)]);
        let share = 2.0 * self.mass_kg_m * GRAVITY * self.length_m / self.elements as f64;
        let chairs = (1..=self.elements)
            .map(|node| {
                // The toe node carries half an element.
                let normal_n = if node == self.elements { 0.5 * share } else { share };
                Chair { shape: shape_at(2 * (node - 1)), normal_n }
            })
            .collect();
        Modes { count, stiffness: of_modes(&|mode| values[mode]), toe: shape_at(freedoms - 2), chairs }
    }

    /// Mass and stiffness matrices of both rails. The degrees of freedom are deflection and slope of the nodes 1 to
    /// `elements`.
    fn matrices(&self) -> (DMatrix<f64>, DMatrix<f64>) {
        let h = self.length_m / self.elements as f64;
        let m = 2.0 * self.mass_kg_m * h / 420.0;
        let k = 2.0 * self.bending_stiffness_n_m2 / h.powi(3);
        #[rustfmt::skip]
        let element_mass = [
            [156.0,      22.0 * h,       54.0,      -13.0 * h],
            [22.0 * h,   4.0 * h * h,    13.0 * h,  -3.0 * h * h],
            [54.0,       13.0 * h,       156.0,     -22.0 * h],
            [-13.0 * h,  -3.0 * h * h,   -22.0 * h, 4.0 * h * h],
        ];
        #[rustfmt::skip]
        let element_stiffness = [
            [12.0,     6.0 * h,      -12.0,     6.0 * h],
            [6.0 * h,  4.0 * h * h,  -6.0 * h,  2.0 * h * h],
            [-12.0,    -6.0 * h,     12.0,      -6.0 * h],
            [6.0 * h,  2.0 * h * h,  -6.0 * h,  4.0 * h * h],
        ];
        let freedoms = 2 * self.elements;
        let mut mass = DMatrix::zeros(freedoms, freedoms);
        let mut stiffness = DMatrix::zeros(freedoms, freedoms);
        for element in 0..self.elements {
            for row in 0..4 {
                for column in 0..4 {
                    // The two degrees of freedom of the heel are clamped and have no row or column.
                    if let (Some(i), Some(j)) =
                        ((2 * element + row).checked_sub(2), (2 * element + column).checked_sub(2))
                    {
                        mass[(i, j)] += m * element_mass[row][column];
                        stiffness[(i, j)] += k * element_stiffness[row][column];
                    }
                }
            }
        }
        mass[(freedoms - 2, freedoms - 2)] += self.toe_mass_kg;
        (mass, stiffness)
    }
}

/// Eigenvalues and mass-normalised eigenvectors of K f = w² M f, through the Cholesky factor of M.
#[expect(clippy::expect_used, reason = "a consistent mass matrix of checked parameters is positive definite")]
fn generalised_eigen(mass: DMatrix<f64>, stiffness: &DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    let lower = Cholesky::new(mass).expect("mass matrix").l();
    let half = lower.solve_lower_triangular(stiffness).expect("no zero on the diagonal");
    let standard = lower.solve_lower_triangular(&half.transpose()).expect("no zero on the diagonal");
    let eigen = SymmetricEigen::new((&standard + standard.transpose()) * 0.5);
    let vectors = lower.tr_solve_lower_triangular(&eigen.eigenvectors).expect("no zero on the diagonal");
    (eigen.eigenvalues.iter().copied().collect(), vectors)
}

impl Modes {
    /// Deflection of the toe for a static force there \[m/N\].
    pub(super) fn toe_compliance(&self) -> f64 {
        (0..self.count).map(|k| self.toe[k] * self.toe[k] / self.stiffness[k]).sum()
    }

    /// Coordinate of each mode in equilibrium with the toe held at `toe_m`.
    pub(super) fn held_at(&self, toe_m: f64) -> [f64; MAX_MODES] {
        let force = toe_m / self.toe_compliance();
        std::array::from_fn(|k| if k < self.count { self.toe[k] / self.stiffness[k] * force } else { 0.0 })
    }

    pub(super) fn quasi_static(&self, damping_ratio: f64) -> QuasiStatic {
        let line = self.held_at(1.0);
        let mass_kg = line.iter().map(|q| q * q).sum();
        let damping_ns_m =
            line.iter().zip(&self.stiffness).map(|(q, omega2)| 2.0 * damping_ratio * omega2.sqrt() * q * q).sum();
        let moved = |chair: &Chair| chair.shape.iter().zip(&line).map(|(shape, q)| shape * q).sum::<f64>();
        let normal_n = self.chairs.iter().map(|chair| chair.normal_n * moved(chair).abs()).sum();
        QuasiStatic { mass_kg, damping_ns_m, stiffness_n_m: self.toe_compliance().recip(), normal_n }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn the_beam_has_the_known_frequencies() {
        // Clamped-free beam with a toe mass of 40 kg.
        let modes = Rails::default().modes();
        for (omega2, hz) in modes.stiffness.iter().zip([1.50, 9.56, 27.1, 53.5, 89.1]) {
            let found = omega2.sqrt() / TAU;
            assert!((found / hz - 1.0).abs() < 0.005, "{found} Hz, expected {hz}");
        }
        // Without the mass, the textbook has the wave numbers b with (b L)² = 3.5160, 22.034, 61.697.
        let bare = Rails { toe_mass_kg: 0.0, ..Rails::default() };
        let unit = (8.8e5_f64 / 56.0).sqrt() / (6.5 * 6.5);
        for (omega2, known) in bare.modes().stiffness.iter().zip([3.5160, 22.034, 61.697]) {
            assert!((omega2.sqrt() / unit / known - 1.0).abs() < 1e-3);
        }
    }

    #[test]
    fn the_slow_beam_is_the_lumped_one() {
        let beam = Rails::default().modes().quasi_static(0.02);
        let lumped = Rails { model: RailModel::Lumped, ..Rails::default() }.modes().quasi_static(0.02);
        assert!((beam.mass_kg / lumped.mass_kg - 1.0).abs() < 0.01);
        assert!((beam.stiffness_n_m / lumped.stiffness_n_m - 1.0).abs() < 0.01);
        assert!((beam.normal_n / lumped.normal_n - 1.0).abs() < 0.02);
    }
}
