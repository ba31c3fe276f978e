//! The drift in the last throws of a machine: detection, attribution, and evidence for each alarm.

mod alarms;
mod attribution;
mod condition;
mod course;
mod evidence;
mod explain;
mod history;
mod instruments;
mod intermittent;
mod latest_throw;
mod origin;
mod ranking;
mod threshold;
mod weather;
mod window;

use nalgebra::{Matrix3, Vector3};

pub(super) use alarms::{DriftAlarms, Onset};
pub(super) use attribution::{Attribution, CLOSE, DECISIVE, Naming, Rival};
pub(super) use condition::{Beginning, Condition, Ending, Left};
pub use course::LimitForecast;
pub(super) use course::{Course, Point};
pub(super) use evidence::{Known, MotorEvidence};
pub(super) use explain::Explanation;
pub(super) use history::History;
pub(super) use instruments::{Instruments, KNOWN_AFTER};
use intermittent::During;
pub(super) use intermittent::{Departure, Intermittent, IntermittentFault};
pub(super) use latest_throw::LatestThrow;
pub(super) use origin::{Awaited, Origin, SensorFault};
pub(super) use threshold::Thresholds;
pub(super) use window::{RecentThrow, RecentThrows, Stream, Tested, UNKNOWN_SCALE_SD, Window, with_middle_kept};

use self::{
    attribution::Case,
    condition::{AlarmEvidence, Claim, LEVELS_FOLLOW, Transition},
    evidence::may_show_weaker_motor,
    explain::{
        Fit, LEAKS_OF_SERIES, Leaks, PLAIN_LEAKS, direction_of, fit, fit_along, fit_beside, friction_of_sound_motor,
        single,
    },
    ranking::{Explanations, best_single, explained},
};
use super::{
    Blindness, Cause, Settings,
    gauges::{Gauge, Gauges, dry_rise},
    statistics::{LONGEST_WINDOW, Scatter, percent, sym3},
};

/// Lead of one name over the others (odds of 150 to 1) from which the name is certain enough that an alarm does not
/// wait for more throws because of it.
const SAFE: f64 = 10.0;
/// Number of throws for which an alarm waits longer while the name is uncertain.
const DOUBTED_PATIENCE: u32 = 2;
/// Number of throws for which an alarm waits longer without a single name: more throws after a step usually give one.
const UNNAMED_PATIENCE: u32 = 6;
/// Number of throws for which an alarm waits longer if two explanations are too close to call: the longest window
/// distinguishes most of them.
const TOO_CLOSE_PATIENCE: u32 = LONGEST_WINDOW;

/// Factor on warning limits while a baseline is incomplete, as its few throws do not include the weather yet.
const PROVISIONAL_WIDENING: f64 = 1.5;

/// Part of the warning limit for health: plain health if the size plus two standard deviations is below it, likely
/// health if the size alone is.
pub(super) const HEALTHY_BELOW: f64 = 0.5;
/// Largest change of b0 or a0, relative to that of a1, in a change of friction, which the weather can cause.
const BESIDE_WEATHER: f64 = 0.67;
/// Least size of a part that both directions show, in standard deviations.
const SAME_SIGN_SD: f64 = 2.0;
/// A change lasts while the last few throws have at least this part of it.
const STILL_CHANGED: f64 = 0.5;

/// A change of friction, as change of ln a1. Wear and cold raise the friction; rain and warmth lower it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FrictionChange {
    pub(super) size: f64,
    pub(super) size_sd: f64,
    /// Whether the last few throws still have the change.
    pub(super) lasts: bool,
}

/// The drift in the last throws.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drift {
    /// Whether a baseline is still incomplete.
    pub(super) provisional: bool,
    /// The attribution, if a drift is detected.
    pub(super) attribution: Option<Attribution>,
    /// The window with the most significant drift.
    pub(super) strongest: Option<Tested>,
    /// Origin of the drift, by the gauges.
    pub(super) origin: Origin,
    /// The causes of the active drift alarms, without those of rules that name no part.
    pub(super) alarmed: Vec<Cause>,
    /// Whether a direction has a baseline, but too few throws for a level.
    pub(super) is_half_seen: bool,
    /// Mean of the last throws of each direction, at most twelve.
    pub(super) levels: [Option<Window>; 2],
    /// Mean of the last throws of each direction, at most six.
    pub(super) last_few: [Option<Window>; 2],
    /// Direction of the latest throw as an index, and the mean of the last three throws of this direction.
    pub(super) latest: (usize, Option<Window>),
    /// The change that the uncertain effect of the temperature hides, if it is one at the warning limit.
    pub(super) hidden: Option<Blindness>,
}

