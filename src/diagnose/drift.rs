//! What the last throws of a machine say together: a drift, its name, and what follows for each alarm.

use nalgebra::Matrix3;

use super::{
    cause::{Attribution, DECISIVE, Naming, Rival},
    condition::{Claim, Reading},
    event::Cause,
    explain::{direction_of, percent, relevance, single},
    scatter::Scatter,
    settings::Settings,
    temperature::doubt,
    testimony::Testimony,
    window::Window,
};
use crate::throw::Direction;

/// A lead from which an alarm with one name waits no longer: odds of 150 to 1.
const SAFE: f64 = 10.0;
/// Throws by which an alarm waits longer while its name could still be another: the next ones settle it.
const DOUBTED_PATIENCE: u32 = 2;
/// Throws by which an alarm without a single name waits longer: the first throws after a step are few, and what they
/// leave open the next ones usually settle.
const UNNAMED_PATIENCE: u32 = 6;
/// The same when two explanations are too close to call: a longest window tells most of them apart.
const TOO_CLOSE_PATIENCE: u32 = 24;

/// By how much warning limits are wider on a provisional baseline: it has not seen the machine's weather yet.
const PROVISIONAL_WIDENING: f64 = 1.5;

/// A size below this part of its warning limit, two standard deviations added, is plain health.
const HEALTHY_BELOW: f64 = 0.5;
/// A drift is of one direction when the other shows less than this part of it.
const ONE_SIDED: f64 = 0.5;
/// And by this many standard deviations of the difference.
const ONE_SIDED_SD: f64 = 3.0;
/// Throws of the machine with the drift, six of each direction, from which its direction is told.
const ONE_SIDED_THROWS: u64 = 12;

/// What the last throws say.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drift {
    /// T of the strongest window over its limit.
    pub(super) excess: f64,
    /// Whether a baseline behind it is still being learned.
    provisional: bool,
    /// Named, when detected.
    pub(super) attribution: Option<Attribution>,
    /// The window in which it shows most.
    pub(super) strongest: Option<Window>,
    /// What the gauges say about it.
    pub(super) testimony: Testimony,
    /// Its name has an active alarm.
    is_alarmed: bool,
    /// Present level of each direction.
    pub(super) levels: [Option<Window>; 2],
    /// Level of each direction's last six throws.
    last_few: [Option<Window>; 2],
    /// Side of the latest throw, and the level of its last few throws.
    latest: (usize, Option<Window>),
    /// Cause and size \[%\] that the temperature hides, where it hides a warning limit.
    pub(super) hidden: Option<(Cause, f64)>,
}

impl Drift {
    #[expect(clippy::too_many_arguments, reason = "each part of the evidence has another source")]
    pub(super) fn new(
        strongest: Option<(Window, &Scatter)>,
        provisional: bool,
        [levels, last_few]: [[Option<Window>; 2]; 2],
        latest: (usize, Option<Window>),
        hidden: Option<(Cause, f64)>,
        open: &[Cause],
        settings: &Settings,
    ) -> Self {
        let excess = strongest.map_or(0.0, |(window, _)| window.excess);
        let attribution = strongest
            .filter(|_| excess > 1.0)
            .map(|(window, scatter)| Attribution::of(&window, &scatter.of_one_throw(), open, settings));
        let is_alarmed = attribution.as_ref().is_some_and(|attribution| open.contains(&attribution.cause()));
        let (strongest, testimony) = (strongest.map(|(window, _)| window), Testimony::default());
        Self { excess, provisional, attribution, strongest, testimony, is_alarmed, levels, last_few, latest, hidden }
    }

    /// Whether a drift is detected and above its limit, whatever its name.
    pub(super) fn matters(&self) -> bool {
        let limit = if self.provisional { PROVISIONAL_WIDENING } else { 1.0 };
        self.attribution.as_ref().is_some_and(|attribution| attribution.relevance > limit)
    }

