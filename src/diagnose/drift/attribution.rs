//! Attribution of a drift to a cause.
//!
//! Each explanation of the drift, by one cause or by two, has a score; see [`super::explain`]. A single cause is named
//! if its score leads over every other cause by a margin; with a smaller lead, the two best causes are too close to
//! call. A pair of causes is named if no single cause is nearly as good.
//!
//! The paper's cross-correlation rule changes the margin between inertia and the other causes. It does not if the
//! scatter of the throws would hide a change of inertia of this size from the rule.

use nalgebra::{Matrix3, Vector3};

use super::{
    Explanation, Explanations, Fit, Known, MotorEvidence, Window, direction_of,
    evidence::{CHANGED, CHANGED_SD},
};
use crate::diagnose::{
    Cause, RunnerUp, Settings,
    gauges::BackEmf,
    statistics::{Correlation, Level},
};

/// Lead that decides between two explanations: odds of 20 to 1, as twice the logarithm.
pub(crate) const CLOSE: f64 = 6.0;
/// Lead without doubt, needed for critical severity: odds of 1000 to 1.
pub(crate) const DECISIVE: f64 = 13.8;
/// Factor of the cross-correlation rule on the margin: divides it if the rule agrees with the named cause, multiplies
/// it if the rule speaks against it.
const RULE_WEIGHT: f64 = 1.5;
/// Lead of a pair without the alarmed cause over the best pair with it, from which the alarm is doubted.
const DOUBTING_LEAD: f64 = 20.0;
/// Change of ln b0 below which a rise of friction may hide a loss of torque, and change of the back-EMF below which the
/// magnets are weak: the default warning limit of the motor.
const LOST_TORQUE: f64 = -0.05;
/// Change of ln(a0/b0) from which a rise of friction may hide a stiffer spring: about the default warning limit of the
/// stiffness.
const RISEN_STIFFNESS: f64 = 0.1;
/// Rise of friction, as a logarithm, from which a stiffer spring beside it is friction at the far end of the rails: it
/// bends the rails until that end slides.
const VERY_DRY: f64 = 0.5;
/// Least sizes of opposite changes of the two directions, in standard deviations and as part of the warning limit; of a
/// stiffness they are more probable, as any load that changes along the stroke looks like a spring.
const OPPOSITE: (f64, f64) = (3.0, 0.5);
const OPPOSITE_SPRING: (f64, f64) = (2.5, 0.4);
/// Least size of a second cause, as part of its warning limit; below 1, as the size is uncertain.
const MATTERS: f64 = 0.75;
/// Least size of a second cause beside one that explains the drift nearly as well alone, in standard deviations.
const SHOWN_SD: f64 = 2.0;

/// The causes of a drift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Naming {
    /// One cause explains the drift, clearly better than all others.
    One(Explanation),
    /// Two causes explain the drift about equally well, the better first.
    Either(Explanation, Explanation),
    /// No single cause explains the drift, but these two together do.
    Both(Explanation, Explanation),
    /// One cause in addition to a known one, which has an alarm.
    Another { new: Explanation, known: Explanation },
    /// A known cause, which has an alarm, and a further change: by one of two causes, the better first, or by none of
    /// the four.
    Beside { known: Explanation, first: Explanation, second: Explanation },
    /// No one or two causes explain the drift; these two together do best.
    Neither(Explanation, Explanation),
    /// One cause explains the drift of each direction, normal to reverse first, but with opposite signs. No part does
    /// this; a constant force on the toe does, as it hinders one direction and helps the other.
    Opposite([Explanation; 2]),
}

impl Naming {
    /// The named parts that have no alarm yet, the main part first.
    fn new_parts(&self) -> [Option<&Explanation>; 2] {
        match self {
            Self::One(one) | Self::Another { new: one, .. } => [Some(one), None],
            Self::Either(a, b) | Self::Both(a, b) | Self::Beside { first: a, second: b, .. } => [Some(a), Some(b)],
            Self::Neither(..) | Self::Opposite(_) => [None, None],
        }
    }

    /// The named part that has an alarm.
    fn known(&self) -> Option<&Explanation> {
        match self {
            Self::Another { known, .. } | Self::Beside { known, .. } => Some(known),
            _ => None,
        }
    }
}

