//! The state-variable filter 1/A(s), discretised exactly for a hold of the signal between its samples.
//!
//! With x = v / A(s) and the state z = (x, x', …, x⁽ⁿ⁻¹⁾), the companion form ż = F z + `e_n` v gives over one sampling
//! interval h, for `v(t_k` + τ) = `v_k` + (v_{k+1} - `v_k`) τ/h,
//!
//! ```text
//! z_{k+1} = Φ z_k + Γ0 v_k + Γ1 (v_{k+1} - v_k),   Φ = e^{Fh},   Γ0 = ∫₀ʰ e^{Fτ} e_n dτ,   Γ1 = (1/h) ∫₀ʰ e^{F(h-τ)} e_n τ dτ
//! ```
//!
//! and Γ1 = 0 for a constant signal. With q = z - Γ1 v both holds have the same recursion without look-ahead,
//!
//! ```text
//! q_{k+1} = Φ q_k + Γ v_k,   z_k = q_k + Γ1 v_k,   Γ = Φ Γ1 + Γ0 - Γ1
//! ```
//!
//! The coordinates of the recursion are free. In the controllable canonical form of Ψ = Φ - 1 it needs N
//! multiplications for each sample, and is the same for both holds:
//!
//! ```text
//! s_i ← s_i + s_{i+1},   s_N ← s_N - α_1 s_N - … - α_N s_1 + v,   q = K s
//! ```
//!
//! with α the characteristic polynomial of Ψ (Faddeev, Leverrier) and the columns `k_N` = Γ, `k_{N-j}` = Ψ `k_{N-j+1}`
//! + `α_j` Γ. As Ψ is of the order of h, there is no cancellation at high sampling rates.
//!
//! Ψ, Γ0 and Γ1 come from Taylor series in normalised time (the companion matrix of `a_i` / ρ^i, with the root radius
//! ρ, so that powers of a fast pole do not dominate) with scaling and squaring.

use serde::{Deserialize, Serialize};

use super::{
    polynomial::{normalised, root_radius},
    small::{invert, product, times},
};

/// Course of a signal between two samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Hold {
    /// Constant until the next sample: for a held input (zero-order hold).
    Zero,
    /// Linear to the next sample: for a measured signal (first-order hold).
    #[default]
    First,
}

/// 1/A(s) at a sampling interval: the recursion, and the output of x and its derivatives for each hold.
#[derive(Debug, Clone)]
pub(super) struct Discrete<const N: usize> {
    /// `α_N` … `α_2`, in the order of their states, and 1 - `α_1`.
    feedback: [f64; N],
    held: Readout<N>,
    linear: Readout<N>,
}

/// z = K s + D v for one hold, and the inverse of K.
#[derive(Debug, Clone)]
pub(super) struct Readout<const N: usize> {
    pub(super) state: [[f64; N]; N],
    pub(super) through: [f64; N],
    inverse: [[f64; N]; N],
}

/// Ψ = Φ - 1, Γ0 and the ramp response R = h Γ1 over one interval, in normalised time.
struct Interval<const N: usize> {
    psi: [[f64; N]; N],
    step: [f64; N],
    ramp: [f64; N],
}

impl<const N: usize> Discrete<N> {
    /// Discretises 1/A(s), A monic with `a` = \[`a_1`, …, `a_N`\] (`a_i` belongs to s^(N-i)), for the interval `h`
    /// \[s\]. `None` if the samples do not determine all states: poles that are not finite, or at a harmonic of the
    /// sampling rate.
    pub(super) fn new(a: &[f64; N], h: f64) -> Option<Self> {
        let rho = root_radius(a);
        let interval = Interval::new(&normalised(a, rho), rho * h);
        let mut powers = [1.0; N];
        for i in 1..N {
            powers[i] = powers[i - 1] * rho;
        }
        let top = powers[N - 1] * rho;
        let scales = powers.map(|power| power / top);
        let alpha = characteristic(&interval.psi);
        let mut feedback: [f64; N] = std::array::from_fn(|i| alpha[N - 1 - i]);
        feedback[N - 1] = 1.0 - alpha[0];
        let none = [0.0; N];
        let through = interval.ramp.map(|ramp| ramp / (rho * h));
        let gamma = std::array::from_fn(|i| dot(&interval.psi[i], &through) + interval.step[i]);
        let held = Readout::new(&interval.psi, &alpha, &interval.step, &none, &scales)?;
        let linear = Readout::new(&interval.psi, &alpha, &gamma, &through, &scales)?;
        Some(Self { feedback, held, linear })
    }

    /// The output of x and its derivatives for a hold.
    pub(super) fn readout(&self, hold: Hold) -> &Readout<N> {
        match hold {
            Hold::Zero => &self.held,
            Hold::First => &self.linear,
        }
    }

