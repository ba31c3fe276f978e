//! The state-variable filter 1/A(s), discretised exactly for a signal that is constant or linear between its samples.
//!
//! Let v be the signal, x = v / A(s) its filtered value, and z = (x, x', …, x⁽ⁿ⁻¹⁾) the state. The companion form is
//! ż = F z + `e_n` v, with the n-th unit vector `e_n`. It gives over one sampling interval h, for a signal that is
//! linear between its samples,
//!
//! ```text
//! v(t_k + τ) = v_k + (v_{k+1} - v_k) τ/h
//! z_{k+1} = Φ z_k + Γ0 v_k + Γ1 (v_{k+1} - v_k)
//! Φ = e^{Fh},   Γ0 = ∫₀ʰ e^{Fτ} e_n dτ,   Γ1 = (1/h) ∫₀ʰ e^{F(h-τ)} e_n τ dτ
//! ```
//!
//! and Γ1 = 0 for a signal that is constant between its samples. With q = z - Γ1 v both holds have the same recursion,
//! which does not need the next sample,
//!
//! ```text
//! q_{k+1} = Φ q_k + Γ v_k,   z_k = q_k + Γ1 v_k,   Γ = Φ Γ1 + Γ0 - Γ1
//! ```
//!
//! The coordinates of the recursion are free. The controllable canonical form of Ψ = Φ - 1 needs N multiplications for
//! each sample, and is the same for both holds:
//!
//! ```text
//! s_i ← s_i + s_{i+1},   s_N ← s_N - α_1 s_N - … - α_N s_1 + v,   q = K s
//! ```
//!
//! with the coefficients α of the characteristic polynomial of Ψ (Faddeev, Leverrier) and the columns `k_N` = Γ,
//! `k_{N-j}` = Ψ `k_{N-j+1}` + `α_j` Γ of K. As Ψ is of the order of h, there is no cancellation at high sampling
//! rates.
//!
//! Ψ, Γ0 and Γ1 come from Taylor series with scaling and squaring, in time multiplied by the root radius ρ of A: then
//! powers of a fast pole do not dominate. The companion matrix in this time is that of `a_i` / ρ^i.

use nalgebra::{SMatrix, SVector};

use super::polynomial::{normalised, root_radius};
use crate::estimate::matrix::invert;

/// The values of a signal between two samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// Constant until the next sample: for a held input (zero-order hold).
    Zero,
    /// Linear to the next sample: for a measured signal (first-order hold).
    First,
}

/// The filter 1/A(s) at a sampling interval: the recursion of the states s, and the output of x and its derivatives for
/// each hold.
#[derive(Debug, Clone)]
pub(crate) struct Discrete<const N: usize> {
    /// `α_N` … `α_2`, in the order of the states that they multiply, and 1 - `α_1`.
    feedback: [f64; N],
    held: Readout<N>,
    linear: Readout<N>,
}

/// The output z = K s + D v of the filter for one hold: x and its derivatives.
#[derive(Debug, Clone)]
pub(crate) struct Readout<const N: usize> {
    /// K; row d belongs to the d-th derivative of x.
    pub(crate) state: [[f64; N]; N],
    /// D.
    pub(crate) through: [f64; N],
    /// K⁻¹.
    inverse: SMatrix<f64, N, N>,
}

/// Ψ = Φ - 1, the step response Γ0 and the ramp response h Γ1 over one interval, in normalised time.
struct Interval<const N: usize> {
    psi: SMatrix<f64, N, N>,
    step: SVector<f64, N>,
    ramp: SVector<f64, N>,
}

impl<const N: usize> Discrete<N> {
    /// Discretises 1/A(s) for the interval `h` \[s\], with A = s^N + `a_1` s^(N-1) + … + `a_N`. `None` if the samples
    /// do not determine all states: for poles that are not finite, or at a harmonic of the sampling rate.
    pub(crate) fn new(a: &[f64; N], h: f64) -> Option<Self> {
        let rho = root_radius(a);
        let interval = Interval::new(&normalised(a, rho), rho * h);
        let mut powers = SVector::repeat(1.0);
        for i in 1..N {
            powers[i] = powers[i - 1] * rho;
        }
        let scales = powers / (powers[N - 1] * rho);
        let alpha = characteristic(&interval.psi);
        let mut feedback: [f64; N] = std::array::from_fn(|i| alpha[N - 1 - i]);
        feedback[N - 1] = 1.0 - alpha[0];
        let through = interval.ramp / (rho * h);
        let gamma = interval.psi * through + interval.step;
        let held = Readout::new(&interval.psi, &alpha, interval.step, SVector::zeros(), &scales)?;
        let linear = Readout::new(&interval.psi, &alpha, gamma, through, &scales)?;
        Some(Self { feedback, held, linear })
    }

    pub(crate) fn readout(&self, hold: Hold) -> &Readout<N> {
        match hold {
            Hold::Zero => &self.held,
            Hold::First => &self.linear,
        }
    }

    /// Stores the state `s` before sample `k` in `states`, then advances it by this sample `v`.
    #[inline]
    pub(super) fn store_and_advance<const K: usize>(
        &self,
        s: &mut [f64; N],
        v: f64,
        states: &mut [[f64; K]; N],
        k: usize,
    ) {
        for i in 0..N {
            states[i][k] = s[i];
        }
        self.advance(s, v);
    }

