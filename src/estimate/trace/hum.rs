//! Mains hum on the current: detected at rest, removed from the whole trace.
//!
//! A sine of the nominal frequency and a straight line are fitted to the quiet samples before the start of the motor,
//! and to each stretch of five periods after the inrush. The frequency of the mains may differ by 0.1 Hz from the
//! nominal one, so the phase drifts from fit to fit. Between the centres of two fits the hum is the linear
//! interpolation of their sines, which follows such a drift to first order. The interpolation also covers the inrush,
//! where no fit is possible.

use nalgebra::{Matrix4, Vector4};

use super::{
    movement::INRUSH_S,
    samples::{Level, samples_in},
};

/// Mains frequencies \[Hz\]: of most of the world, of the Americas, and of railways.
const MAINS_HZ: [f64; 3] = [50.0, 60.0, 50.0 / 3.0];
/// Least number of periods in the quiet samples.
const LEAST_PERIODS: f64 = 3.0;
/// Number of periods in each later fit.
const STRETCH_PERIODS: f64 = 5.0;
/// Least number of samples in a period; with fewer, aliasing changes the frequency.
const LEAST_RATE: f64 = 4.0;
/// Least share of hum in the variance of the quiet samples.
const LEAST_SHARE: f64 = 0.6;

/// Least-squares fit of a sine of one frequency and a straight line.
struct Sine {
    /// Angle between two samples \[rad\].
    turn: f64,
    /// Index of the middle of the fitted samples.
    centre: f64,
    /// Coefficients of sine, cosine, constant and slope.
    found: Vector4<f64>,
}

impl Sine {
    fn fit(values: &[f64], from: usize, turn: f64) -> Option<Self> {
        let centre = from as f64 + 0.5 * values.len() as f64;
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        for (at, value) in values.iter().enumerate() {
            let row = Self::row(turn, (from + at) as f64, centre);
            normal += row * row.transpose();
            right += row * *value;
        }
        Some(Self { turn, centre, found: normal.try_inverse()? * right })
    }

    fn row(turn: f64, at: f64, centre: f64) -> Vector4<f64> {
        let (sin, cos) = (turn * at).sin_cos();
        Vector4::new(sin, cos, 1.0, 0.01 * (at - centre))
    }

    fn hum(&self, at: usize) -> f64 {
        let row = Self::row(self.turn, at as f64, self.centre);
        row[0] * self.found[0] + row[1] * self.found[1]
    }
}

/// Removes the hum, if there is any, from `current`, whose first `quiet` samples are before the start of the motor.
pub(crate) fn remove(current: &mut [f64], quiet: usize, interval_s: f64) {
    let variance = Level::of(&current[..quiet]).sd.powi(2);
    for hz in MAINS_HZ {
        let per_period = 1.0 / (hz * interval_s);
        if per_period < LEAST_RATE || (quiet as f64) < LEAST_PERIODS * per_period {
            continue;
        }
        let Some(rest) = Sine::fit(&current[..quiet], 0, std::f64::consts::TAU / per_period) else { continue };
        let power = 0.5 * (rest.found[0].powi(2) + rest.found[1].powi(2));
        if power < LEAST_SHARE * variance {
            continue;
        }
        let stretch = samples_in((STRETCH_PERIODS * per_period).round(), 1.0);
        let turn = rest.turn;
        let mut sines = vec![rest];
        let mut from = quiet + samples_in(INRUSH_S, interval_s);
        while from + stretch <= current.len() {
            let to = if current.len() < from + 2 * stretch { current.len() } else { from + stretch };
            sines.extend(Sine::fit(&current[from..to], from, turn));
            from = to;
        }
        let mut before = 0;
        for (at, value) in current.iter_mut().enumerate() {
            while before + 2 < sines.len() && sines[before + 1].centre <= at as f64 {
                before += 1;
            }
            *value -= match &sines[before..] {
                [left, right, ..] => {
                    let share = (at as f64 - left.centre) / (right.centre - left.centre);
                    (1.0 - share) * left.hum(at) + share * right.hum(at)
                }
                [only] => only.hum(at),
                [] => 0.0,
            };
        }
        return;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hum_of_any_phase_goes_and_the_current_stays() {
        let truth = |k: usize| if k < 200 { 0.1 } else { 1.0 + 12.0 * (-(k as f64 - 200.0) / 20.0).exp() };
        for phase in [0.0, 1.0, 2.5] {
            let hum = |k: usize| 0.3 * (0.1002 * std::f64::consts::PI * k as f64 + phase).sin();
            let mut current: Vec<f64> = (0..3000).map(|k| truth(k) + hum(k)).collect();
            remove(&mut current, 200, 1e-3);
            let worst = (0..3000).map(|k| (current[k] - truth(k)).abs()).fold(0.0, f64::max);
            assert!(worst < 0.02, "{worst}");
        }
        let quiet: Vec<f64> = (0..1000).map(|k| f64::from(u8::from(k % 3 == 0))).collect();
        let mut current = quiet.clone();
        remove(&mut current, 200, 1e-3);
        assert_eq!(current, quiet);
    }
}
