//! Attribution of a drift to a cause: the best explanation, if it leads by a margin.
//!
//! A cause is named if its score leads over every other name by a margin; otherwise two are too close to call. Pairs of
//! causes are named if no single cause is nearly as good.
//!
//! The paper's cross-correlation rule changes the margin between inertia and the rest, unless the natural scatter would
//! hide inertia of the drift's size from the rule.

use nalgebra::{Matrix3, Vector3};

use super::{
    correlation::Correlation,
    event::{Cause, RunnerUp},
    explain::{Explanation, Fit, direction_of, fit, friction_of_sound_motor, single},
    settings::Settings,
    window::Window,
};

/// Lead that decides between two explanations: odds of 20 to 1, as twice the logarithm.
const CLOSE: f64 = 6.0;
/// Lead without doubt, needed for critical severity: odds of 1000 to 1.
pub(super) const DECISIVE: f64 = 13.8;
/// Factor on the margin: divides it if the cross-correlation rule agrees with the named cause, multiplies it if not.
const RULE_WEIGHT: f64 = 1.5;
/// Bonus of an explanation that already has an alarm, so that the verdict does not alternate.
const STICKY: f64 = 4.0;
/// Lead of two causes that leave out one with an alarm before the alarm is doubted.
const KNOWN: f64 = 20.0;
/// Least size of a second cause, as part of its warning limit. Below 1, as the size is uncertain.
const MATTERS: f64 = 0.75;

/// The known drifts of a machine.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Known {
    /// The causes with an active alarm.
    pub(super) causes: Vec<Cause>,
    /// Changes of (ln b0, ln a1, ln a0) with these alarms, before the last throws; `None` if too short.
    pub(super) level: Option<Vector3<f64>>,
}

/// The causes of a drift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Naming {
    /// One cause explains the drift, clearly better than all others.
    One(Explanation),
    /// Two causes explain the drift about equally well, the better first.
    Either(Explanation, Explanation),
    /// No single cause explains the drift, but these two together do.
    Both(Explanation, Explanation),
    /// One cause in addition to a known one, which has an alarm.
    Another { new: Explanation, known: Explanation },
    /// No one or two causes explain the drift.
    Neither,
}

/// Another explanation that cannot be ruled out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rival {
    Alone(Cause),
    Together(Cause, Cause),
}

/// A drift with its cause, and the figures for and against it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Attribution {
    pub(super) naming: Naming,
    /// The rival of a naming with two causes.
    pub(super) rival: Option<Rival>,
    pub(super) runner_up: Option<RunnerUp>,
    pub(super) correlation: Correlation,
    /// Verdict of the cross-correlation rule on inertia; `None` if scatter would hide it.
    rule: Option<bool>,
    /// Changes of (ln b0, ln a1, ln a0).
    pub(super) mean: Vector3<f64>,
    /// Size relative to the warning limit; relevant above 1.
    pub(super) relevance: f64,
    /// Lead of a single name over all explanations without it.
    pub(super) lead: f64,
}

/// The explanations of a drift, each kind with the best first.
struct Explanations {
    singles: [Fit<1>; 4],
    pairs: [Fit<2>; 6],
    /// Three free changes.
    any: Fit<3>,
}

