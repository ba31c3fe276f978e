//! Which part it is: the explanation of a drift that leads over all others.
//!
//! A cause is named when its score leads over that of every other name by a margin, else two are too close to call.
//! Pairs of causes are named when no single one comes near.
//!
//! The paper's cross-correlation rule shifts the margin between inertia and the rest, where it can tell: with much natural
//! scatter it would not see inertia of the drift's size either, and then its silence says nothing.

use nalgebra::{Matrix3, Vector3};

use super::{
    correlation::Correlation,
    event::{Cause, RunnerUp},
    explain::{Explanation, Fit, direction_of, fit, single},
    settings::Settings,
    window::Window,
};

/// A lead that decides between two explanations: odds of 20 to 1, as twice the logarithm.
const CLOSE: f64 = 6.0;
/// A lead that leaves no doubt: odds of 1000 to 1. A critical name needs it.
pub(super) const DECISIVE: f64 = 13.8;
/// How much closer, when the cross-correlation rule agrees with the named cause, and how much less when it does not.
const RULE_WEIGHT: f64 = 1.5;
/// By how much an explanation that already has an alarm is preferred: a verdict at the edge must not flip to and fro.
const STICKY: f64 = 4.0;
/// A second movement smaller than this part of its warning limit is no second fault. Below 1, as its size is in doubt.
const MATTERS: f64 = 0.75;

/// The causes to which a drift is attributed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Naming {
    /// One cause explains it, and nothing else does nearly as well.
    One(Explanation),
    /// Two causes explain it equally well, the better first.
    Either(Explanation, Explanation),
    /// No single cause explains it, these two together do.
    Both(Explanation, Explanation),
    /// Nothing simple explains it.
    Neither,
}

/// Another explanation that cannot be ruled out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rival {
    Alone(Cause),
    Together(Cause, Cause),
}

/// A drift with its name, and the figures that speak for and against the name.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Attribution {
    pub(super) naming: Naming,
    /// Beside a naming with two causes.
    pub(super) rival: Option<Rival>,
    pub(super) runner_up: Option<RunnerUp>,
    pub(super) correlation: Correlation,
    /// Whether the cross-correlation rule takes it for inertia; `None` where it cannot tell.
    rule: Option<bool>,
    /// Changes of (ln b0, ln a1, ln a0).
    pub(super) mean: Vector3<f64>,
    /// Its size over the warning limit of what it may be: it matters above 1.
    pub(super) relevance: f64,
    /// Lead of a single name over everything of which it is no part.
    pub(super) lead: f64,
}

/// Every explanation of a drift, each kind ordered with the best first.
struct Explanations {
    singles: [Fit<1>; 4],
    pairs: [Fit<2>; 6],
    /// Any three movements.
    any: Fit<3>,
}

impl Attribution {
    /// Names the drift of `window` on a machine that scatters with `of_one_throw`. `open` are the causes with an active
    /// alarm.
    pub(super) fn of(window: &Window, of_one_throw: &Matrix3<f64>, open: &[Cause], settings: &Settings) -> Self {
        let all = Explanations::of(window, open, settings);
        let [best, next, ..] = &all.singles;
        let correlation = Correlation::of(of_one_throw, &window.mean);
        let attribution = Self {
            naming: Naming::Neither,
            rival: None,
            runner_up: None,
            correlation,
            rule: says_inertia(&correlation, window, of_one_throw, settings),
            mean: window.mean,
            relevance: all.any.relevance(settings),
            lead: 0.0,
        };
        if all.any.score + CLOSE < best.score.min(all.pairs[0].score) {
            return attribution;
        }
        if let Some(both) = attribution.both(&all, settings) {
            return both;
        }
        let margin = next.score - best.score;
        let (main, second) = (all.freed_best(), next.parts[0]);
        let attribution = Self { runner_up: Some(RunnerUp { cause: second.cause, margin }), ..attribution };
        if margin < attribution.margin_needed(main.cause, second.cause) {
            let relevance = main.relevance(settings).max(second.relevance(settings));
            return Self { naming: Naming::Either(main, second), relevance, ..attribution };
        }
        let strangers = all.pairs.iter().filter(|pair| !pair.includes(main.cause));
        let lead = strangers.map(|pair| pair.score - best.score).fold(margin, f64::min);
        Self { naming: Naming::One(main), relevance: main.relevance(settings), lead, ..attribution }
    }

