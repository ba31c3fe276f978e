//! No-load speed of a throw, and resistance and back-EMF constant if the supply voltage is known.
//!
//! The armature, equation (1), is V = R i + L i' + K ω. Integrated from the start of the motor it has no derivative,
//!
//! ```text
//! V t = R ∫i dt + L i + K θ
//! ```
//!
//! and is linear in R, L and K. The inrush, when θ is still small, separates R from K. If V is constant but unknown, the
//! same equation over V gives R / V and K / V.

use nalgebra::{Matrix3, Vector3};

use super::{features::Features, movement::Movement};

/// Lowest sampling rate that resolves the inrush: 60 samples in the 0.3 s of its decay \[Hz\].
const LEAST_RATE_HZ: f64 = 200.0;

/// Adds no-load speed, and with a supply voltage resistance and back-EMF constant, to the features of a throw.
pub(super) fn add_constants(
    features: &mut Features,
    supply_v: Option<f64>,
    movement: &Movement,
    (current, position): (&[f64], &[f64]),
    interval_s: f64,
    lead_mm: f64,
) {
    if interval_s * LEAST_RATE_HZ > 1.0 || movement.sign == 0.0 {
        return;
    }
    let radians_per_mm = std::f64::consts::TAU / lead_mm;
    let drive = movement.drive(current);
    let (start, end) = (movement.start(), movement.near_end);
    let amperes = |i: &f64| drive * (i - movement.current.mean);
    let (Some([first, current @ ..]), Some([_, position @ ..])) = (current.get(start..=end), position.get(start..=end))
    else {
        return;
    };
    // Sums of the products of charge, current, angle and time.
    let (mut sums, mut charge, mut before) = ([[0.0; 4]; 3], 0.0, amperes(first));
    for (k, (i, x)) in current.iter().zip(position).enumerate() {
        let now = amperes(i);
        charge += 0.5 * (before + now) * interval_s;
        before = now;
        let angle = movement.sign * (x - movement.position.mean) * radians_per_mm;
        let row = [charge, now, angle, (k + 1) as f64];
        for i in 0..3 {
            // Half of the products would be enough, but whole rows are computed two at a time.
            for j in 0..4 {
                sums[i][j] += row[i] * row[j];
            }
        }
    }
    let normal = Matrix3::from_fn(|i, j| sums[i.min(j)][i.max(j)]);
    let right = Vector3::from_fn(|i, _| interval_s * sums[i][3]);
    let solved = normal.try_inverse().map(|inverse: Matrix3<f64>| inverse * right);
    if let Some(solved) = solved.filter(|found| found[0] > 0.0 && found[2] > 0.0 && found.iter().all(|v| v.is_finite()))
    {
        features.resistance_ohm = supply_v.map(|volts| volts * solved[0]);
        features.back_emf_v_s_per_rad = supply_v.map(|volts| volts * solved[2]);
        features.no_load_speed_rad_per_s = Some(solved[2].recip());
    }
}