impl Drift {
    /// T of the strongest window relative to its limit (see [`self::window`]).
    fn excess(&self) -> f64 {
        self.strongest.map_or(0.0, |strongest| strongest.excess)
    }

    /// The windows that show the present drift; after a step the shorter ones show it better.
    pub(super) fn windows(&self) -> impl Iterator<Item = &Window> {
        let strongest = self.strongest.iter().map(|strongest| &strongest.window);
        self.levels.iter().chain(&self.last_few).flatten().chain(strongest)
    }

    /// Whether the last throws of both directions show the named part, with the same sign.
    pub(super) fn is_in_both(&self, settings: &Settings) -> bool {
        let main = self.attribution.as_ref().and_then(Attribution::main);
        let [Some(normal), Some(reverse)] = &self.last_few else { return false };
        main.is_some_and(|main| {
            let [a, b] = [normal, reverse].map(|window| window.single(main.cause, settings));
            let is_shown = |part: &Explanation| part.size.abs() > SAME_SIGN_SD * part.size_sd;
            a.size * b.size > 0.0 && is_shown(&a) && is_shown(&b)
        })
    }

    /// Whether the two directions have opposite changes.
    pub(super) fn is_opposite(&self) -> bool {
        self.attribution.as_ref().is_some_and(|attribution| matches!(attribution.naming, Naming::Opposite(_)))
    }

    /// The drift as a change of friction, if it is above its limit and mostly a change of a1 in the same sense in both
    /// directions.
    pub(super) fn change_of_friction(&self) -> Option<FrictionChange> {
        let is_possible = self.matters() && !self.is_opposite();
        let Window { mean, covariance, .. } = self.strongest.as_ref().filter(|_| is_possible)?.window;
        let beside = mean.x.abs().max(mean.z.abs());
        let lasts = self.latest.1.as_ref().is_none_or(|window| window.mean.y / mean.y > STILL_CHANGED);
        (beside < BESIDE_WEATHER * mean.y.abs()).then_some(FrictionChange {
            size: mean.y,
            size_sd: covariance[(1, 1)].sqrt(),
            lasts,
        })
    }

    /// Whether a drift is detected and above its warning limit, whatever its cause.
    pub(super) fn matters(&self) -> bool {
        let limit = if self.provisional { PROVISIONAL_WIDENING } else { 1.0 };
        self.attribution.as_ref().is_some_and(|attribution| attribution.relevance > limit)
    }

    /// The evidence about `cause`. `sense`: the sign of the change in its active alarm; 0 without one.
    pub(super) fn evidence(&self, cause: Cause, sense: f64, settings: &Settings) -> AlarmEvidence {
        let excused = self.origin.is_instrument();
        let named = self.attribution.as_ref().filter(|attribution| attribution.cause() == cause && !excused);
        // A past fault of a sensor or the supply raises no alarm, but it ends none either.
        let other = matches!(self.origin, Origin::Sensor(_) | Origin::Supply) && self.matters()
            || self.attribution.as_ref().is_some_and(|attribution| {
                matches!(attribution.naming, Naming::One(_) | Naming::Opposite(_))
                    && !attribution.includes(cause)
                    && self.matters()
            });
        let levels = self.levels.iter().flatten().filter(|window| window.shows(cause));
        // A level that is missing, or that the temperature hides, does not count as healthy.
        let is_shown = levels.clone().next().is_some() && !self.is_half_seen && self.hidden.is_none();
        // Fitted together with a second part, a part has another size.
        let other_part = self.attribution.as_ref().and_then(|attribution| attribution.beside(cause));
        let extent = |window: &Window| extent((cause, sense), other_part, window, settings);
        let Extent { size, in_sense, bound } = levels.map(extent).fold(Extent::default(), Extent::max_of_each);
        let last_few = self.latest.1.as_ref();
        let deadband = 1.0 - settings.deadband_pct / 100.0;
        // After a repair, a longer window still contains throws from before it, so no single part explains its mean.
        let has_ended = cause == Cause::Unattributed && last_few.is_some_and(|window| extent(window).size < deadband);
        let claim = match named {
            Some(_) if self.matters() => {
                // The next throw confirms a step, but not an outlier.
                let is_confirmed = self.strongest.is_some_and(|strongest| strongest.confirmed);
                if is_confirmed && !has_ended { Claim::Named } else { Claim::Counts }
            }
            // The name is not stable yet, so throws with a name count for an alarm without one.
            _ if cause == Cause::Unattributed && self.matters() && !self.is_alarmed() && !excused => Claim::Counts,
            _ => Claim::None,
        };
        AlarmEvidence {
            claim,
            certain_size: named.map_or(0.0, |attribution| match attribution.naming {
                // The strongest window may be of the direction with the smaller drift.
                Naming::One(_) if attribution.lead >= DECISIVE => attribution.relevance.max(size),
                _ if attribution.lead >= DECISIVE || cause == Cause::Unattributed => attribution.relevance,
                _ if self.alarmed.contains(&cause) => attribution.relevance.min(attribution.relevance_otherwise),
                _ => 0.0,
            }),
            patience: named.map_or(0, |attribution| self.patience(attribution)),
            plain_health: is_shown && bound < HEALTHY_BELOW,
            likely_health: is_shown && in_sense < HEALTHY_BELOW && bound < 1.0,
            left: Left { size, in_sense },
            below: is_shown && (self.attribution.is_none() || size < deadband),
            other_name: other,
            turned: false,
            unchecked: false,
        }
    }

