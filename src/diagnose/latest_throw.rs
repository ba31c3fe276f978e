//! The latest throw, and the size of the drift at this throw.

use jiff::Timestamp;

use super::{
    cause::Naming,
    course::Course,
    drift::Drift,
    event::Cause,
    explain::{Explanation, friction_of_sound_motor},
    gauges::{Gauges, Level},
    history::History,
    settings::Settings,
    track::Tracks,
};
use crate::throw::Direction;

/// Standard deviation of a size by the error of the model, as share of the size: where half of the friction is dry, losses
/// of the motor's torque by 10 to 20 % look larger by 1 to 2 % of themselves.
const SIZE_SHARE: f64 = 0.01;
/// Least part of nominal that a loss leaves, as its logarithm is needed.
const LEAST_LEFT: f64 = 0.01;
/// Dry part of the friction of a machine, and its standard deviation: unknown, from 0 to 1. A constant torque cannot be
/// distinguished from viscous friction in a throw, whose speed hardly changes.
const DRY: (f64, f64) = (0.5, 0.29);
/// Dry friction as part of the running load, and its standard deviation: the load contains the spring too.
const DRY_LOAD: (f64, f64) = (0.3, 0.17);

/// The latest throw of a machine.
#[derive(Clone, Copy)]
pub(super) struct LatestThrow<'a> {
    /// The drift in the last throws.
    pub(super) drift: &'a Drift,
    /// Number of the throw among those of the machine.
    pub(super) order: u64,
    pub(super) at: Timestamp,
    pub(super) tracks: &'a Tracks,
    pub(super) gauges: &'a Gauges,
    pub(super) settings: &'a Settings,
}

impl LatestThrow<'_> {
    /// The direction that a drift of `cause` concerns; `None` for both, and while it is not known.
    pub(super) fn direction(self, cause: Cause) -> Option<Direction> {
        let weights = self.drift.weights(cause, self.settings)?;
        self.tracks.one_sided(&weights, &self.drift.temperature_sd(), self.order)
    }

    /// The single named part with its size at this throw, and its course.
    pub(super) fn named_part(
        self,
        direction: Option<Direction>,
        history: &History,
    ) -> Option<(Explanation, Option<Course>)> {
        let attribution = self.drift.attribution.as_ref()?;
        let (Naming::One(main) | Naming::Another { new: main, .. }) = attribution.naming else { return None };
        let is_beside_sound_motor = attribution.has_sound_motor() && main.cause == Cause::Friction;
        let of_friction = self.drift.strongest.as_ref().filter(|_| is_beside_sound_motor);
        let part = of_friction.map_or(main, |window| friction_of_sound_motor(&window.mean, &window.covariance));
        Some(self.size(&part, direction, history))
    }

    /// The explanation with its size at this throw, and its course.
    pub(super) fn size(
        self,
        part: &Explanation,
        direction: Option<Direction>,
        history: &History,
    ) -> (Explanation, Option<Course>) {
        let temperature_sd = self.drift.temperature_sd();
        let Some(course) = self.tracks.course(&part.weights, &temperature_sd, direction, history, self.order) else {
            return (self.without_dry_friction(*part, direction), None);
        };
        let (size, size_sd) = course.now();
        let whole = (1.0 + size).max(LEAST_LEFT);
        let size_sd = part.model_sd.hypot(size_sd / whole).hypot(SIZE_SHARE * whole.ln());
        let now = Explanation { size: whole.ln(), size_sd, ..*part };
        (self.without_dry_friction(now, direction), Some(course))
    }

    /// The size without the error of a model whose friction is viscous.
    ///
    /// Dry friction F at the speed v is F/v in a1. A rise slows the motor, so a1 rises by more than the friction: by the
    /// duration of the throw, in the dry part of the friction.
    ///
    /// At the start, b0 is that of the torque less the dry friction: of a torque that changes by the factor r, (r - q)/(1 - q)
    /// is left, where q is the dry friction as part of the torque of the inrush. The ratios do not depend on the start.
    fn without_dry_friction(self, part: Explanation, direction: Option<Direction>) -> Explanation {
        match part.cause {
            Cause::Friction => {
                let Some(Level { value, sd }) = self.gauges.longer(direction) else { return part };
                let size_sd = part.size_sd.hypot(DRY.1 * value).hypot(DRY.0 * sd);
                Explanation { size: part.size - DRY.0 * value, size_sd, ..part }
            }
            Cause::Kt if self.drift.strongest.is_some_and(|window| window.shows(Cause::Inertia)) => {
                let load = self.gauges.running_of_inrush();
                let change = part.size.exp_m1();
                let whole = (1.0 + (1.0 - DRY_LOAD.0 * load) * change).max(LEAST_LEFT);
                let size_sd = part.size_sd.hypot(DRY_LOAD.1 * load * change / whole);
                Explanation { size: whole.ln(), size_sd, ..part }
            }
            _ => part,
        }
    }
}
