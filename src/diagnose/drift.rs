//! The drift in the last throws of a machine: detection, attribution, and evidence for each alarm.

use nalgebra::{Matrix3, Vector3};

use super::{
    cause::{Attribution, Case, DECISIVE, Known, Naming, Rival, best_single},
    condition::{Claim, Reading},
    event::Cause,
    explain::{PLAIN_LEAKS, direction_of, fit, percent, relevance, single},
    origin::{Awaited, Origin},
    scatter::Scatter,
    settings::Settings,
    sym3,
    verdict::Blindness,
    window::Window,
};
use crate::throw::Direction;

/// From this lead of one name over the others on (odds of 150 to 1) the name is certain enough that an alarm does not
/// wait for further throws because of it.
const SAFE: f64 = 10.0;
/// Extra throws of waiting while the name is uncertain.
const DOUBTED_PATIENCE: u32 = 2;
/// Extra throws of waiting without a single name: more throws after a step usually give one.
const UNNAMED_PATIENCE: u32 = 6;
/// Extra throws of waiting if two explanations are too close to call: a longest window distinguishes most of them.
const TOO_CLOSE_PATIENCE: u32 = 24;

/// Factor on warning limits for a provisional baseline, which does not include the weather yet.
const PROVISIONAL_WIDENING: f64 = 1.5;

/// Part of the warning limit below which a size plus two standard deviations is plain health, and a size likely health.
const HEALTHY_BELOW: f64 = 0.5;
/// Largest change of another coefficient as part of a change of friction by weather.
const BESIDE_WEATHER: f64 = 0.67;
/// Part of a change that the last few throws have while it lasts.
const STILL_CHANGED: f64 = 0.5;

/// A change of friction, as change of ln a1. Wear and cold raise the friction; rain and warmth lower it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FrictionChange {
    pub(super) size: f64,
    /// Whether the last few throws have it.
    pub(super) lasts: bool,
}

/// Relation of the name of a drift to the active alarms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ToAlarms {
    /// Its cause has no alarm.
    New,
    /// Its cause has an active alarm.
    Alarmed,
    /// It is one part alone, while another part has an active alarm.
    Contradicts,
}

/// The drift in the last throws.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drift {
    /// T of the strongest window over its limit.
    pub(super) excess: f64,
    /// Whether a baseline is still incomplete.
    pub(super) provisional: bool,
    /// The attribution, if a drift is detected.
    pub(super) attribution: Option<Attribution>,
    /// The window with the most significant drift.
    pub(super) strongest: Option<Window>,
    /// Origin of the drift, by the gauges.
    pub(super) origin: Origin,
    /// Relation of its name to the active alarms.
    relation: ToAlarms,
    /// Whether a direction has a baseline, but too few throws for a level.
    is_half_seen: bool,
    /// Present level of each direction.
    pub(super) levels: [Option<Window>; 2],
    /// Level of each direction's last six throws.
    last_few: [Option<Window>; 2],
    /// Side of the latest throw, and the level of its last few throws.
    latest: (usize, Option<Window>),
    /// The change hidden by the temperature, if it hides one at the warning limit.
    pub(super) hidden: Option<Blindness>,
}

impl Drift {
    pub(super) fn new(
        strongest: Option<(Window, &Scatter, Option<usize>)>,
        [provisional, is_half_seen]: [bool; 2],
        [levels, last_few]: [[Option<Window>; 2]; 2],
        latest: (usize, Option<Window>),
        hidden: Option<Blindness>,
        known: &Known,
        settings: &Settings,
    ) -> Self {
        let excess = strongest.map_or(0.0, |(window, ..)| window.excess);
        let attribution = strongest.filter(|_| excess > 1.0).map(|(window, scatter, side)| {
            let last = side.map_or_else(|| mean_of_both(&last_few), |side| last_few[side]);
            let is_before = last.is_some_and(|last| is_before_motor_fault(&window, &last, settings));
            let gauges = known.gauges.filter(|_| !is_before);
            let known = &Known { gauges, ..known.clone() };
            Attribution::of(&Case { window: &window, of_one_throw: &scatter.of_one_throw(), known, settings })
        });
        let is_of_part = || known.causes.iter().any(|cause| Cause::PHYSICAL.contains(cause));
        let relation = match &attribution {
            Some(attribution) if known.causes.contains(&attribution.cause()) => ToAlarms::Alarmed,
            Some(Attribution { naming: Naming::One(_), .. }) if is_of_part() => ToAlarms::Contradicts,
            _ => ToAlarms::New,
        };
        let (strongest, origin) = (strongest.map(|(window, ..)| window), Origin::default());
        Self {
            excess,
            provisional,
            attribution,
            strongest,
            origin,
            relation,
            is_half_seen,
            levels,
            last_few,
            latest,
            hidden,
        }
    }