/// Another explanation that cannot be ruled out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Rival {
    Alone(Cause),
    Together(Cause, Cause),
}

/// A drift with its cause, and the figures for and against it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Attribution {
    pub(crate) naming: Naming,
    /// The rival of a naming with two causes, if one is nearly as good.
    pub(crate) rival: Option<Rival>,
    pub(crate) runner_up: Option<RunnerUp>,
    pub(crate) correlation: Correlation,
    /// Verdict of the cross-correlation rule on inertia; `None` if scatter would hide it.
    rule: Option<bool>,
    /// Changes of (ln b0, ln a1, ln a0).
    pub(crate) mean: Vector3<f64>,
    /// Whether only the ratios of the coefficients are known.
    of_ratios: bool,
    /// Size relative to the warning limit; relevant above 1.
    pub(crate) relevance: f64,
    /// Lead of a single named cause over all explanations without it, as twice the logarithm of the odds.
    pub(crate) lead: f64,
    /// Size relative to the warning limit if the best explanation without the single named cause is right.
    pub(super) relevance_otherwise: f64,
    /// Evidence about the motor.
    pub(super) evidence: MotorEvidence,
    /// Change of the back-EMF, if a gauge shows it and not only a shorter duration.
    back_emf: Option<Level>,
}

/// A drift to attribute.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Case<'a> {
    /// The window with the drift.
    pub(crate) window: &'a Window,
    /// Covariance of one throw of the machine.
    pub(crate) of_one_throw: &'a Matrix3<f64>,
    pub(crate) known: &'a Known<'a>,
    pub(crate) settings: &'a Settings,
}

impl Attribution {
    /// Attributes the drift of a window.
    pub(crate) fn of(case: &Case) -> Self {
        let Case { window, of_one_throw, known, settings } = *case;
        let shown = known.gauges.and_then(|gauges| gauges.back_emf(window.throws));
        let decides = shown.filter(|shown| known.is_decided_by(shown, window, settings));
        let evidence = MotorEvidence::new(decides, known);
        let all = Explanations::of(window, &known.causes, evidence, settings);
        let [best, next, ..] = &all.singles;
        let [a, b] = all.pairs[0].parts;
        let correlation = Correlation::of(of_one_throw, &window.mean);
        let attribution = Self {
            naming: Naming::Neither(a, b),
            rival: None,
            runner_up: None,
            correlation,
            rule: rule_verdict(&correlation, window, of_one_throw, settings),
            mean: window.mean,
            of_ratios: !window.shows(Cause::Inertia),
            relevance: all.any.relevance(settings),
            lead: 0.0,
            relevance_otherwise: 0.0,
            evidence,
            back_emf: shown.and_then(BackEmf::of_motor),
        };
        if all.any.score + CLOSE < best.score.min(all.pairs[0].score) {
            return attribution.beside_something(&all, known, settings);
        }
        if let Some(dry) = attribution.very_dry(&all, known, settings) {
            return dry.since_known(&all, case).unwrap_or(dry);
        }
        if let Some(both) = attribution.both(&all, known, settings) {
            return both.beside_known(&all, case);
        }
        let margin = next.score - best.score;
        let (main, second) = (all.freed_best(), next.parts[0]);
        let attribution = Self { runner_up: Some(RunnerUp { cause: second.cause, margin }), ..attribution };
        if margin < attribution.margin_needed(main.cause, second.cause) {
            let relevance = main.relevance(settings).max(second.relevance(settings));
            return Self { naming: Naming::Either(main, second), relevance, ..attribution };
        }
        let one = attribution.to_best(&all, settings);
        one.since_known(&all, case).unwrap_or(one)
    }

    /// The attribution to the best single cause.
    fn to_best(self, all: &Explanations, settings: &Settings) -> Self {
        let main = all.freed_best();
        let (otherwise, parts) = all.best_without(main.cause);
        let lead = otherwise - all.singles[0].score;
        let relevance_otherwise = parts.iter().map(|part| part.relevance(settings)).fold(0.0, f64::max);
        let (naming, relevance) = (Naming::One(main), main.relevance(settings));
        Self { naming, rival: None, relevance, lead, relevance_otherwise, ..self }
    }