    /// The same drift as two causes together, when no single one is clearly better.
    fn both(self, all: &Explanations, settings: &Settings) -> Option<Self> {
        let [best, ..] = &all.singles;
        let cause = best.parts[0].cause;
        let plausible = all.pairs.iter().filter(|pair| pair.score < all.pairs[0].score + CLOSE);
        let matters = |pair: &&Fit<2>| pair.parts.iter().all(|part| part.relevance(settings) >= MATTERS);
        let stranger = all.pairs.first().filter(|pair| !pair.includes(cause));
        let pair = plausible.clone().find(matters).or(stranger)?;
        let ahead = pair.score - best.score;
        if ahead >= CLOSE {
            return None;
        }
        let rival = if ahead > -CLOSE {
            Some(Rival::Alone(cause))
        } else {
            let other = all.pairs.iter().find(|other| *other != pair && other.score < pair.score + CLOSE);
            other.map(|other| Rival::Together(other.parts[0].cause, other.parts[1].cause))
        };
        let [mut a, mut b] = pair.parts;
        if a.relevance(settings) < b.relevance(settings) {
            (a, b) = (b, a);
        }
        let relevance = plausible.map(|pair| pair.relevance(settings)).fold(0.0, f64::max);
        Some(Self { naming: Naming::Both(a, b), rival, relevance, ..self })
    }

    /// The lead that one name needs over another. The rule tells inertia from the rest, and nothing else: a name that it
    /// takes for inertia has to be beyond doubt.
    fn margin_needed(&self, best: Cause, next: Cause) -> f64 {
        match (self.rule, best == Cause::Inertia, next == Cause::Inertia) {
            (Some(true), true, _) | (Some(false), _, true) => CLOSE / RULE_WEIGHT,
            (Some(false), true, _) => CLOSE * RULE_WEIGHT,
            (Some(true), _, true) => DECISIVE,
            _ => CLOSE,
        }
    }

    /// The name under which it is alarmed.
    pub(super) fn cause(&self) -> Cause {
        match self.naming {
            Naming::One(e) => e.cause,
            _ => Cause::Unattributed,
        }
    }

    /// Its largest part; of two that are too close to call, the better.
    pub(super) fn main(&self) -> Option<&Explanation> {
        match &self.naming {
            Naming::One(main) | Naming::Either(main, _) | Naming::Both(main, _) => Some(main),
            Naming::Neither => None,
        }
    }

    /// Whether the cross-correlation rule contradicts the name of its main part.
    pub(super) fn is_contradicted(&self) -> bool {
        let inertia = self.main().is_some_and(|main| main.cause == Cause::Inertia);
        self.rule.is_some_and(|says_inertia| says_inertia != inertia)
    }

    /// Whether `cause` is part of the attribution.
    pub(super) fn includes(&self, cause: Cause) -> bool {
        match &self.naming {
            Naming::One(e) => e.cause == cause,
            Naming::Either(a, b) | Naming::Both(a, b) => {
                cause == Cause::Unattributed || a.cause == cause || b.cause == cause
            }
            Naming::Neither => cause == Cause::Unattributed,
        }
    }
}

impl Explanations {
    fn of(window: &Window, open: &[Cause], settings: &Settings) -> Self {
        let [a, b, c, d] = Cause::PHYSICAL;
        let pairs = [[a, b], [a, c], [a, d], [b, c], [b, d], [c, d]];
        Self {
            singles: ranked(Cause::PHYSICAL.map(|cause| [cause]), window, |[cause]| open.contains(&cause), settings),
            pairs: ranked(pairs, window, |_| open.contains(&Cause::Unattributed), settings),
            any: fit([a, b, c], &window.mean, &window.covariance, settings),
        }
    }

    /// The best single cause; its size is free of a second movement, where that explains more.
    fn freed_best(&self) -> Explanation {
        let alone = self.singles[0].parts[0];
        let [pair, ..] = &self.pairs;
        let with_second = pair.parts.into_iter().find(|part| part.cause == alone.cause);
        with_second.filter(|_| pair.score < self.singles[0].score).unwrap_or(alone)
    }
}

/// All these explanations, the best first; `alarmed` ones are preferred.
fn ranked<const N: usize, const K: usize>(
    explanations: [[Cause; K]; N],
    window: &Window,
    alarmed: impl Fn([Cause; K]) -> bool,
    settings: &Settings,
) -> [Fit<K>; N] {
    let mut fits = explanations.map(|causes| {
        let mut fit = fit(causes, &window.mean, &window.covariance, settings);
        fit.score -= if alarmed(causes) { STICKY } else { 0.0 };
        fit
    });
    fits.sort_by(|a, b| a.score.total_cmp(&b.score));
    fits
}

/// Whether the cross-correlation rule takes a drift for inertia; `None` where natural scatter would hide inertia of its
/// size from the rule.
fn says_inertia(
    correlation: &Correlation,
    window: &Window,
    of_one_throw: &Matrix3<f64>,
    settings: &Settings,
) -> Option<bool> {
    let limit = settings.correlation_limit;
    let size = single(Cause::Inertia, &window.mean, &window.covariance, settings).size;
    let of_inertia = Correlation::of(of_one_throw, &(direction_of(Cause::Inertia)? * size));
    let says = correlation.tells_inertia(limit);
    (says || of_inertia.tells_inertia(limit)).then_some(says)
}
