//! The midpoint rule for an equation of motion.

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