    /// The attribution if the last throws of the two directions do not show opposite changes of its single named cause;
    /// without one, of the friction, or of the stiffness if the two named causes are others. `levels` and `last_few`:
    /// means of the last throws of each direction, as in [`Drift`](super::Drift).
    pub(crate) fn unless_opposite(self, [levels, last_few]: [&[Option<Window>; 2]; 2], settings: &Settings) -> Self {
        let cause = match self.naming {
            Naming::One(main) | Naming::Another { new: main, .. } => main.cause,
            Naming::Both(a, b) | Naming::Neither(a, b) if [a, b].iter().all(|part| part.cause != Cause::Friction) => {
                Cause::Stiffness
            }
            _ => Cause::Friction,
        };
        let is_spring = cause == Cause::Stiffness;
        let (least_sd, least_part) = if is_spring { OPPOSITE_SPRING } else { OPPOSITE };
        let is_shown =
            |part: &Explanation| part.size.abs() > least_sd * part.size_sd && part.relevance(settings) > least_part;
        let explains = |window: &Window| {
            let score = |cause| window.fit([cause], settings).score;
            let others = Cause::PHYSICAL.into_iter().filter(|other| window.shows(*other)).map(score);
            score(cause) <= others.fold(f64::INFINITY, f64::min) + CLOSE
        };
        let opposite = |[normal, reverse]: &[Option<Window>; 2]| {
            let windows = [normal.as_ref()?, reverse.as_ref()?];
            let parts = windows.map(|window| window.single(cause, settings));
            let is_opposite = parts[0].size * parts[1].size < 0.0 && parts.iter().all(is_shown);
            (is_opposite && windows.into_iter().all(explains)).then_some(parts)
        };
        match opposite(levels).or_else(|| opposite(last_few).filter(|_| is_spring)) {
            Some(parts) => Self { naming: Naming::Opposite(parts), rival: None, runner_up: None, lead: 0.0, ..self },
            None => self,
        }
    }

    /// The attribution to friction, if friction and stiffness together explain the drift best, without the motor, and
    /// the friction has risen so much that it grows along the stroke.
    fn very_dry(self, all: &Explanations, known: &Known, settings: &Settings) -> Option<Self> {
        let [pair, ..] = &all.pairs;
        let is_dry = pair.size_of(Cause::Friction) > VERY_DRY && pair.size_of(Cause::Stiffness) > 0.0;
        let friction = pair.part(Cause::Friction).filter(|_| is_dry && self.may_be_far_end(known))?;
        let lead = all.best_without(Cause::Friction).0 - pair.score;
        let relevance = friction.relevance(settings);
        (lead >= CLOSE).then_some(Self { naming: Naming::One(friction), relevance, lead, ..self })
    }

    /// The attribution to two causes together, if no single cause is clearly better.
    fn both(self, all: &Explanations, known: &Known, settings: &Settings) -> Option<Self> {
        let [best, ..] = &all.singles;
        let cause = best.parts[0].cause;
        let plausible = all.pairs.iter().filter(|pair| pair.score < all.pairs[0].score + CLOSE);
        let is_sufficient_alone = |pair: &Fit<2>| pair.score > best.score - CLOSE;
        // If the gauges decide about the motor, a second cause whose size may be zero is not named beside one that is
        // sufficient alone.
        let is_shown = |part: &Explanation| part.cause == cause || part.size.abs() > SHOWN_SD * part.size_sd;
        let matters = |pair: &&Fit<2>| {
            let only_shown = self.is_decided() && is_sufficient_alone(pair);
            pair.parts.iter().all(|part| part.relevance(settings) >= MATTERS && (!only_shown || is_shown(part)))
        };
        let best_without = all.pairs.first().filter(|pair| !pair.includes(cause));
        let pair = plausible.clone().find(matters).or(best_without)?;
        let of_far_end = self.may_be_far_end(known) && is_sufficient_alone(pair) && may_grow_along_stroke(best, pair);
        // Any pair explains two ratios exactly, so beside saturation it must be better than a single cause.
        let lead = if self.of_ratios && self.evidence.may_saturate() { 0.0 } else { CLOSE };
        if pair.score >= best.score + lead || of_far_end {
            return None;
        }
        let rival = if is_sufficient_alone(pair) {
            Some(Rival::Alone(cause))
        } else {
            let other = all.pairs.iter().find(|other| *other != pair && other.score < pair.score + CLOSE);
            other.map(|other| Rival::Together(other.parts[0].cause, other.parts[1].cause))
        };
        let [a, b] = larger_first(pair, settings);
        let relevance = plausible.map(|pair| pair.relevance(settings)).fold(0.0, f64::max);
        Some(Self { naming: Naming::Both(a, b), rival, relevance, ..self })
    }

