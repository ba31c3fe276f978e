//! No-load speed of a throw, and resistance and back-EMF constant if the supply voltage is known.
//!
//! The equation of the armature, (1), is V = R i + L i' + K ω, with supply voltage V, resistance R, inductance L,
//! back-EMF constant K and speed ω. Its integral from the start of the motor has no derivative. The toe may start later
//! than the motor, because of play, lost motion or a late position, and the motor starts at an unknown moment between
//! two samples. So while the toe moves, the angle of the motor is that of the toe plus a constant, and the time since
//! the start is known up to a constant. Both constants are in c:
//!
//! ```text
//! V t = R ∫i dt + L i + K θ + c
//! ```
//!
//! with the angle θ of the toe, in radians of the screw. The equation is linear in R, L, K and c. The rest of the
//! inrush after the first movement of the toe separates R from K. (Without c, 0.2 mm of play changes R by a factor of
//! two.) If V is constant but unknown, the equation divided by V gives R / V and K / V.
//!
//! The back-EMF of a series-wound motor is k i ω. Then ∫i dθ stands for θ, and k for K. Its iron may saturate, which
//! the equation does not contain: with strong saturation the resistance is too small, and a change of the resistance
//! looks up to twice as large. Other laws of the flux do not help, as the current of one throw hardly separates them
//! from R. So only the resistance of a series-wound motor is used, and only its changes.

use nalgebra::{Matrix4, Vector4};

use super::{features::Features, settings::Motor, trace::movement::Movement};

/// Lowest sampling rate that resolves the inrush \[Hz\]: it gives 60 samples in the 0.3 s of the inrush.
pub(super) const LEAST_RATE_HZ: f64 = 200.0;
/// The toe counts as moving after this share of its travel (0.3 mm of 115 mm), and after this many standard deviations
/// of the position's noise.
pub(super) const MOVES_SHARE: f64 = 0.0026;
pub(super) const MOVES_SD: f64 = 5.0;

/// Adds the no-load speed to the features of a throw; with a supply voltage, also resistance and back-EMF constant. For
/// a series-wound motor, adds the resistance only.
pub(super) fn add_constants(
    features: &mut Features,
    supply_v: Option<f64>,
    movement: &Movement<'_>,
    (motor, lead_mm): (Motor, f64),
) {
    let interval_s = movement.interval_s;
    let radians_per_mm = std::f64::consts::TAU / lead_mm;
    let drive = movement.drive();
    let (start, end) = (movement.start(), movement.near_end);
    let amperes = |i: &f64| drive * (i - movement.current.mean);
    let channels = (movement.current_a.get(start..=end), movement.position_mm.get(start..=end));
    let (Some([first, current @ ..]), Some([_, position @ ..])) = channels else { return };
    let moved_mm = |x: &f64| movement.sign * (x - movement.position.mean);
    let least_mm = (MOVES_SHARE * movement.travel_mm).max(MOVES_SD * movement.position.sd);
    let Some(moves) = position.iter().position(|x| moved_mm(x) > least_mm) else { return };
    // Sums over the samples of the products of charge, current, angle (series-wound: ∫i dθ), 1 and time.
    let (mut sums, mut charge, mut before) = ([[0.0; 5]; 4], 0.0, amperes(first));
    let (mut turned, mut angle_before) = (0.0, 0.0);
    for (k, (i, x)) in current.iter().zip(position).enumerate() {
        let (now, angle) = (amperes(i), moved_mm(x) * radians_per_mm);
        let mean = 0.5 * (before + now);
        charge += mean * interval_s;
        turned += (angle - angle_before) * if motor == Motor::Series { mean } else { 1.0 };
        (before, angle_before) = (now, angle);
        if k < moves {
            continue;
        }
        let row = [charge, now, turned, 1.0, (k + 1) as f64];
        for i in 0..4 {
            // The matrix is symmetric, but a complete row is faster: the compiler computes two products at a time.
            for j in 0..5 {
                sums[i][j] += row[i] * row[j];
            }
        }
    }
    let normal = Matrix4::from_fn(|i, j| sums[i.min(j)][i.max(j)]);
    let right = Vector4::from_fn(|i, _| interval_s * sums[i][4]);
    let solved = normal.try_inverse().map(|inverse: Matrix4<f64>| inverse * right);
    if let Some(solved) = solved.filter(|found| found[0] > 0.0 && found[2] > 0.0 && found.iter().all(|v| v.is_finite()))
    {
        features.resistance_ohm = supply_v.map(|volts| volts * solved[0]);
        if motor == Motor::Series {
            return;
        }
        features.back_emf_v_s_per_rad = supply_v.map(|volts| volts * solved[2]);
        features.no_load_speed_rad_per_s = Some(solved[2].recip());
    }
}