    /// Whether the cause that the drift names has an alarm.
    fn is_alarmed(&self) -> bool {
        self.attribution.is_some_and(|attribution| self.alarmed.contains(&attribution.cause()))
    }

    /// Number of throws for which the alarm named by `attribution` waits in addition to the on delay.
    fn patience(&self, attribution: &Attribution) -> u32 {
        let has_other_part = || self.alarmed.iter().any(|cause| cause.is_part());
        let of_name = match attribution.naming {
            // A window with throws from before and after a second fault may look like a fault of a third part.
            Naming::One(_) if !self.is_alarmed() && has_other_part() => TOO_CLOSE_PATIENCE,
            Naming::One(_) | Naming::Another { .. } if attribution.lead >= SAFE => 0,
            Naming::One(_) | Naming::Another { .. } => DOUBTED_PATIENCE,
            Naming::Either(..) | Naming::Beside { .. } => TOO_CLOSE_PATIENCE,
            // One part alone explains the drift nearly as well as the two.
            Naming::Both(..) if matches!(attribution.rival, Some(Rival::Alone(_))) => TOO_CLOSE_PATIENCE,
            Naming::Both(..) | Naming::Neither(..) | Naming::Opposite(_) => UNNAMED_PATIENCE,
        };
        // More throws distinguish the part from a sensor that explains the drift as well.
        let is_like_sensor = matches!(self.origin, Origin::Either { waits: Awaited::Throws, .. });
        of_name + if is_like_sensor { TOO_CLOSE_PATIENCE } else { 0 }
    }

    /// Standard deviation of the effect of the temperature on (ln b0, ln a1, ln a0) in the last throws.
    pub(super) fn temperature_sd(&self) -> Vector3<f64> {
        self.levels.iter().flatten().map(|window| window.temperature_sd).next().unwrap_or_default()
    }

    /// Weights of the three logarithms in the size of `cause`, from the window with the largest size; `None` if a
    /// window does not show the cause. Where one direction has ratios only, the weights are of these, so that both
    /// directions have a size.
    pub(super) fn weights(&self, cause: Cause, settings: &Settings) -> Option<Vector3<f64>> {
        let windows = self.levels.iter().chain(&self.last_few).flatten();
        if windows.clone().any(|window| !window.shows(cause)) {
            return None;
        }
        let any_without_scale = windows.clone().any(|window| !window.has_scale());
        let parts = windows.filter(|window| !(any_without_scale && window.has_scale())).flat_map(|window| {
            let shown = alarm_causes(cause).filter(|part| window.shows(*part));
            shown.map(|part| window.single(part, settings))
        });
        let largest = parts.max_by(|a, b| a.relevance(settings).total_cmp(&b.relevance(settings)))?;
        Some(largest.weights)
    }
}