    /// Names the other of two causes, if one of them has an alarm and no other explanation is nearly as good. If both
    /// have alarms, it names the larger one. If other explanations are as good, the change since the level of the known
    /// drifts may still have a single cause. For example, friction that leaks and a second cause can look like friction
    /// without a leak and a third cause, but the level shows the leak.
    fn beside_known(self, all: &Explanations, case: &Case) -> Self {
        let Case { known, settings, .. } = *case;
        let is_open = |part: &Explanation| known.includes(part);
        let Some(pair) = all.pairs.iter().find(|pair| pair.parts.iter().any(is_open)) else { return self };
        let [a, b] = larger_first(pair, settings);
        let (new, old) = if is_open(&a) && !is_open(&b) { (b, a) } else { (a, b) };
        let without_new = all.pairs.iter().filter(|pair| !pair.includes(new.cause));
        let without_new =
            without_new.map(|pair| pair.score + if pair.includes(old.cause) { 0.0 } else { DOUBTING_LEAD });
        let alone = all.singles.iter().map(|single| single.score);
        let lead = without_new.chain(alone).map(|score| score - pair.score).fold(f64::INFINITY, f64::min);
        let another = |new: Explanation, lead: f64| {
            let naming = Naming::Another { new, known: old };
            Self { naming, rival: None, relevance: new.relevance(settings), lead, ..self }
        };
        if lead >= CLOSE || is_open(&new) {
            return another(new, lead);
        }
        if let Some(since) = self.since_known(all, case) {
            return since;
        }
        let best = &all.singles[0].parts[0];
        if is_open(best) && self.rival == Some(Rival::Alone(best.cause)) {
            // A second part is not needed.
            return self.to_best(all, settings);
        }
        self.beside_something(all, known, settings)
    }

    /// Names a second cause by the change since the level of the known drifts. Without the level, two faults one after
    /// the other may look like a single fault of a third part or of the second one. `None` if that change has no clear
    /// name, or if one cause explains level and change, so that the known name was wrong.
    fn since_known(self, all: &Explanations, case: &Case) -> Option<Self> {
        let Case { window, known, settings, .. } = *case;
        let is_open = |part: &Explanation| known.includes(part);
        let level = known.level?;
        let alone = Known { is_series: known.is_series, ..Known::default() };
        let named = |mean, covariance| {
            Self::of(&Case { window: &Window { mean, covariance, ..*window }, known: &alone, ..*case })
        };
        // The level is less uncertain than the window, and has the same baseline, so twice the covariance is an upper
        // bound.
        let since = named(window.mean - level, 2.0 * window.covariance);
        let Naming::One(found) = since.naming else { return None };
        if is_open(&found) || since.relevance < MATTERS {
            return None;
        }
        if let Naming::One(main) = &self.naming {
            let is_known = || matches!(&named(level, window.covariance).naming, Naming::One(before) if is_open(before));
            // A known fault that grows changes the coefficients in the direction of its own cause.
            let is_growth = is_open(main) && since.runner_up.is_some_and(|next| next.margin < DECISIVE);
            if is_growth || main.cause == found.cause && !is_known() {
                return None;
            }
        }
        // The sizes are those of a fit of both causes together.
        let pair = all.pairs.iter().find(|pair| pair.includes(found.cause) && pair.parts.iter().any(is_open))?;
        let [a, b] = pair.parts;
        let (new, known) = if a.cause == found.cause { (a, b) } else { (b, a) };
        let naming = Naming::Another { new, known };
        let (relevance, runner_up) = (new.relevance(settings), since.runner_up);
        Some(Self { naming, rival: None, relevance, runner_up, lead: since.lead, ..self })
    }

