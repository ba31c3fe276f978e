//! Errors of an estimate that the sensors do not cause.

use nalgebra::{Matrix3, Vector3};

use crate::estimate::{
    load::{DRY_SHARE, Load, STEPS},
    sriv::{
        Solution, Workspace,
        covariance::backwards,
        filter::{Discrete, Hold},
    },
    trace::{samples::mean, window::Window},
};

/// Share of the travel after which the machine has its running speed.
const STARTED_SHARE: f64 = 0.05;

/// Errors of (b0, a1, a0) that the sensors do not cause.
pub(super) struct Errors {
    /// Covariance of the errors from a random load.
    pub(super) load: Matrix3<f64>,
    /// Error from dry friction, equal in every throw, for one standard deviation of its share.
    pub(super) dry: Vector3<f64>,
    /// Error from the current at rest, equal in every throw, for one standard deviation of the part that the machine
    /// does not draw in motion.
    pub(super) offset: Vector3<f64>,
}

impl Errors {
    /// `None` if the covariance is not finite.
    ///
    /// A disturbance of the input by the charge q in the sample k changes the estimate by M⁻¹ `w_k` q / T, with w from
    /// [`backwards`] and the sampling interval T. The model has only viscous friction. It stands for a dry friction F
    /// with the same torque at the speed ω, and the two differ by the acceleration d = -F (1 - y'/ω) at the speed y',
    /// which is that of the current d/b0. ω is the mean speed of the movement after its start. A mean over less of the
    /// movement would depend on the spring, which brakes one direction and drives the other, and the resulting interval
    /// would not contain the true friction.
    pub(super) fn of(
        load: &Load,
        window: &Window,
        solution: &Solution<2, 1, 3>,
        workspace: &Workspace<3>,
    ) -> Option<Self> {
        let (z, stride, model) = (&workspace.instruments, workspace.stride, &workspace.model_output);
        let [b0, a1, _] = solution.parameters;
        let last = model.len() - 1;
        let moving = model.iter().position(|y| *y > STARTED_SHARE * model[last]).unwrap_or_default().min(last);
        let per_sample = (model[last] - model[moving]) / (last - moving).max(1) as f64;
        let friction_a = DRY_SHARE * a1 * per_sample / window.interval_s / b0;
        let filter = Discrete::new(&solution.denominator, stride as f64 * window.interval_s)?;
        let (mut effects, [mut dry, mut offset]) = ([Vector3::zeros(); STEPS], [Vector3::zeros(); 2]);
        backwards(z, &filter, Hold::First, &[b0, 0.0], |k, w| {
            // The instrument of the block k represents `stride` instruments.
            let (from, to, w) = (k * stride, (k * stride + stride).min(last), w * stride as f64);
            effects[load.step_of(from)] += w / window.interval_s;
            let block = from..to.max(from + 1);
            if from >= window.foot {
                dry += w * (friction_a * ((model[to] - model[from]) / (block.len() as f64 * per_sample) - 1.0));
            }
            offset += w * (window.rest_a * window.input_scale().map_or(1.0, |scale| mean(&scale[block])));
        });
        let inverse = &solution.inverse;
        let load = load.covariance(|step| inverse * effects[step])?;
        Some(Self { load, dry: inverse * dry, offset: inverse * offset })
    }
}