/// Attributes the drift of the strongest window of the stream of a side, or of the mixed stream. `last_few`: as
/// [`Drift::last_few`].
pub(super) fn attribute(
    (window, scatter, side): (&Window, &Scatter, Option<usize>),
    last_few: &[Option<Window>; 2],
    known: &Known,
    settings: &Settings,
) -> Attribution {
    let last = side.map_or_else(|| mean_of_both(last_few), |side| last_few[side]);
    let is_before = last.is_some_and(|last| is_before_motor_fault(window, &last, known, settings));
    let known = &Known { gauges: known.gauges.filter(|_| !is_before), ..known.clone() };
    // The supply explains only a part of this drift, so the rest is attributed.
    let is_beyond_supply = |gauges: &&Gauges| {
        gauges.supply_lost(window.throws).is_some_and(|lost| window.exceeds_motor(gauges.motor_of_inrush(lost.value)))
    };
    let longer = known.gauges.filter(is_beyond_supply).and_then(|gauges| gauges.level(Gauge::Duration, window.throws));
    let rest = longer.map_or(*window, |longer| window.without_dry_rise(dry_rise(longer)));
    let mut found = Attribution::of(&Case { window: &rest, of_one_throw: &scatter.of_one_throw(), known, settings });
    found.mean = window.mean;
    found
}

/// Least size of `cause` \[%\] that is detected in a mean with this covariance and this limit of T; `None` if no size
/// is.
pub(super) fn visible_pct(cause: Cause, covariance: Matrix3<f64>, limit: f64) -> Option<f64> {
    let d = direction_of(cause)?;
    let visible = percent((limit / (d.transpose() * sym3::inverse(&covariance)? * d).x).sqrt());
    visible.is_finite().then_some(visible)
}

/// Size of a change relative to the warning limit.
#[derive(Clone, Copy, Default)]
struct Extent {
    size: f64,
    /// The size in the sense of the alarm: 0 if it has the opposite sign.
    in_sense: f64,
    /// `in_sense` with two standard deviations added to the size.
    bound: f64,
}

impl Extent {
    fn max_of_each(self, other: Self) -> Self {
        Self {
            size: self.size.max(other.size),
            in_sense: self.in_sense.max(other.in_sense),
            bound: self.bound.max(other.bound),
        }
    }
}

/// Extent of `cause` in a window; with `beside`, in a fit of both parts together. `sense`: the sign of the change in the
/// active alarm; 0 without one.
fn extent((cause, sense): (Cause, f64), beside: Option<Cause>, window: &Window, settings: &Settings) -> Extent {
    let of = |cause: Cause| {
        let e = match beside {
            Some(other) => window.fit([cause, other], settings).parts[0],
            None => window.single(cause, settings),
        };
        let size = settings.relevance(cause, e.size);
        let is_opposite = e.size * sense < 0.0;
        let (in_sense, nearest) = if is_opposite { (0.0, -e.size.abs()) } else { (size, e.size.abs()) };
        let bound = settings.relevance(cause, (nearest + 2.0 * e.size_sd).max(0.0));
        Extent { size, in_sense, bound }
    };
    alarm_causes(cause).filter(|part| window.shows(*part)).map(of).fold(Extent::default(), Extent::max_of_each)
}

/// The mean of both directions with equal weights, as dry friction may change the coefficients of each differently.
fn mean_of_both(levels: &[Option<Window>; 2]) -> Option<Window> {
    let [a, b] = levels;
    let (a, b) = (a.as_ref()?, b.as_ref()?);
    Some(Window { mean: 0.5 * (a.mean + b.mean), covariance: 0.25 * (a.covariance + b.covariance), ..*a })
}

/// Whether the last few throws show a new fault of the motor, and most of `window` is from before it. The gauges are
/// those of the last few throws, so they do not apply to such a window.
fn is_before_motor_fault(window: &Window, last: &Window, known: &Known, settings: &Settings) -> bool {
    const SHOWN_SD: f64 = 3.0;
    let back_emf = known.gauges.and_then(|gauges| gauges.back_emf(last.throws));
    if window.throws <= last.throws || !may_show_weaker_motor(last, back_emf.as_ref()) {
        return false;
    }
    let since = best_single(&Window { mean: last.mean - window.mean, ..*last }, settings);
    since.cause == Cause::Kt && since.relevance(settings) > 1.0 && since.size.abs() > SHOWN_SD * since.size_sd
}

/// The physical causes of an alarm: its cause, or all four of an unattributed one.
fn alarm_causes(cause: Cause) -> impl Iterator<Item = Cause> {
    Cause::PHYSICAL.into_iter().filter(move |part| cause == Cause::Unattributed || *part == cause)
}
