//! The latest throw, and what the drift that it shows is at this throw.

use jiff::Timestamp;

use super::{
    cause::Naming,
    course::Course,
    drift::Drift,
    event::Cause,
    explain::{Explanation, friction_of_sound_motor},
    gauges::{Gauge, Gauges},
    history::History,
    settings::Settings,
    threshold::WINDOWS,
    track::Tracks,
};
use crate::throw::Direction;

/// Standard deviation of a size by the error of the model, as share of the size: where half of the friction is dry, losses
/// of the motor's torque by 10 to 20 % look larger by 1 to 2 % of themselves.
const SIZE_SHARE: f64 = 0.01;
/// Dry part of the friction, and its standard deviation: unknown, so evenly between none and all.
const DRY_PART: (f64, f64) = (0.5, 0.29);
/// Least part of nominal that a loss leaves, as its logarithm is needed.
const LEAST_LEFT: f64 = 0.01;

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
            return (*part, None);
        };
        let (size, size_sd) = course.now();
        let whole = (1.0 + size).max(LEAST_LEFT);
        let slower = if part.cause == Cause::Friction { self.slower() } else { 0.0 };
        let of_model = part.model_sd.hypot(SIZE_SHARE * whole.ln()).hypot(DRY_PART.1 * slower);
        let size_sd = of_model.hypot(size_sd / whole);
        (Explanation { size: whole.ln() - DRY_PART.0 * slower, size_sd, ..*part }, Some(course))
    }

    /// How much slower the machine moves than normal, as a logarithm. A dry force over the speed is the friction of a viscous
    /// model, which therefore shows the dry part of the friction larger by this.
    fn slower(self) -> f64 {
        self.gauges.level(Gauge::Duration, WINDOWS[0]).map_or(0.0, |level| level.value)
    }
}