    /// What the throw says about `cause`, whose alarm is active in the direction `alarmed` (inner `None`: in both).
    #[expect(clippy::option_option, reason = "no alarm is not an alarm in both directions")]
    pub(super) fn reading(&self, cause: Cause, alarmed: Option<Option<Direction>>, settings: &Settings) -> Reading {
        let excused = self.testimony.excuses();
        let named = self.attribution.as_ref().filter(|attribution| attribution.cause() == cause && !excused);
        let undoubted = named.filter(|attribution| cause == Cause::Unattributed || attribution.lead >= DECISIVE);
        let other = excused && self.matters()
            || self.attribution.as_ref().is_some_and(|attribution| {
                matches!(attribution.naming, Naming::One(_))
                    && !attribution.includes(cause)
                    && attribution.relevance > 1.0
            });
        let levels = self.levels.iter().flatten();
        let (size, bound) = levels.map(|window| extent(cause, window, settings)).fold((0.0, 0.0), max_of_each);
        let (side, last_few) = &self.latest;
        let concerned = alarmed.flatten().is_none_or(|direction| Direction::BOTH[*side] == direction);
        let latest = last_few.as_ref().filter(|_| concerned && alarmed.is_some());
        let latest = latest.map(|window| extent(cause, window, settings).0);
        let deadband = 1.0 - settings.deadband_pct / 100.0;
        let claim = match named {
            Some(_) if self.matters() => Claim::Named,
            // No name has settled, whatever the throws in between were taken for.
            _ if cause == Cause::Unattributed && self.matters() && !self.is_alarmed && !excused => Claim::Counts,
            _ => Claim::None,
        };
        Reading {
            claim,
            undoubted: undoubted.map_or(0.0, |attribution| attribution.relevance),
            patience: if matches!(self.testimony, Testimony::Either { waits: true, .. }) {
                TOO_CLOSE_PATIENCE
            } else {
                0
            } + named.map_or(0, |attribution| match (attribution.naming, attribution.rival) {
                (Naming::One(_), _) if attribution.lead >= SAFE => 0,
                (Naming::One(_), _) => DOUBTED_PATIENCE,
                (Naming::Either(..), _) | (_, Some(Rival::Alone(_))) => TOO_CLOSE_PATIENCE,
                (Naming::Both(..) | Naming::Neither, _) => UNNAMED_PATIENCE,
            }),
            plain_health: bound < HEALTHY_BELOW,
            below: self.attribution.is_none() || size < deadband,
            other_name: other,
            latest,
        }
    }

    /// The direction in which `cause` shows, `throws` throws after the drift was first suspected; `None` for both, and as long
    /// as a direction has too few throws with the drift to tell.
    pub(super) fn direction(&self, cause: Cause, throws: u64, settings: &Settings) -> Option<Direction> {
        let of = |window: &Window| {
            let parts = alarm_causes(cause).map(|part| single(part, &window.mean, &window.covariance, settings));
            parts.max_by(|a, b| a.relevance(settings).total_cmp(&b.relevance(settings)))
        };
        let side = self.leaning(cause, settings)?;
        let [Some(normal), Some(reverse)] = self.last_few.each_ref().map(|window| window.as_ref().and_then(of)) else {
            return Some(side);
        };
        let difference = (normal.size.abs() - reverse.size.abs()).abs();
        let clear = difference > ONE_SIDED_SD * normal.size_sd.hypot(reverse.size_sd);
        (throws >= ONE_SIDED_THROWS && clear).then_some(side)
    }

    /// The direction that shows more than twice as much of `cause` as the other: a first guess, for measuring its size.
    pub(super) fn leaning(&self, cause: Cause, settings: &Settings) -> Option<Direction> {
        let size = |at: usize| self.levels[at].as_ref().map(|window| extent(cause, window, settings).0);
        match (size(0), size(1)) {
            (Some(_), None) => Some(Direction::NormalToReverse),
            (None, Some(_)) => Some(Direction::ReverseToNormal),
            (Some(normal), Some(reverse)) if reverse < ONE_SIDED * normal => Some(Direction::NormalToReverse),
            (Some(normal), Some(reverse)) if normal < ONE_SIDED * reverse => Some(Direction::ReverseToNormal),
            _ => None,
        }
    }
}

/// Least size of `cause` \[%\] that such a window shows when T has this limit; and the same if the temperature's effect were
/// known.
pub(super) fn visible_pct(cause: Cause, window: &Window, limit: f64) -> Option<(f64, f64)> {
    let d = direction_of(cause)?;
    let least =
        |covariance: Matrix3<f64>| Some(percent((limit / (d.transpose() * covariance.try_inverse()? * d).x).sqrt()));
    Some((least(window.covariance)?, least(window.covariance - doubt(window.temperature_sd))?))
}

/// Size of `cause` in a window over its warning limit; and the same with two standard deviations added.
fn extent(cause: Cause, window: &Window, settings: &Settings) -> (f64, f64) {
    let of = |cause: Cause| {
        let e = single(cause, &window.mean, &window.covariance, settings);
        let bound = e.size.abs() + 2.0 * e.size_sd;
        (relevance(cause, e.size, settings), relevance(cause, bound, settings))
    };
    if cause == Cause::Unattributed {
        Cause::PHYSICAL.into_iter().map(of).fold((0.0, 0.0), max_of_each)
    } else {
        of(cause)
    }
}

/// The causes that an alarm may be about: itself, or any.
pub(super) fn alarm_causes(cause: Cause) -> impl Iterator<Item = Cause> {
    Cause::PHYSICAL.into_iter().filter(move |part| cause == Cause::Unattributed || *part == cause)
}

fn max_of_each(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0.max(b.0), a.1.max(b.1))
}
