//! The state-variable filter 1/A(s), discretised exactly for what the signal does between its samples.
//!
//! With x = v / A(s) and the state z = (x, x', …, x⁽ⁿ⁻¹⁾), the companion form ż = F z + `e_n` v gives over one sampling
//! interval h, for `v(t_k` + τ) = `v_k` + (v_{k+1} - `v_k`) τ/h,
//!
//! ```text
//! z_{k+1} = Φ z_k + Γ0 v_k + Γ1 (v_{k+1} - v_k),   Φ = e^{Fh},   Γ0 = ∫₀ʰ e^{Fτ} e_n dτ,   Γ1 = (1/h) ∫₀ʰ e^{F(h-τ)} e_n τ dτ
//! ```
//!
//! and Γ1 = 0 for a held signal. The substitution q = z - Γ1 v turns both holds into one recursion without look-ahead,
//!
//! ```text
//! q_{k+1} = Φ q_k + Γ v_k,   z_k = q_k + Γ1 v_k,   Γ = Φ Γ1 + Γ0 - Γ1
//! ```
//!
//! Φ, Γ0 and Γ1 come from Taylor series in normalised time (the companion matrix of `a_i` / ρ^i, ρ its root radius, so
//! that no power of a fast pole spoils the others) with scaling and squaring.

use serde::{Deserialize, Serialize};

/// What a signal does between two samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Hold {
    /// Constant until the next sample: an input that is known to be held (zero-order hold).
    Zero,
    /// Linear to the next sample: a measured signal (first-order hold).
    #[default]
    First,
}

/// 1/A(s) for one hold: q⁺ = Φ q + Γ v, z = q + D v, where z holds x and its first N-1 derivatives.
#[derive(Debug, Clone, Copy)]
pub(super) struct Discrete<const N: usize> {
    pub(super) phi: [[f64; N]; N],
    pub(super) gamma: [f64; N],
    pub(super) through: [f64; N],
}

/// Φ, Γ0 and the ramp response R = h Γ1 over one interval, in normalised time.
struct Interval<const N: usize> {
    phi: [[f64; N]; N],
    step: [f64; N],
    ramp: [f64; N],
}

impl<const N: usize> Discrete<N> {
    /// Discretises 1/A(s), A monic with `a` = \[`a_1`, …, `a_N`\] (`a_i` belongs to s^(N-i)), for the interval `h` \[s\].
    pub(super) fn new(a: &[f64; N], h: f64, hold: Hold) -> Self {
        let rho = root_radius(a);
        let interval = Interval::new(&normalised(a, rho), rho * h);
        let mut powers = [1.0; N];
        for i in 1..N {
            powers[i] = powers[i - 1] * rho;
        }
        let top = powers[N - 1] * rho;
        let phi = std::array::from_fn(|i| std::array::from_fn(|j| interval.phi[i][j] * powers[i] / powers[j]));
        let step: [f64; N] = std::array::from_fn(|i| interval.step[i] * powers[i] / top);
        if hold == Hold::Zero {
            return Self { phi, gamma: step, through: [0.0; N] };
        }
        let through: [f64; N] = std::array::from_fn(|i| interval.ramp[i] / (rho * h) * powers[i] / top);
        let gamma = std::array::from_fn(|i| dot(&phi[i], &through) + step[i] - through[i]);
        Self { phi, gamma, through }
    }

    /// The state before the first sample `v0`, so that `z_0` = 0: the filter starts at rest.
    pub(super) fn rest(&self, v0: f64) -> [f64; N] {
        std::array::from_fn(|i| -self.through[i] * v0)
    }

    /// z at this sample.
    #[inline]
    pub(super) fn output(&self, q: &[f64; N], v: f64) -> [f64; N] {
        std::array::from_fn(|i| q[i] + self.through[i] * v)
    }

    /// q at the next sample.
    #[inline]
    pub(super) fn advance(&self, q: &[f64; N], v: f64) -> [f64; N] {
        std::array::from_fn(|i| {
            let mut sum = self.gamma[i] * v;
            for (phi, q) in self.phi[i].iter().zip(q) {
                sum += phi * q;
            }
            sum
        })
    }
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

    /// Σ Fᵏhᵏ/k!, Σ Fᵏe hᵏ⁺¹/(k+1)!, Σ Fᵏe hᵏ⁺²/(k+2)!; 16 terms leave less than 1e-24 at h|F| = 0.25.
    fn taylor(a: &[f64; N], h: f64) -> Self {
        let mut phi = [[0.0; N]; N];
        for (j, unit) in (0..N).map(|j| (j, std::array::from_fn(|i| f64::from(u8::from(i == j))))) {
            let mut term: [f64; N] = unit;
            for k in 1..=16 {
                for i in 0..N {
                    phi[i][j] += term[i];
                }
                term = companion(a, &term).map(|x| x * h / f64::from(k));
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
        Self { phi, step, ramp }
    }

    /// The interval of twice this length.
    fn doubled(&self, length: f64) -> Self {
        let phi =
            std::array::from_fn(|i| std::array::from_fn(|j| (0..N).map(|k| self.phi[i][k] * self.phi[k][j]).sum()));
        let step = std::array::from_fn(|i| dot(&self.phi[i], &self.step) + self.step[i]);
        let ramp = std::array::from_fn(|i| dot(&self.phi[i], &self.ramp) + self.ramp[i] + length * self.step[i]);
        Self { phi, step, ramp }
    }
}

/// F z for the companion matrix F of `a`.
fn companion<const N: usize>(a: &[f64; N], z: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|i| if i + 1 < N { z[i + 1] } else { -(0..N).map(|j| a[N - 1 - j] * z[j]).sum::<f64>() })
}

fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// max |`a_i|^(1/i)`, a radius that holds the roots of A up to a factor of two; 1 when all are zero.
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
