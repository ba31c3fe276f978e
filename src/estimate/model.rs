//! The movement that the model, equation (12), gives for a current.

use super::{
    identifier::copy_finite,
    settings::{Motor, Settings},
    trace::{
        missing,
        movement::{Movement, start_of_motor},
    },
};
use crate::throw::Trace;

/// The toe position of the model with the coefficients b0, a1, a0 \[mm\], one value a sample of the trace. The model is
/// at rest until the motor starts, and is then driven by the recorded current for `duration_s`.
pub(crate) fn modelled_position_mm(
    trace: &Trace,
    [b0, a1, a0]: [f64; 3],
    duration_s: f64,
    settings: &Settings,
) -> Vec<f64> {
    let (step_s, mm_per_rad) = (trace.sample_rate_hz().recip(), settings.radians_per_mm().recip());
    let [current, position] = [trace.current_a(), trace.position_mm()].map(|values| {
        let mut finite = Vec::new();
        copy_finite(&mut finite, &missing::bridged(values, step_s));
        finite
    });
    let mut scratch = Vec::new();
    let start = start_of_motor(&current, step_s, &mut scratch);
    let movement = Movement::of(&current, &position, step_s, start, &mut scratch);
    let (start, start_mm) = (movement.start(), movement.position.mean);
    let driven = (0..current.len() - start).take_while(|after| *after as f64 * step_s <= duration_s);
    let end = start + driven.count();
    let neutral_rad = settings.neutral_mm / mm_per_rad;
    let (sign, driving) = (movement.sign, movement.drive());
    // A current against the driving one brakes.
    let drive = |current: f64| {
        let forward = (current - movement.current.mean) * driving;
        if settings.motor == Motor::Series { forward * forward.abs() } else { forward }
    };
    let acceleration = |current: f64| {
        move |[angle, speed]: [f64; 2]| sign * b0 * drive(current) - a1 * speed - a0 * (angle - neutral_rad)
    };
    let mut state = [start_mm / mm_per_rad, 0.0];
    let mut model = vec![start_mm; start + 1];
    for [before, after] in current[start..end].array_windows() {
        state = midpoint(state, step_s, acceleration(*before), acceleration(0.5 * (before + after)));
        model.push(state[0] * mm_per_rad);
    }
    model
}

/// Angle \[rad\] and speed \[rad/s\] after a step of `h` seconds by the midpoint rule. The two functions are the
/// acceleration in a state, at the start and in the middle of the step.
fn midpoint(
    [angle, speed]: [f64; 2],
    h: f64,
    at_start: impl Fn([f64; 2]) -> f64,
    in_middle: impl Fn([f64; 2]) -> f64,
) -> [f64; 2] {
    let middle = [angle + 0.5 * h * speed, speed + 0.5 * h * at_start([angle, speed])];
    [angle + h * middle[1], speed + h * in_middle(middle)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The trace is that of the model, from a current whose sensor has an offset. One sample was not measured.
    #[test]
    fn the_offset_of_the_current_sensor_and_a_lost_sample_do_not_move_the_model() {
        let (settings, step_s) = (Settings::default(), 1e-3);
        let (coefficients, neutral_mm) = ([2.5, 9.0, 0.3], settings.neutral_mm);
        let driving = |k: usize| match k.checked_sub(200) {
            Some(k) => (1.0 - (-(k as f64) / 8.0).exp()) * (1.2 + 8.0 * (-(k as f64) / 60.0).exp()),
            None => 0.0,
        };
        let [b0, a1, a0] = coefficients;
        let rad_per_mm = settings.radians_per_mm();
        let (mut state, mut position) = ([0.0; 2], Vec::new());
        for k in 0..3000 {
            position.push(state[0] / rad_per_mm);
            let acceleration = |current: f64| {
                move |[angle, speed]: [f64; 2]| b0 * current - a1 * speed - a0 * (angle - neutral_mm * rad_per_mm)
            };
            let middle = 0.5 * (driving(k) + driving(k + 1));
            if k >= 200 {
                state = midpoint(state, step_s, acceleration(driving(k)), acceleration(middle));
            }
        }
        let mut current: Vec<f64> = (0..3000).map(|k| driving(k) - 0.15).collect();
        current[1500] = f64::NAN;
        let trace = Trace::new(1.0 / step_s, current, position.clone()).unwrap();
        let model = modelled_position_mm(&trace, coefficients, 2.5, &settings);
        let error = model.iter().zip(&position).map(|(model, is)| (model - is).abs()).fold(0.0, f64::max);
        assert!(error < 0.02 && model.len() > 2600, "{error} mm in {} samples", model.len());
    }
}