    /// The windows that show the present drift; after a step the shorter ones show it better.
    pub(super) fn windows(&self) -> impl Iterator<Item = &Window> {
        self.levels.iter().chain(&self.last_few).chain([&self.strongest]).flatten()
    }

    /// A drift above its limit as a change of friction, if it is mostly that.
    pub(super) fn change_of_friction(&self) -> Option<FrictionChange> {
        let Window { mean, .. } = self.strongest.as_ref().filter(|_| self.matters())?;
        let beside = mean.x.abs().max(mean.z.abs());
        let lasts = self.latest.1.as_ref().is_none_or(|window| window.mean.y / mean.y > STILL_CHANGED);
        (beside < BESIDE_WEATHER * mean.y.abs()).then_some(FrictionChange { size: mean.y, lasts })
    }

    /// Whether a drift is detected and above its limit, with any name.
    pub(super) fn matters(&self) -> bool {
        let limit = if self.provisional { PROVISIONAL_WIDENING } else { 1.0 };
        self.attribution.as_ref().is_some_and(|attribution| attribution.relevance > limit)
    }

    /// The evidence about `cause`, whose alarm is active in the direction `alarmed` (inner `None`: in both).
    #[expect(clippy::option_option, reason = "no alarm is not an alarm in both directions")]
    pub(super) fn reading(&self, cause: Cause, alarmed: Option<Option<Direction>>, settings: &Settings) -> Reading {
        let excused = self.origin.is_instrument();
        let named = self.attribution.as_ref().filter(|attribution| attribution.cause() == cause && !excused);
        let undoubted = named.filter(|attribution| cause == Cause::Unattributed || attribution.lead >= DECISIVE);
        let other = excused && self.matters()
            || self.attribution.as_ref().is_some_and(|attribution| {
                matches!(attribution.naming, Naming::One(_))
                    && !attribution.includes(cause)
                    && attribution.relevance > 1.0
            });
        let levels = self.levels.iter().flatten().filter(|window| window.shows(cause));
        // A level that is missing, or that the temperature hides, does not count as healthy.
        let is_shown = levels.clone().next().is_some() && !self.is_half_seen && self.hidden.is_none();
        // The size of a part is smaller or larger when a second part is fitted beside it.
        let other_part = self.attribution.as_ref().and_then(|attribution| attribution.beside(cause));
        let extent = |window: &Window| extent(cause, other_part, window, settings);
        let (size, bound) = levels.map(extent).fold((0.0, 0.0), max_of_each);
        let (side, last_few) = &self.latest;
        let concerned = alarmed.flatten().is_none_or(|direction| Direction::BOTH[*side] == direction);
        let latest = last_few.as_ref().filter(|window| concerned && alarmed.is_some() && window.shows(cause));
        let latest = latest.map(|window| extent(window).0);
        let deadband = 1.0 - settings.deadband_pct / 100.0;
        // After a repair a longer window still has throws from before it, which no single part explains.
        let has_ended =
            cause == Cause::Unattributed && last_few.as_ref().is_some_and(|window| extent(window).0 < deadband);
        let claim = match named {
            Some(_) if self.matters() => {
                // A step keeps its level in the next throw, an outlier does not.
                let is_confirmed = self.strongest.is_some_and(|window| window.confirmed);
                if is_confirmed && !has_ended { Claim::Named } else { Claim::Counts }
            }
            // The name is not stable yet, also if throws in between had one.
            _ if cause == Cause::Unattributed && self.matters() && self.relation != ToAlarms::Alarmed && !excused => {
                Claim::Counts
            }
            _ => Claim::None,
        };
        Reading {
            claim,
            // The strongest window may be of the direction with the smaller drift.
            undoubted: undoubted.map_or(0.0, |attribution| match attribution.naming {
                Naming::One(_) => attribution.relevance.max(size),
                _ => attribution.relevance,
            }),
            patience: if matches!(self.origin, Origin::Either { waits: Awaited::Throws, .. }) {
                TOO_CLOSE_PATIENCE
            } else {
                0
            } + named.map_or(0, |attribution| match (attribution.naming, attribution.rival) {
                // Windows with throws before and after a second fault may look like a third part.
                (Naming::One(_), _) if self.relation == ToAlarms::Contradicts => TOO_CLOSE_PATIENCE,
                (Naming::One(_) | Naming::Another { .. }, _) if attribution.lead >= SAFE => 0,
                (Naming::One(_) | Naming::Another { .. }, _) => DOUBTED_PATIENCE,
                (Naming::Either(..) | Naming::Beside { .. }, _) | (_, Some(Rival::Alone(_))) => TOO_CLOSE_PATIENCE,
                (Naming::Both(..) | Naming::Neither(..), _) => UNNAMED_PATIENCE,
            }),
            plain_health: is_shown && bound < HEALTHY_BELOW,
            likely_health: is_shown && size < HEALTHY_BELOW && bound < 1.0,
            below: is_shown && (self.attribution.is_none() || size < deadband),
            other_name: other,
            turned: false,
            latest,
        }
    }