    /// Stores the state before sample `k`, and advances it.
    #[inline]
    pub(super) fn pass<const K: usize>(&self, s: &mut [f64; N], v: f64, states: &mut [[f64; K]; N], k: usize) {
        for i in 0..N {
            states[i][k] = s[i];
        }
        self.advance(s, v);
    }

    #[inline]
    pub(super) fn advance(&self, s: &mut [f64; N], v: f64) {
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
    /// Made in normalised time; `scales` converts each derivative to seconds.
    fn new(
        psi: &[[f64; N]; N],
        alpha: &[f64; N],
        gamma: &[f64; N],
        through: &[f64; N],
        scales: &[f64; N],
    ) -> Option<Self> {
        let mut column = *gamma;
        let mut state = [[0.0; N]; N];
        for j in (0..N).rev() {
            for i in 0..N {
                state[i][j] = column[i] * scales[i];
            }
            let next = times(psi, &column);
            column = std::array::from_fn(|i| next[i] + alpha[N - 1 - j] * gamma[i]);
        }
        let through = std::array::from_fn(|i| through[i] * scales[i]);
        Some(Self { state, through, inverse: invert(&state)?.inverse })
    }

    /// The derivative of this order of x at a sample `v`.
    pub(super) fn read(&self, derivative: usize, state: &[f64; N], v: f64) -> f64 {
        dot(&self.state[derivative], state) + self.through[derivative] * v
    }

    /// The weights of a polynomial in derivatives of x (coefficient of the d-th at index d): on the states, and on the
    /// sample.
    pub(super) fn combined(&self, polynomial: &[f64; N]) -> ([f64; N], f64) {
        (
            std::array::from_fn(|j| (0..N).map(|i| polynomial[i] * self.state[i][j]).sum()),
            dot(polynomial, &self.through),
        )
    }

    /// The state for which x and its derivatives are `z` at the first sample `v0`.
    pub(super) fn start(&self, z: &[f64; N], v0: f64) -> [f64; N] {
        times(&self.inverse, &std::array::from_fn(|i| z[i] - self.through[i] * v0))
    }
}

/// `α_1` … `α_N` of det(λ - Ψ) = λ^N + `α_1` λ^(N-1) + … (Faddeev, Leverrier).
fn characteristic<const N: usize>(psi: &[[f64; N]; N]) -> [f64; N] {
    let mut alpha = [0.0; N];
    let mut power = *psi;
    for k in 0..N {
        if k > 0 {
            let mut shifted = power;
            for i in 0..N {
                shifted[i][i] += alpha[k - 1];
            }
            power = product(psi, &shifted);
        }
        alpha[k] = -(0..N).map(|i| power[i][i]).sum::<f64>() / (k + 1) as f64;
    }
    alpha
}

impl<const N: usize> Interval<N> {
    /// Taylor series for h / 2^s, then s doublings.
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

    /// Σ Fᵏhᵏ/k! from k = 1, Σ Fᵏe hᵏ⁺¹/(k+1)!, Σ Fᵏe hᵏ⁺²/(k+2)!; 16 terms leave less than 1e-24 at h|F| = 0.25.
    fn taylor(a: &[f64; N], h: f64) -> Self {
        let mut psi = [[0.0; N]; N];
        for j in 0..N {
            let mut term: [f64; N] = std::array::from_fn(|i| f64::from(u8::from(i == j)));
            for k in 1..=16 {
                term = companion(a, &term).map(|x| x * h / f64::from(k));
                for i in 0..N {
                    psi[i][j] += term[i];
                }
            }
        }
        let (mut step, mut ramp) = ([0.0; N], [0.0; N]);
        let mut term = [0.0; N];
        term[N - 1] = h;
        for k in 1..=16 {
            for i in 0..N {
                step[i] += term[i];
                ramp[i] += term[i] * h / f64::from(k + 1);
            }
            term = companion(a, &term).map(|x| x * h / f64::from(k + 1));
        }
        Self { psi, step, ramp }
    }

    /// The matrices of twice the interval.
    fn doubled(&self, length: f64) -> Self {
        let square = product(&self.psi, &self.psi);
        let psi = std::array::from_fn(|i| std::array::from_fn(|j| 2.0 * self.psi[i][j] + square[i][j]));
        let step = std::array::from_fn(|i| dot(&self.psi[i], &self.step) + 2.0 * self.step[i]);
        let ramp = std::array::from_fn(|i| dot(&self.psi[i], &self.ramp) + 2.0 * self.ramp[i] + length * self.step[i]);
        Self { psi, step, ramp }
    }
}

/// F z for the companion matrix F of `a`.
fn companion<const N: usize>(a: &[f64; N], z: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|i| if i + 1 < N { z[i + 1] } else { -(0..N).map(|j| a[N - 1 - j] * z[j]).sum::<f64>() })
}

/// Scalar product; a loop, as this is in the inner loop of a pass.
#[inline]
pub(super) fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    let mut sum = 0.0;
    for i in 0..N {
        sum += a[i] * b[i];
    }
    sum
}
