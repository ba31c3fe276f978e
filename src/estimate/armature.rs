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

use super::{features::Features, products::Products, settings::Motor, trace::movement::Movement};

/// Lowest sampling rate that resolves the inrush \[Hz\]: it gives 60 samples in the 0.3 s of the inrush.
pub(super) const LEAST_RATE_HZ: f64 = 200.0;
/// The toe counts as moving after this share of its travel (0.3 mm of 115 mm), and after this many standard deviations
/// of the position's noise.
const MOVES_SHARE: f64 = 0.0026;
const MOVES_SD: f64 = 5.0;

/// Sums over the samples from the first movement of the toe to the end of the travel.
pub(super) struct Armature {
    /// Products of charge, current, 1, angle θ, ∫i dθ and time \[s\].
    sums: [[f64; 6]; 6],
}

impl Armature {
    /// `None` if the toe does not move.
    pub(super) fn of(movement: &Movement<'_>, radians_per_mm: f64) -> Option<Self> {
        let interval_s = movement.interval_s;
        let drive = movement.drive();
        let (start, end) = (movement.start(), movement.near_end);
        let amperes = |k: usize| drive * (movement.current_a[k] - movement.current.mean);
        let least_mm = (MOVES_SHARE * movement.travel_mm).max(MOVES_SD * movement.position.sd);
        let moves = (start + 1..=end).find(|&k| movement.progress_mm(k) > least_mm)?;
        let (mut products, mut charge, mut turned) = (Products::ZERO, 0.0, 0.0);
        let (mut before, mut angle_before) = (amperes(start), 0.0);
        let mut sample = |k: usize| {
            let (now, angle) = (amperes(k), movement.progress_mm(k) * radians_per_mm);
            let mean = 0.5 * (before + now);
            charge += mean * interval_s;
            turned += mean * (angle - angle_before);
            (before, angle_before) = (now, angle);
            [charge, now, 1.0, angle, turned, (k - start) as f64 * interval_s]
        };
        for k in start + 1..moves {
            sample(k);
        }
        products.add(moves..end + 1, sample);
        Some(Self { sums: products.sums() })
    }

    /// R, L, c and K (series-wound: k), each divided by V. `None` if the samples do not determine them, or K is not
    /// positive.
    fn solve(&self, motor: Motor) -> Option<Vector4<f64>> {
        let terms = [0, 1, 2, if motor == Motor::Series { 4 } else { 3 }];
        let normal = Matrix4::from_fn(|i, j| self.sums[terms[i]][terms[j]]);
        let right = Vector4::from_fn(|i, _| self.sums[terms[i]][5]);
        let found: Vector4<f64> = normal.try_inverse()? * right;
        (found[3] > 0.0).then_some(found)
    }

    /// Adds the no-load speed to the features of a throw; with a supply voltage, also resistance and back-EMF constant.
    /// For a series-wound motor, adds the resistance only.
    pub(super) fn add_constants(&self, features: &mut Features, supply_v: Option<f64>, motor: Motor) {
        let Some(found) = self.solve(motor) else { return };
        if !(found[0] > 0.0 && found.iter().all(|v| v.is_finite())) {
            return;
        }
        features.resistance_ohm = supply_v.map(|volts| volts * found[0]);
        if motor == Motor::PermanentMagnet {
            features.back_emf_v_s_per_rad = supply_v.map(|volts| volts * found[3]);
            features.no_load_speed_rad_per_s = Some(found[3].recip());
        }
    }
}
