//! The kind of motor that current and speed of a throw show.
//!
//! The back-EMF of a motor with permanent magnets is K ω. The back-EMF of a series-wound motor is k i ω, or less where
//! its iron saturates. Two parts of a throw show the difference, and both must agree.
//!
//! The first part begins with the first movement of the toe and ends with the travel. The integrated equation of the
//! armature (see `armature`), divided by the voltage, has one of two forms:
//!
//! ```text
//! t = r ∫i dt + l i + κ θ + c        permanent magnets
//! t = r ∫i dt + l i + κ ∫i dθ + c    series-wound
//! ```
//!
//! The form of the motor leaves the smaller residual. The end of the inrush decides most.
//!
//! The second part begins after the inrush. A load that rises along the stroke raises the current and slows the motor.
//! With magnets, ω = ω0 (1 - i/I), where I = V/R is the current at standstill. The inrush cannot exceed I, so a line
//! through speed and current of the running motor reaches ω = 0 at the inrush current or above. The speed of a series
//! motor is about V/(k i); its line reaches ω = 0 at about twice the running current, far below the inrush.
//!
//! Two effects resemble a series motor: in the second part, a voltage that falls during the throw; in the first part,
//! play or a soft drive.

use super::{
    armature::Armature,
    settings::Motor,
    trace::{
        movement::Movement,
        samples::{mean, samples_in},
    },
};

/// Largest residual of the better equation, as part of the duration. A motor that drives the toe by a crank leaves
/// more.
const LARGEST_RESIDUAL: f64 = 1.5e-3;
/// Largest ratio of the residuals, series-wound to magnets, of a series-wound motor. The medians of simulated series
/// motors, with three laws of saturation, were 0.1 to 6.
const LARGEST_OF_SERIES: f64 = 3.0;
/// Least ratio of the residuals, series-wound to magnets, of a motor with magnets. The medians of simulated motors with
/// magnets were 2.2 to 150.
const LEAST_OF_MAGNETS: f64 = 6.0;
/// Inrush as part of the current at which the line of the running motor reaches ω = 0: more shows a series-wound motor.
/// Simulated series motors had 1.0 to 4.
const INRUSH_OF_SERIES: f64 = 1.2;
/// Inrush as part of this current: less shows magnets; more shows a series-wound motor whose residual is also the
/// smaller one. Simulated motors with magnets had 0.7 to 1.8.
const INRUSH_OF_MAGNETS: f64 = 1.0;
/// Largest correlation of speed and current of the running motor.
const CORRELATION: f64 = -0.8;
/// Part of the movement that is skipped as the inrush.
const SKIPPED_SHARE: f64 = 0.3;
/// Number of blocks of the rest, whose mean speeds and currents make the line.
const BLOCKS: usize = 12;
/// Time over which the inrush is a mean: a period of the ripple of rectified mains \[s\].
const RIPPLE_S: f64 = 0.01;

/// The kind of motor; `None` if the throw does not decide it.
pub(super) fn shown(movement: &Movement<'_>, armature: &Armature) -> Option<Motor> {
    let (start, end) = (movement.start(), movement.near_end);
    if end < start + 2 * BLOCKS {
        return None;
    }
    let way = Way { movement, drive: movement.drive(), start, len: end - start };
    let (_, magnets) = armature.solve(Motor::PermanentMagnet)?;
    let (_, series) = armature.solve(Motor::Series)?;
    let inrush = way.inrush_of_standstill()?;
    let is_series = series < LARGEST_OF_SERIES * magnets && inrush > INRUSH_OF_SERIES
        || series < magnets && inrush > INRUSH_OF_MAGNETS;
    if magnets.min(series) > LARGEST_RESIDUAL * way.len as f64 * movement.interval_s {
        None
    } else if is_series {
        Some(Motor::Series)
    } else if series > LEAST_OF_MAGNETS * magnets && inrush < INRUSH_OF_MAGNETS {
        Some(Motor::PermanentMagnet)
    } else {
        None
    }
}

/// The movement from the start of the motor to the end of the travel.
struct Way<'a> {
    movement: &'a Movement<'a>,
    /// Sign of the driving current.
    drive: f64,
    start: usize,
    /// Number of samples after the start.
    len: usize,
}

impl Way<'_> {
    /// The inrush over the current at which the running motor would stand still, by the line through its speed and
    /// current; `None` if they have no such line.
    fn inrush_of_standstill(&self) -> Option<f64> {
        let Movement { current_a, position_mm, sign, .. } = *self.movement;
        let of = |signal: &[f64], from: usize, to: usize| mean(&signal[self.start + from..self.start + to]);
        // Current, positive if it drives, and position with an offset, as means over some samples after the start.
        let level = |from: usize, to: usize| self.drive * (of(current_a, from, to) - self.movement.current.mean);
        let place = |from: usize, to: usize| sign * of(position_mm, from, to);
        let from = samples_in(SKIPPED_SHARE * self.len as f64, 1.0);
        let ripple = samples_in(RIPPLE_S, self.movement.interval_s).clamp(1, self.len);
        let currents = &current_a[self.start..=self.start + from.max(ripple)];
        let mut sum = level(0, ripple) * ripple as f64;
        let mut largest = sum.max(0.0);
        for (before, now) in currents.iter().zip(&currents[ripple..]) {
            sum += self.drive * (now - before);
            largest = if sum > largest { sum } else { largest };
        }
        let inrush = largest / ripple as f64;
        let length = (self.len - from) / BLOCKS;
        let quarter = (length / 4).max(1);
        if length <= quarter {
            return None;
        }
        let blocks: [[f64; 2]; BLOCKS] = std::array::from_fn(|block| {
            let (at, to) = (from + block * length, from + (block + 1) * length);
            let moved = place(to - quarter, to) - place(at, at + quarter);
            [level(at, to), moved / (length - quarter) as f64]
        });
        let mean = |of: &dyn Fn(&[f64; 2]) -> f64| blocks.iter().map(of).sum::<f64>() / BLOCKS as f64;
        let means = [0, 1].map(|of| mean(&|block| block[of]));
        let product = |a: usize, b: usize| mean(&|of| (of[a] - means[a]) * (of[b] - means[b]));
        let (variance, both) = (product(0, 0), product(0, 1));
        let slope = both / variance;
        let is_line = both < CORRELATION * (variance * product(1, 1)).sqrt();
        is_line.then(|| -slope * inrush / (means[1] - slope * means[0]))
    }
}
