//! Resistance and back-EMF constant from a throw with a known supply voltage.
//!
//! The armature, equation (1), is V = R i + L i' + K ω. Integrated from the start of the motor it has no derivative,
//!
//! ```text
//! V t = R ∫i dt + L i + K θ
//! ```
//!
//! and is linear in R, L and K. The inrush, when θ is still small, separates R from K.

use nalgebra::{Matrix3, Vector3};

use super::{features::Features, movement::Movement};

/// Lowest sampling rate that resolves the inrush: 60 samples in the 0.3 s of its decay \[Hz\].
const LEAST_RATE_HZ: f64 = 200.0;

/// Adds energy, resistance and back-EMF constant to the features of a throw.
pub(super) fn add_supply(
    features: &mut Features,
    supply_v: f64,
    movement: &Movement,
    (current, position): (&[f64], &[f64]),
    interval_s: f64,
    lead_mm: f64,
) {
    features.energy_j = features.charge_as.map(|charge_as| charge_as * supply_v);
    if interval_s * LEAST_RATE_HZ > 1.0 || movement.sign == 0.0 {
        return;
    }
    let radians_per_mm = std::f64::consts::TAU / lead_mm;
    let drive = movement.drive(current);
    let (start, end) = (movement.start(), movement.near_end);
    let amperes = |k: usize| drive * (current[k] - movement.current.mean);
    // Sums of the products of charge, current, angle and time.
    let (mut sums, mut charge) = ([[0.0; 4]; 3], 0.0);
    for k in start + 1..=end {
        charge += 0.5 * (amperes(k - 1) + amperes(k)) * interval_s;
        let angle = movement.sign * (position[k] - movement.position.mean) * radians_per_mm;
        let row = [charge, amperes(k), angle, (k - start) as f64];
        for i in 0..3 {
            for j in i..4 {
                sums[i][j] += row[i] * row[j];
            }
        }
    }
    let normal = Matrix3::from_fn(|i, j| sums[i.min(j)][i.max(j)]);
    let right = Vector3::from_fn(|i, _| supply_v * interval_s * sums[i][3]);
    let solved = normal.try_inverse().map(|inverse: Matrix3<f64>| inverse * right);
    if let Some(solved) = solved.filter(|found| found[0] > 0.0 && found[2] > 0.0 && found.iter().all(|v| v.is_finite()))
    {
        features.resistance_ohm = Some(solved[0]);
        features.back_emf_v_s_per_rad = Some(solved[2]);
    }
}
