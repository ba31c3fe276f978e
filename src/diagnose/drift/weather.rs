//! Which claim an alarm may make about a drift that weather may have caused. Weather changes friction most: rain lowers
//! it for days, a season changes it over months.

use nalgebra::Vector3;

use super::{Claim, DriftAlarms, FrictionChange, LatestThrow, Naming};
use crate::diagnose::{
    Cause,
    gauges::{RAIN_PCT, SLOW_FROM, may_rain_last},
    statistics::{LONGEST_WINDOW, WINDOWS, percent},
};

/// Throws of the machine after which the last few throws of each direction all show a fall.
const SHOWN_AFTER: u64 = 2 * WINDOWS[0] as u64;
/// Number of standard deviations by which a fall of friction must be larger than rain explains, and the largest
/// logarithm that they may be. The strongest window is often the one in which the scatter increases the fall.
const RAIN_SD: f64 = 2.0;
const RAIN_MOST_SCATTER: f64 = 0.1;
const DAYS_OF_WEEK: f64 = 7.0;

impl DriftAlarms {
    /// The strongest claim that the weather allows.
    pub(super) fn beside_weather(&mut self, latest: LatestThrow) -> Claim {
        let change = latest.drift.change_of_friction();
        let season = change.filter(|change| self.may_be_season(Cause::Friction, change.size, &Vector3::y(), latest));
        self.season_pct = season.map(|change| percent(change.size));
        match self.beside_rain(change, latest) {
            Claim::Named if season.is_some() => Claim::Counts,
            claim => claim,
        }
    }

    /// The strongest claim about a part that is named beside a known drift. The known drift may be the season's, so
    /// only the change of the new part must not be slow. `None` if `cause` is not such a part.
    pub(super) fn new_part(&self, cause: Cause, latest: LatestThrow) -> Option<Claim> {
        let Some(Naming::Another { new, .. }) = latest.drift.attribution.map(|attribution| attribution.naming) else {
            return None;
        };
        let is_slow = || self.may_be_season(cause, new.size, &new.weights, latest);
        (new.cause == cause && cause != Cause::Friction).then(|| if is_slow() { Claim::Counts } else { Claim::Named })
    }

    /// Whether the season may have caused a change of `cause`: the machine has no temperature, the change is below the
    /// critical limit, and a part of it existed a week ago. `size` is the sum of the logarithms with these `weights`.
    fn may_be_season(&self, cause: Cause, size: f64, weights: &Vector3<f64>, latest: LatestThrow) -> bool {
        let LatestThrow { tracks, at, settings, .. } = latest;
        let is_critical = settings.relevance(cause, size) > settings.critical_factor;
        let per_day = tracks.throws_per_day(at).unwrap_or(settings.throws_per_day);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the cast saturates")]
        let week = ((DAYS_OF_WEEK * per_day) as u32).max(LONGEST_WINDOW);
        let was_there =
            || self.history.mean(week..u32::MAX).is_some_and(|level| weights.dot(&level) / size > SLOW_FROM);
        !is_critical && tracks.has_no_temperature() && was_there()
    }

    /// The strongest claim that rain allows; a fall of friction by rain ends within days.
    fn beside_rain(&mut self, change: Option<FrictionChange>, LatestThrow { order, at, .. }: LatestThrow) -> Claim {
        let Some(fall) = change.filter(|change| change.size < 0.0) else {
            self.fallen = None;
            return Claim::Named;
        };
        let (since, first) = *self.fallen.get_or_insert((at, order));
        // Until then, the last few throws of a direction show a new fall only in part.
        if !fall.lasts && order - first >= SHOWN_AFTER {
            self.fallen = None;
            return Claim::None;
        }
        let least_size = fall.size + (RAIN_SD * fall.size_sd).min(RAIN_MOST_SCATTER);
        let may_be_rain = -percent(fall.size) >= RAIN_PCT.start && -percent(least_size) < RAIN_PCT.end;
        if may_be_rain && may_rain_last(since, order - first, at) { Claim::Counts } else { Claim::Named }
    }
}