    /// If the attribution names no cause that has an alarm, keeps the name of such a cause, and names the two causes
    /// that explain the rest best. If two other causes contradict the alarm clearly, the attribution stays, which casts
    /// doubt on the alarm.
    fn beside_something(self, all: &Explanations, known: &Known, settings: &Settings) -> Self {
        let is_open = |part: &Explanation| known.includes(part);
        let keeps_one = matches!(&self.naming, Naming::Both(a, b) if is_open(a) || is_open(b));
        let mut with_known = all.pairs.iter().filter_map(|pair| match &pair.parts {
            [known, new] | [new, known] if is_open(known) && !is_open(new) => Some((pair.score, *known, *new)),
            _ => None,
        });
        let (Some((score, old, first)), Some((_, _, second))) = (with_known.next(), with_known.next()) else {
            return self;
        };
        let is_doubted = matches!(self.naming, Naming::Both(..)) && score > all.pairs[0].score + DOUBTING_LEAD;
        if keeps_one || is_doubted {
            return self;
        }
        let relevance = first.relevance(settings).max(second.relevance(settings));
        Self { naming: Naming::Beside { known: old, first, second }, rival: None, relevance, lead: 0.0, ..self }
    }

    /// The lead that `best` needs over `next`. The cross-correlation rule distinguishes only inertia from the other
    /// causes.
    fn margin_needed(&self, best: Cause, next: Cause) -> f64 {
        match (self.rule, best == Cause::Inertia, next == Cause::Inertia) {
            (Some(true), true, _) | (Some(false), _, true) => CLOSE / RULE_WEIGHT,
            (Some(false), true, _) => CLOSE * RULE_WEIGHT,
            (Some(true), _, true) => DECISIVE,
            _ => CLOSE,
        }
    }

    /// The cause of the alarm.
    pub(crate) fn cause(&self) -> Cause {
        match self.naming {
            Naming::One(e) | Naming::Another { new: e, .. } => e.cause,
            _ => Cause::Unattributed,
        }
    }

    /// The largest part; of two that are too close to call, the better.
    pub(crate) fn main(&self) -> Option<&Explanation> {
        self.naming.new_parts()[0]
    }

    /// Whether one part alone is named.
    pub(super) fn is_of_one(&self) -> bool {
        matches!(self.naming, Naming::One(_))
    }

    /// Of two parts that are named together, the one without an alarm if the other has one. A motor whose back-EMF has
    /// changed is left out, as it needs no other evidence.
    pub(super) fn beside_open(&self, is_open: impl Fn(Cause) -> bool) -> Option<&Explanation> {
        let Naming::Both(a, b) = &self.naming else { return None };
        let new = match [a, b].map(|part| is_open(part.cause)) {
            [true, false] => b,
            [false, true] => a,
            _ => return None,
        };
        Some(new).filter(|new| new.cause != Cause::Kt || !self.has_changed_motor())
    }

    /// The part that is named together with `cause`; of two possible ones, the better.
    pub(crate) fn beside(&self, cause: Cause) -> Option<Cause> {
        let (Naming::Both(a, b) | Naming::Another { new: a, known: b } | Naming::Beside { known: a, first: b, .. }) =
            &self.naming
        else {
            return None;
        };
        [(a, b), (b, a)].into_iter().find(|(one, _)| one.cause == cause).map(|(_, other)| other.cause)
    }

    /// Whether a stiffer spring beside friction may be friction at the far end of the rails: the back-EMF decides about
    /// the motor, and no stiffness has an alarm. One that has an alarm rose at another time than the friction.
    fn may_be_far_end(&self, known: &Known) -> bool {
        self.is_decided() && !known.causes.contains(&Cause::Stiffness)
    }

    /// Whether the back-EMF decides whether the motor has changed.
    fn is_decided(&self) -> bool {
        self.evidence.back_emf.is_some()
    }

    /// Whether the back-EMF shows that the motor is no part of the drift.
    pub(super) fn has_sound_motor(&self) -> bool {
        self.is_decided() && !matches!(self.naming, Naming::Neither(..)) && !self.includes(Cause::Kt)
    }

