//! The latest throw, and the size of the drift at this throw.

use std::rc::Rc;

use jiff::Timestamp;
use nalgebra::Vector3;

use super::{Attribution, Course, Drift, Explanation, History, Naming, Window, friction_of_sound_motor};
use crate::{
    diagnose::{
        Cause, Settings,
        gauges::{Gauges, dry_rise},
        statistics::Level,
        track::{Courses, Tracks},
    },
    throw::Direction,
};

/// Standard deviation of a size by the error of the model, as part of the size: where half of the friction is dry, the
/// model overstates a loss of 10 to 20 % of the motor's torque by 1 to 2 % of the loss.
const SIZE_SHARE: f64 = 0.01;
/// Least size of a coefficient, as part of its normal value, so that its logarithm is finite.
const LEAST_LEFT: f64 = 0.01;
/// Dry friction as part of the running load: mean and standard deviation. The load contains the spring too.
const DRY_LOAD: (f64, f64) = (0.3, 0.17);

/// The latest throw of a machine.
#[derive(Clone, Copy)]
pub(crate) struct LatestThrow<'a> {
    /// The drift in the last throws.
    pub(crate) drift: &'a Drift,
    /// Number of the throw, counted by the machine's monitor.
    pub(crate) order: u64,
    pub(crate) at: Timestamp,
    pub(crate) tracks: &'a Tracks,
    pub(crate) courses: &'a Courses<'a>,
    pub(crate) gauges: &'a Gauges,
    pub(crate) settings: &'a Settings,
}

impl LatestThrow<'_> {
    /// The direction of the drift of `cause`; `None` if both directions have it, or while the direction is not known.
    pub(crate) fn direction(self, cause: Cause) -> Option<Direction> {
        let weights = self.drift.weights(cause, self.settings)?;
        if self.grows_along_stroke(cause) || self.drift.is_opposite() {
            return None;
        }
        self.courses.one_sided(&weights)
    }

    /// Whether a change of `cause` is friction that grows along the stroke, as it stiffens both directions. Then a1
    /// rises more in the direction in which the spring helps, and hardly in the other, although both have the friction.
    fn grows_along_stroke(self, cause: Cause) -> bool {
        /// Least rise of ln(a0/b0) in each direction, and least number of its standard deviations: a smaller rise may
        /// be scatter.
        const STIFFER: f64 = 0.1;
        const SHOWN_SD: f64 = 3.0;
        let of_spring = Vector3::new(-1.0, 0.0, 1.0);
        let is_stiffer = |window: &Window| {
            let sd = (of_spring.transpose() * window.covariance * of_spring).x.max(0.0).sqrt();
            of_spring.dot(&window.mean) > STIFFER.max(SHOWN_SD * sd)
        };
        cause == Cause::Friction && self.drift.levels.iter().all(|level| level.as_ref().is_some_and(is_stiffer))
    }

    /// The drift's single named part with its size at this throw, and its course; `None` unless exactly one is named.
    pub(super) fn named_part(
        self,
        direction: Option<Direction>,
        history: &History,
    ) -> Option<(Explanation, Option<Rc<Course>>)> {
        let attribution = self.drift.attribution.as_ref()?;
        let (Naming::One(main) | Naming::Another { new: main, .. }) = attribution.naming else { return None };
        let is_beside_sound_motor = attribution.has_sound_motor() && main.cause == Cause::Friction;
        let of_friction = self.drift.strongest.as_ref().filter(|_| is_beside_sound_motor);
        let part = of_friction.map_or(main, |strongest| friction_of_sound_motor(&strongest.window));
        Some(self.size(&part, direction, history))
    }

    /// `part` with its size at this throw, and its course if there is one.
    pub(crate) fn size(
        self,
        part: &Explanation,
        direction: Option<Direction>,
        history: &History,
    ) -> (Explanation, Option<Rc<Course>>) {
        let differ = self.grows_along_stroke(part.cause);
        let Some(course) = self.courses.course(&part.weights, (direction, differ), history) else {
            return (self.without_dry_friction(*part, direction), None);
        };
        let (size, size_sd) = course.now();
        let whole = (1.0 + size).max(LEAST_LEFT);
        let size_sd = part.model_sd.hypot(size_sd / whole).hypot(SIZE_SHARE * whole.ln());
        let now = Explanation { size: whole.ln(), size_sd, ..*part };
        (self.without_dry_friction(now, direction), Some(course))
    }

    /// `part` with its size corrected for dry friction, which the model treats as viscous.
    ///
    /// Dry friction F at the speed v adds F/v to a1. More friction slows the motor, so the dry part of a1 rises by more
    /// than the friction, namely also by the change in duration.
    ///
    /// At the start of the throw, b0 comes from the torque less the dry friction. If the torque changes by the factor
    /// r, b0 changes by (r - q)/(1 - q), where q is the dry friction as part of the torque at the inrush current. The
    /// ratio b0/a0 of the movement changes by the same factor, as the spring slows the motor along the stroke: a
    /// constant friction is fitted by viscous friction, which falls with the speed, and by stiffness for the rest. A
    /// motor that loses torque alone becomes slower, one with weaker magnets faster, and the dry part of a1 changes as
    /// above.
    fn without_dry_friction(self, part: Explanation, direction: Option<Direction>) -> Explanation {
        match part.cause {
            Cause::Friction => self.at_usual_speed(part, 1.0, direction),
            Cause::Kt => self.motor_without_dry_friction(part, direction),
            _ => part,
        }
    }

    /// [`Self::without_dry_friction`] of a change of the motor.
    fn motor_without_dry_friction(self, part: Explanation, direction: Option<Direction>) -> Explanation {
        let load = self.gauges.running_of_inrush();
        let change = part.size.exp_m1();
        let whole = (1.0 + (1.0 - DRY_LOAD.0 * load) * change).max(LEAST_LEFT);
        // The factor changes b0 and a1 alike, and so only the ratios to a0.
        let of_torque = (part.weights.x + part.weights.y).clamp(0.0, 1.0);
        let size = part.size + of_torque * (whole.ln() - part.size);
        let size_sd = part.size_sd.hypot(of_torque * DRY_LOAD.1 * load * change / whole);
        let part = Explanation { size, size_sd, ..part };
        // Beside a second part, the fit has assigned the change of the dry part of a1 to both.
        let is_alone = |of: Attribution| matches!(of.naming, Naming::One(_)) || of.sound_magnets().is_some();
        if self.drift.attribution.is_some_and(is_alone) {
            self.at_usual_speed(part, part.weights.y, direction)
        } else {
            part
        }
    }

    /// `part` with its size corrected for the change of the dry part of a1 with the speed; `of_a1` is the weight of ln
    /// a1 in the size.
    fn at_usual_speed(self, part: Explanation, of_a1: f64, direction: Option<Direction>) -> Explanation {
        let Some(Level { value, sd }) = self.gauges.longer(direction).map(dry_rise) else { return part };
        Explanation { size: part.size - of_a1 * value, size_sd: part.size_sd.hypot(of_a1 * sd), ..part }
    }
}