impl Attribution {
    /// Attributes the drift of `window`; `of_one_throw` is the scatter of the machine.
    pub(super) fn of(window: &Window, of_one_throw: &Matrix3<f64>, known: &Known, settings: &Settings) -> Self {
        let all = Explanations::of(window, &known.causes, settings);
        let [best, next, ..] = &all.singles;
        let correlation = Correlation::of(of_one_throw, &window.mean);
        let attribution = Self {
            naming: Naming::Neither,
            rival: None,
            runner_up: None,
            correlation,
            rule: rule_verdict(&correlation, window, of_one_throw, settings),
            mean: window.mean,
            relevance: all.any.relevance(settings),
            lead: 0.0,
        };
        if all.any.score + CLOSE < best.score.min(all.pairs[0].score) {
            return attribution;
        }
        if let Some(both) = attribution.both(&all, settings) {
            return both.beside_known(&all, window, of_one_throw, known, settings);
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

    /// The attribution to two causes together, if no single cause is clearly better.
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

    /// Names the other of two causes, if one has an alarm and no other explanation is nearly as good; of two with alarms
    /// the larger. If other explanations are as good, the change since the level of the known drifts may have a single
    /// cause: a leak of friction and another cause can look like friction without a leak and a third cause, but the level
    /// shows the leak.
    fn beside_known(
        self,
        all: &Explanations,
        window: &Window,
        of_one_throw: &Matrix3<f64>,
        known: &Known,
        settings: &Settings,
    ) -> Self {
        let is_open = |part: &Explanation| known.causes.contains(&part.cause);
        let Some(own) = all.pairs.iter().find(|pair| pair.parts.iter().any(is_open)) else { return self };
        let [mut a, mut b] = own.parts;
        if a.relevance(settings) < b.relevance(settings) {
            (a, b) = (b, a);
        }
        let (new, old) = if is_open(&a) && !is_open(&b) { (b, a) } else { (a, b) };
        let strangers = all.pairs.iter().filter(|pair| !pair.includes(new.cause));
        let strangers = strangers.map(|pair| pair.score + if pair.includes(old.cause) { 0.0 } else { KNOWN });
        let alone = all.singles.iter().map(|single| single.score);
        let lead = strangers.chain(alone).map(|score| score - own.score).fold(f64::INFINITY, f64::min);
        let another = |new: Explanation, lead: f64| {
            let naming = Naming::Another { new, known: old };
            Self { naming, rival: None, relevance: new.relevance(settings), lead, ..self }
        };
        if lead >= CLOSE || is_open(&new) {
            return another(new, lead);
        }
        let Some(level) = known.level else { return self };
        // The level has less uncertainty than the window, whose baseline is the same.
        let since = Window { mean: window.mean - level, covariance: 2.0 * window.covariance, ..*window };
        let since = Self::of(&since, of_one_throw, &Known::default(), settings);
        match since.naming {
            Naming::One(new) if !is_open(&new) && since.relevance >= MATTERS => another(new, since.lead),
            _ => self,
        }
    }

    /// Names friction alone for a drift that without the gauges may be motor and friction together; `lead`: of a sound
    /// motor in the gauges.
    pub(super) fn of_sound_motor(self, window: &Window, lead: f64, settings: &Settings) -> Self {
        let friction = friction_of_sound_motor(&window.mean, &window.covariance);
        let runner_up = Some(RunnerUp { cause: Cause::Kt, margin: lead });
        let relevance = friction.relevance(settings);
        Self { naming: Naming::One(friction), rival: None, runner_up, relevance, lead, ..self }
    }

    /// The lead that `best` needs over `next`. The rule distinguishes only inertia from the rest.
    fn margin_needed(&self, best: Cause, next: Cause) -> f64 {
        match (self.rule, best == Cause::Inertia, next == Cause::Inertia) {
            (Some(true), true, _) | (Some(false), _, true) => CLOSE / RULE_WEIGHT,
            (Some(false), true, _) => CLOSE * RULE_WEIGHT,
            (Some(true), _, true) => DECISIVE,
            _ => CLOSE,
        }
    }

    /// The cause of the alarm.
    pub(super) fn cause(&self) -> Cause {
        match self.naming {
            Naming::One(e) | Naming::Another { new: e, .. } => e.cause,
            _ => Cause::Unattributed,
        }
    }

    /// The largest part; of two that are too close to call, the better.
    pub(super) fn main(&self) -> Option<&Explanation> {
        match &self.naming {
            Naming::One(main) | Naming::Either(main, _) | Naming::Both(main, _) | Naming::Another { new: main, .. } => {
                Some(main)
            }
            Naming::Neither => None,
        }
    }

    /// Whether the cross-correlation rule contradicts the name of its main part.
    pub(super) fn is_contradicted(&self) -> bool {
        let inertia = self.main().is_some_and(|main| main.cause == Cause::Inertia);
        self.rule.is_some_and(|rule_verdict| rule_verdict != inertia)
    }

    /// Whether `cause` is part of the attribution.
    pub(super) fn includes(&self, cause: Cause) -> bool {
        match &self.naming {
            Naming::One(e) => e.cause == cause,
            Naming::Another { new, known } => new.cause == cause || known.cause == cause,
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

    /// The best single cause, with its size from a fit with a second change if that explains more.
    fn freed_best(&self) -> Explanation {
        let alone = self.singles[0].parts[0];
        let [pair, ..] = &self.pairs;
        let with_second = pair.parts.into_iter().find(|part| part.cause == alone.cause);
        with_second.filter(|_| pair.score < self.singles[0].score).unwrap_or(alone)
    }
}

/// The explanations, the best first; `alarmed` ones get a bonus. Causes that the window does not show explain nothing.
fn ranked<const N: usize, const K: usize>(
    explanations: [[Cause; K]; N],
    window: &Window,
    alarmed: impl Fn([Cause; K]) -> bool,
    settings: &Settings,
) -> [Fit<K>; N] {
    let mut fits = explanations.map(|causes| {
        let mut fit = fit(causes, &window.mean, &window.covariance, settings);
        fit.score -= if alarmed(causes) { STICKY } else { 0.0 };
        if !causes.iter().all(|cause| window.shows(*cause)) {
            fit.score = f64::INFINITY;
        }
        fit
    });
    fits.sort_by(|a, b| a.score.total_cmp(&b.score));
    fits
}

/// Verdict of the cross-correlation rule on inertia; `None` if natural scatter would hide inertia of this size from the
/// rule.
fn rule_verdict(
    correlation: &Correlation,
    window: &Window,
    of_one_throw: &Matrix3<f64>,
    settings: &Settings,
) -> Option<bool> {
    let limit = settings.correlation_limit;
    let size = single(Cause::Inertia, &window.mean, &window.covariance, settings).size;
    let of_inertia = Correlation::of(of_one_throw, &(direction_of(Cause::Inertia)? * size));
    let says = correlation.indicates_inertia(limit);
    (says || of_inertia.indicates_inertia(limit)).then_some(says)
}
