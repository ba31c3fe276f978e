//! Uncertainty of the common scale of b0, a1 and a0 because of a brake that may drag at the start of a movement.
//!
//! A brake that releases after the start of the motor takes a part of the current u. Let B be the brake's torque over
//! KT. Without friction and stiffness the acceleration is b0 (u - min(B, u)) until the release, and b0 u after it.
//! Later the machine runs at nearly constant speed, where lost charge and larger inertia have the same effect. Only the
//! curvature of the first 50 ms distinguishes them, to some 20 % with 20 um of noise. So brakes with torques up to the
//! motor's largest and releases up to 40 ms are fitted, and the uncertainty of the scale includes every brake that fits
//! the start.

use super::start::free_movement;
use crate::estimate::{
    rejection::Rejection,
    trace::{samples::samples_in, window::Window},
};

/// Length of the part of the movement that is fitted \[s\].
const START_S: f64 = 0.06;
/// Latest release of a brake after the start of the motor \[s\].
const LATEST_S: f64 = 0.04;
/// Torques of the fitted brakes, as share of the motor's largest torque.
const TORQUES: [f64; 8] = [0.06, 0.1, 0.17, 0.25, 0.35, 0.5, 0.7, 1.0];
/// Least number of samples of a usable start.
const LEAST_SAMPLES: usize = 12;
/// Half width of a 95 % interval \[standard deviations\].
const WIDE: f64 = 1.96;
/// Largest relative standard deviation of the scale: a brake takes at most half of the charge of the start.
pub(crate) const LARGEST_SD: f64 = 0.5;
/// A brake is certain if twice the logarithm of its likelihood ratio, against no brake, is above this.
const CERTAIN: f64 = 16.0;
/// Root mean square of the effect of rails and toe drive on the start, as a share of the travel.
const MODEL_SHARE: f64 = 1e-4;
/// If the residual has a variance above this multiple of that of the noise, the model is wrong. The variance above it
/// counts as noise, multiplied by `CORRELATED`, as neighbouring samples of such an error are not independent.
const NOISE_FACTOR: f64 = 1.2;
const CORRELATED: f64 = 15.0;

/// Buffers, reused from throw to throw.
#[derive(Debug, Default)]
pub(crate) struct Buffers {
    /// The movement without a brake for b0 = 1, see [`free_movement`].
    pub(crate) free: Vec<f64>,
    /// For each sample k the sums of 1, k, k², f, k f, f², y, k y and f y over the samples after it, with f from `free`
    /// and the output y.
    after: Vec<[f64; 9]>,
    /// For each tried brake: b0, its variance for unit variance of the output, and the residual sum of squares.
    found: Vec<(f64, f64, f64)>,
}

/// Relative standard deviation of the common scale of b0, a1 and a0 because of possible brakes.
///
/// # Errors
/// When a brake is certain, as then the scale is wrong.
pub(crate) fn scale_sd(window: &Window, [b0, a1, a0]: [f64; 3], buffers: &mut Buffers) -> Result<f64, Rejection> {
    let Window { input, output, foot, interval_s, output_noise: noise, .. } = window;
    let (foot, interval_s, noise) = (*foot, *interval_s, *noise);
    let last = samples_in(START_S, interval_s).min(output.len() - foot - 1);
    if last < LEAST_SAMPLES {
        return Ok(LARGEST_SD);
    }
    let travel = output[output.len() - 1];
    let (input, output) = (&input[foot..=foot + last], &output[foot..=foot + last]);
    let peak = input.iter().copied().fold(0.0, f64::max);
    let Buffers { free, after, found } = buffers;
    free_movement(free, window, last + 1, [a1 / b0, a0 / b0]);
    after.clear();
    after.resize(last + 1, [0.0; 9]);
    for k in (0..last).rev() {
        let (at, f, y) = ((k + 1) as f64, free[k + 1], output[k + 1]);
        let terms = [1.0, at, at * at, f, at * f, f * f, y, at * y, f * y];
        after[k] = std::array::from_fn(|i| after[k + 1][i] + terms[i]);
    }
    let square: f64 = output.iter().map(|y| y * y).sum();
    let fit = |cross: f64, own: f64| (cross / own, 1.0 / own, square - cross * cross / own);
    let without = fit(after[0][8], after[0][5]);
    if without.0.is_nan() {
        return Ok(LARGEST_SD);
    }
    found.clear();
    found.push(without);
    for torque in TORQUES.map(|share| share * peak) {
        let (mut lost_charge, mut lost, mut cross, mut own) = (0.0, 0.0, 0.0, 0.0);
        for k in 1..=samples_in(LATEST_S, interval_s).min(last) {
            let taken = torque.min(0.5 * (input[k - 1] + input[k]).max(0.0)) * interval_s;
            lost += (lost_charge + 0.5 * taken) * interval_s;
            lost_charge += taken;
            let moved = free[k] - lost;
            cross += moved * output[k];
            own += moved * moved;
            // After the release the lost movement grows by `rate` a sample: the movement is f - a - rate k.
            let rate = lost_charge * interval_s;
            let a = lost - rate * k as f64;
            let [n, s, ss, f, sf, ff, y, sy, fy] = after[k];
            let square = ff - 2.0 * (a * f + rate * sf) + a * a * n + 2.0 * a * rate * s + rate * rate * ss;
            let brake = fit(cross + fy - a * y - rate * sy, own + square);
            // A brake that holds for the whole start leaves no movement to fit.
            if brake.0 > 0.0 {
                found.push(brake);
            }
        }
    }
    let least = found.iter().fold(f64::INFINITY, |least, (.., left)| left.min(least));
    let beyond = (least / (last - 3) as f64 - NOISE_FACTOR * noise).max(0.0);
    let variance = noise + (MODEL_SHARE * travel).powi(2) + CORRELATED * beyond;
    if without.2 - least > CERTAIN * variance {
        return Err(Rejection::BrakedStart);
    }
    // The largest deviation from b0 of a scale within the 95 % interval around the best fit.
    let farthest = found.iter().map(|(scale, own, left)| {
        let reach = WIDE * WIDE - (left - least) / variance;
        if reach > 0.0 { (scale / b0 - 1.0).abs() + (own * variance * reach).sqrt() / b0 } else { 0.0 }
    });
    Ok((farthest.fold(0.0, f64::max) / WIDE).min(LARGEST_SD))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_start_without_movement_leaves_every_brake_possible() {
        let [input, output, shift] = [(); 3].map(|()| vec![0.0; 100]);
        let window = Window { input, output, shift, interval_s: 1e-3, ..Window::default() };
        assert_eq!(scale_sd(&window, [200.0, 6.0, 1.5], &mut Buffers::default()), Ok(LARGEST_SD));
    }
}
