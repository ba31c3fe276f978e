//! The movement that the model, equation (12), gives for a current.

use super::settings::{Motor, Settings};
use crate::throw::Trace;

/// Least current of a running motor, as share of the peak current: far above the noise, far below the inrush.
const RUNNING_SHARE: f64 = 0.05;

/// The toe position of the model with the coefficients b0, a1, a0 \[mm\], one value a sample of the trace. The model is
/// at rest until the motor starts, and is then driven by the recorded current for `duration_s`.
pub(crate) fn modelled_position_mm(
    trace: &Trace,
    [b0, a1, a0]: [f64; 3],
    duration_s: f64,
    settings: &Settings,
) -> Vec<f64> {
    let (current, position) = (trace.current_a(), trace.position_mm());
    let peak = current.iter().copied().fold(0.0_f64, |peak, it| if it.abs() > peak.abs() { it } else { peak });
    // The current rises from the sample before the first one that shows it.
    let start = current.iter().position(|it| it.abs() > RUNNING_SHARE * peak.abs()).unwrap_or(0).saturating_sub(1);
    let (step_s, mm_per_rad) = (trace.sample_rate_hz().recip(), settings.radians_per_mm().recip());
    let driven = (0..current.len() - start).take_while(|after| *after as f64 * step_s <= duration_s);
    let end = start + driven.count();
    let neutral_rad = settings.neutral_mm / mm_per_rad;
    let sign = if position[end.saturating_sub(1)] < position[0] { -1.0 } else { 1.0 };
    // The inrush has the sign of the driving current; a current of the other sign brakes.
    let drive = |current: f64| {
        let forward = current * peak.signum();
        if settings.motor == Motor::Series { forward * forward.abs() } else { forward }
    };
    let acceleration = |current: f64| {
        move |[angle, speed]: [f64; 2]| sign * b0 * drive(current) - a1 * speed - a0 * (angle - neutral_rad)
    };
    let mut state = [position[start] / mm_per_rad, 0.0];
    let mut model = vec![position[start]; start + 1];
    for [before, after] in current[start..end].array_windows() {
        state = midpoint(state, step_s, acceleration(*before), acceleration(0.5 * (before + after)));
        model.push(state[0] * mm_per_rad);
    }
    model
}

/// Angle \[rad\] and speed \[rad/s\] after a step of `h` seconds by the midpoint rule. The two functions are the
/// acceleration in a state, at the start and in the middle of the step.
pub(crate) fn midpoint(
    [angle, speed]: [f64; 2],
    h: f64,
    at_start: impl Fn([f64; 2]) -> f64,
    in_middle: impl Fn([f64; 2]) -> f64,
) -> [f64; 2] {
    let middle = [angle + 0.5 * h * speed, speed + 0.5 * h * at_start([angle, speed])];
    [angle + h * middle[1], speed + h * in_middle(middle)]
}