    /// The recursion: advances the state `s` by the sample `v`.
    #[inline]
    pub(crate) fn advance(&self, s: &mut [f64; N], v: f64) {
        let mut back = -v;
        for i in 0..N - 1 {
            back += self.feedback[i] * s[i];
        }
        for i in 0..N - 1 {
            s[i] += s[i + 1];
        }
        s[N - 1] = self.feedback[N - 1] * s[N - 1] - back;
    }
}

impl<const N: usize> Readout<N> {
    /// K and D from values in normalised time; `scales` converts each derivative to seconds. `None` if K has no
    /// inverse.
    fn new(
        psi: &SMatrix<f64, N, N>,
        alpha: &[f64; N],
        gamma: SVector<f64, N>,
        through: SVector<f64, N>,
        scales: &SVector<f64, N>,
    ) -> Option<Self> {
        let mut column = gamma;
        let mut state = SMatrix::<f64, N, N>::zeros();
        for j in (0..N).rev() {
            state.set_column(j, &column.component_mul(scales));
            column = psi * column + gamma * alpha[N - 1 - j];
        }
        let (inverse, _) = invert(&state)?;
        Some(Self { state: state.transpose().into(), through: through.component_mul(scales).into(), inverse })
    }

    /// The derivative of x of this order (0 for x itself), from the state and the sample `v`.
    pub(crate) fn read(&self, derivative: usize, state: &[f64; N], v: f64) -> f64 {
        dot(&self.state[derivative], state) + self.through[derivative] * v
    }

    /// The sum of derivatives of x with the coefficients `polynomial` (that of the d-th derivative at index d), as
    /// weights on the states and on the sample.
    pub(super) fn combined(&self, polynomial: &[f64; N]) -> ([f64; N], f64) {
        (
            std::array::from_fn(|j| (0..N).map(|i| polynomial[i] * self.state[i][j]).sum()),
            dot(polynomial, &self.through),
        )
    }

    /// The state in which x and its derivatives are `z` at the sample `v0`.
    pub(crate) fn start(&self, z: &[f64; N], v0: f64) -> [f64; N] {
        (self.inverse * SVector::from_fn(|i, _| z[i] - self.through[i] * v0)).into()
    }
}

/// `α_1` … `α_N` of det(λ - Ψ) = λ^N + `α_1` λ^(N-1) + … (Faddeev, Leverrier).
fn characteristic<const N: usize>(psi: &SMatrix<f64, N, N>) -> [f64; N] {
    let mut alpha = [0.0; N];
    let mut power = *psi;
    for k in 0..N {
        if k > 0 {
            power = psi * (power + SMatrix::from_diagonal_element(alpha[k - 1]));
        }
        alpha[k] = -power.trace() / (k + 1) as f64;
    }
    alpha
}

impl<const N: usize> Interval<N> {
    /// Sums the Taylor series for an interval of h / 2^s, then doubles this interval s times.
    fn new(a: &[f64; N], h: f64) -> Self {
        let norm = h * (1.0 + a.iter().map(|a| a.abs()).sum::<f64>());
        let doublings = (norm / 0.25).log2().ceil().clamp(0.0, 64.0);
        let short = h / doublings.exp2();
        let mut interval = Self::taylor(a, short);
        let mut length = short;
        while length < 0.75 * h {
            interval = interval.doubled(length);
            length *= 2.0;
        }
        interval
    }

    /// Taylor series of Ψ = Σ Fᵏhᵏ/k! (from k = 1), of the step response Σ Fᵏe hᵏ⁺¹/(k+1)!, and of the ramp response
    /// Σ Fᵏe hᵏ⁺²/(k+2)! (both from k = 0). After 16 terms less than 1e-24 is missing at h|F| = 0.25.
    fn taylor(a: &[f64; N], h: f64) -> Self {
        let companion = SMatrix::<f64, N, N>::from_fn(|i, j| match i + 1 {
            next if next == N => -a[N - 1 - j],
            next => f64::from(u8::from(j == next)),
        });
        let (mut psi, mut term) = (SMatrix::zeros(), SMatrix::identity());
        for k in 1..=16 {
            term = companion * term * h / f64::from(k);
            psi += term;
        }
        let (mut step, mut ramp) = (SVector::zeros(), SVector::zeros());
        let mut term = SVector::from_fn(|i, _| if i + 1 == N { h } else { 0.0 });
        for k in 1..=16 {
            step += term;
            ramp += term * h / f64::from(k + 1);
            term = companion * term * h / f64::from(k + 1);
        }
        Self { psi, step, ramp }
    }

    /// The values for twice the interval, of the present length `length`.
    fn doubled(&self, length: f64) -> Self {
        let Self { psi, step, ramp } = self;
        Self {
            psi: psi * 2.0 + psi * psi,
            step: psi * step + step * 2.0,
            ramp: psi * ramp + ramp * 2.0 + step * length,
        }
    }
}

#[inline]
pub(crate) fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    let mut sum = 0.0;
    for i in 0..N {
        sum += a[i] * b[i];
    }
    sum
}