    /// Standard deviation of the effect of the temperature.
    pub(super) fn temperature_sd(&self) -> Vector3<f64> {
        self.levels.iter().flatten().map(|window| window.temperature_sd).next().unwrap_or_default()
    }

    /// Weights of the three logarithms in the size of `cause`; `None` if a window does not show it.
    pub(super) fn weights(&self, cause: Cause, settings: &Settings) -> Option<Vector3<f64>> {
        let windows = self.levels.iter().chain(&self.last_few).flatten();
        if windows.clone().any(|window| !window.shows(cause)) {
            return None;
        }
        let parts = windows.flat_map(|window| {
            let shown = alarm_causes(cause).filter(|part| window.shows(*part));
            shown.map(|part| single(part, &window.mean, &window.covariance, settings))
        });
        let largest = parts.max_by(|a, b| a.relevance(settings).total_cmp(&b.relevance(settings)))?;
        Some(largest.weights)
    }
}

/// Least visible size of `cause` \[%\] in a mean with this covariance and limit of T; `None` if no size shows.
pub(super) fn visible_pct(cause: Cause, covariance: Matrix3<f64>, limit: f64) -> Option<f64> {
    let d = direction_of(cause)?;
    let visible = percent((limit / (d.transpose() * sym3::inverse(&covariance)? * d).x).sqrt());
    visible.is_finite().then_some(visible)
}

/// Size of `cause` in a window, beside another part if there is one, relative to the warning limit; and the same plus two
/// standard deviations.
fn extent(cause: Cause, beside: Option<Cause>, window: &Window, settings: &Settings) -> (f64, f64) {
    let of = |cause: Cause| {
        let e = match beside {
            Some(other) => fit(PLAIN_LEAKS, [cause, other], &window.mean, &window.covariance, settings).parts[0],
            None => single(cause, &window.mean, &window.covariance, settings),
        };
        let bound = e.size.abs() + 2.0 * e.size_sd;
        (relevance(cause, e.size, settings), relevance(cause, bound, settings))
    };
    if cause == Cause::Unattributed {
        let shown = Cause::PHYSICAL.into_iter().filter(|part| window.shows(*part));
        shown.map(of).fold((0.0, 0.0), max_of_each)
    } else {
        of(cause)
    }
}

/// The mean of the levels of both directions, in which dry friction may change the coefficients differently.
fn mean_of_both(levels: &[Option<Window>; 2]) -> Option<Window> {
    let [a, b] = levels;
    let (a, b) = (a.as_ref()?, b.as_ref()?);
    Some(Window { mean: 0.5 * (a.mean + b.mean), covariance: 0.25 * (a.covariance + b.covariance), ..*a })
}

/// Whether `window` still has the level from before a new fault of the motor, which the last few throws show. The gauges, which
/// are those of the last few throws, say nothing about such a window.
fn is_before_motor_fault(window: &Window, last: &Window, settings: &Settings) -> bool {
    const SHOWN_SD: f64 = 3.0;
    if window.throws <= last.throws {
        return false;
    }
    let since = best_single(&Window { mean: last.mean - window.mean, ..*last }, settings);
    since.cause == Cause::Kt && since.relevance(settings) > 1.0 && since.size.abs() > SHOWN_SD * since.size_sd
}

/// The physical causes of an alarm: its cause, or all of them.
fn alarm_causes(cause: Cause) -> impl Iterator<Item = Cause> {
    Cause::PHYSICAL.into_iter().filter(move |part| cause == Cause::Unattributed || *part == cause)
}

fn max_of_each(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0.max(b.0), a.1.max(b.1))
}
