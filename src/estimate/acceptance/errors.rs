//! Errors of an estimate that the sensors do not cause.

use nalgebra::{Matrix3, Vector3};

use crate::estimate::{
    load::{DRY_SHARE, Load, STEPS},
    sriv::{
        Solution, Workspace,
        covariance::backwards,
        filter::{Discrete, Hold, dot},
    },
    trace::window::Window,
};

/// Share of the travel after which the machine has its running speed.
const STARTED_SHARE: f64 = 0.05;

/// Covariance of the errors of (b0, a1, a0) from a random load. A charge of 1 A s in one sample of the input changes
/// them by M⁻¹ w / T, with w from [`backwards`] and the sampling interval T. `None` if it is not finite.
pub(super) fn of_load(
    load: &Load,
    window: &Window,
    solution: &Solution<2, 1, 3>,
    workspace: &Workspace<3>,
) -> Option<Matrix3<f64>> {
    let (z, stride) = (&workspace.instruments, workspace.stride);
    let filter = Discrete::new(&solution.denominator, stride as f64 * window.interval_s)?;
    let mut effects = [Vector3::zeros(); STEPS];
    backwards(z, &filter, Hold::First, &[solution.parameters[0], 0.0], |k, w| {
        effects[load.step_of(k * stride)] += w * (stride as f64 / window.interval_s);
    });
    load.covariance(|step| solution.inverse * effects[step])
}

/// Errors of (b0, a1, a0) that are equal in every throw: those from dry friction, for one standard deviation of its
/// share, and those from the current at rest, for one standard deviation of the part that the machine does not draw in
/// motion.
///
/// A disturbance d of the acceleration changes the output by n = d/A (d/C with a prefilter 1/C) and the estimate by
/// M⁻¹ Σ z n. The model has only viscous friction. It stands for a dry friction F with the same torque at the speed
/// ω, and the two differ by d = -F (1 - y'/ω) at the speed y'. ω is the mean speed of the movement after its start.
/// A mean over less of the movement would depend on the spring, which brakes one direction and drives the other,
/// and the resulting interval would not contain the true friction.
pub(super) fn systematic(window: &Window, solution: &Solution<2, 1, 3>, workspace: &Workspace<3>) -> [[f64; 3]; 2] {
    let (z, stride, model) = (&workspace.instruments, workspace.stride, &workspace.model_output);
    let [b0, a1, _] = solution.parameters;
    let last = model.len() - 1;
    let moving = model.iter().position(|y| *y > STARTED_SHARE * model[last]).unwrap_or_default().min(last);
    let per_sample = (model[last] - model[moving]) / (last - moving).max(1) as f64;
    let load = DRY_SHARE * a1 * per_sample / window.interval_s;
    let dry = |k: usize| if k >= window.foot { load * ((model[k + 1] - model[k]) / per_sample - 1.0) } else { 0.0 };
    let Some(filter) = Discrete::<2>::new(&solution.denominator, window.interval_s) else { return [[0.0; 3]; 2] };
    let row = filter.readout(Hold::Zero).state[0];
    let (mut states, mut sums) = ([[0.0; 2]; 2], [Vector3::zeros(); 2]);
    let mut kept = z.iter();
    let mut until_kept = stride / 2;
    for k in 0..last {
        if until_kept == 0 {
            until_kept = stride;
            if let Some(z) = kept.next() {
                for (sum, state) in sums.iter_mut().zip(&states) {
                    *sum += Vector3::from(*z) * (stride as f64 * dot(&row, state));
                }
            }
        }
        until_kept -= 1;
        filter.advance(&mut states[0], dry(k));
        filter.advance(&mut states[1], b0 * window.rest_a * window.input_scale().map_or(1.0, |scale| scale[k]));
    }
    sums.map(|sum| (solution.inverse * sum).into())
}