    /// The second part that may have changed too, if a rise of friction alone is named: the coefficients and gauges
    /// would be the same. Dry friction lowers b0 as much as a loss of torque that leaves the back-EMF, and where it
    /// grows along the stroke, it raises a0/b0 as a stiffer spring does. Iron that saturates raises both ratios as a
    /// loss of torque does.
    pub(crate) fn may_hide(&self) -> Option<Cause> {
        let is_of_friction =
            matches!(self.naming, Naming::One(Explanation { cause: Cause::Friction, size, .. }) if size > 0.0);
        let has_stiffer_ratio = self.mean.z - self.mean.x > RISEN_STIFFNESS;
        if is_of_friction && self.of_ratios && self.evidence.may_saturate() && has_stiffer_ratio {
            return Some(Cause::Kt);
        }
        let BackEmf { at_start, .. } = self.evidence.back_emf.filter(|_| is_of_friction && self.has_sound_motor())?;
        if self.mean.x < LOST_TORQUE && !(self.of_ratios && at_start.is_some_and(|start| start.is_prompt)) {
            return Some(Cause::Kt);
        }
        has_stiffer_ratio.then_some(Cause::Stiffness)
    }

    /// The attribution of a drift in one direction only, about which the back-EMF, a mean over both, says nothing.
    pub(super) fn in_one_direction(self) -> Self {
        Self { back_emf: None, ..self }
    }

    /// Change of the back-EMF, if it shows that weak magnets are not the reason of a lost torque: gear, clutch and
    /// brushes lose torque without a change of the back-EMF.
    pub(crate) fn sound_magnets(&self) -> Option<Level> {
        let mut named = self.naming.new_parts().into_iter().flatten();
        let motor = named.find(|part| part.cause == Cause::Kt && part.size < 0.0)?;
        let is_weaker = |level: &Level| level.value < -CHANGED_SD * level.sd && level.value < LOST_TORQUE;
        self.back_emf.filter(|level| level.value.abs() + level.sd < CHANGED * motor.size.abs() && !is_weaker(level))
    }

    /// Whether the back-EMF shows that the motor changed, even if the size of the change is uncertain beside another
    /// part.
    pub(super) fn has_changed_motor(&self) -> bool {
        let level = self.evidence.back_emf.and_then(BackEmf::of_motor);
        self.includes(Cause::Kt) && level.is_some_and(|level| level.value.abs() > CHANGED_SD * level.sd)
    }

    /// Whether the cross-correlation rule contradicts the name of its main part.
    pub(crate) fn is_contradicted(&self) -> bool {
        let inertia = self.main().is_some_and(|main| main.cause == Cause::Inertia);
        self.rule.is_some_and(|rule_verdict| rule_verdict != inertia)
    }

    /// Whether `cause` is part of the attribution.
    pub(super) fn includes(&self, cause: Cause) -> bool {
        let mut parts = self.naming.new_parts().into_iter().flatten().chain(self.naming.known());
        self.cause() == cause || parts.any(|part| part.cause == cause)
    }
}

/// The parts of a pair, the larger one first, relative to the warning limits.
fn larger_first(pair: &Fit<2>, settings: &Settings) -> [Explanation; 2] {
    let [a, b] = pair.parts;
    if a.relevance(settings) < b.relevance(settings) { [b, a] } else { [a, b] }
}

/// Whether `best` is a rise of friction, and `pair` is friction and a stiffer spring. Friction that grows along the
/// stroke, as on a rail that bends, looks like a stiffer spring. Dry slide chairs are more common than two faults at
/// once.
fn may_grow_along_stroke(best: &Fit<1>, pair: &Fit<2>) -> bool {
    best.size_of(Cause::Friction) > 0.0 && pair.includes(Cause::Friction) && pair.size_of(Cause::Stiffness) > 0.0
}

/// Verdict of the cross-correlation rule on inertia; `None` if the scatter of the throws would hide a change of inertia
/// of this size from the rule.
fn rule_verdict(
    correlation: &Correlation,
    window: &Window,
    of_one_throw: &Matrix3<f64>,
    settings: &Settings,
) -> Option<bool> {
    let limit = settings.correlation_limit;
    let size = window.single(Cause::Inertia, settings).size;
    let of_inertia = Correlation::of(of_one_throw, &(direction_of(Cause::Inertia)? * size));
    let says = correlation.indicates_inertia(limit);
    (says || of_inertia.indicates_inertia(limit)).then_some(says)
}
