//! Which part it is: the direction of a drift in the space of the three logarithms.
//!
//! b0 = KT/J, a1 = Kf/J, a0 = Kspr/J (equation 13), so in (ln b0, ln a1, ln a0) the four causes are directions: motor
//! (1,0,0), friction (0,1,0), stiffness (0,0,1), inertia (-1,-1,-1). For a drift m with covariance V, causes with the
//! directions D explain it with sizes f = (D'U^-1 D)^-1 D'U^-1 m and leave the misfit (m - D f)' U^-1 (m - D f). U adds
//! to V the model's own error, in proportion to f.
//!
//! # The model's own error
//! Simulated throws through the estimator: a change of the motor, stiffness or inertia moves each other coefficient by
//! less than a tenth of itself. Dry friction leaks: fitted with a viscous model, a rise moves along (g, 1, g) with g
//! from 0 (viscous) over 0.22 (stiff toe drive) to 0.4 (soft toe drive); a fall hardly leaks.
//!
//! # Which explanation
//! One cause, two, or any three movements: each is scored by -2 ln of its probability under a wide prior on the sizes
//! (Laplace), misfit + ln det U + ln det(D'U^-1 D) + k ln s^2, so that more causes have to earn what they explain; and
//! coinciding faults are rarer than single ones. A cause is named when its score leads over every other name by a
//! margin, else two are too close to call.

use nalgebra::{Matrix3, Vector3};

use super::{
    Settings,
    correlation::Correlation,
    drift::Window,
    event::{Cause, RunnerUp},
};

/// A lead that decides between two explanations: odds of 20 to 1, as twice the logarithm.
const CLOSE: f64 = 6.0;
/// A lead that leaves no doubt: odds of 1000 to 1. A critical name needs it.
pub(super) const DECISIVE: f64 = 13.8;
/// How much closer, when the cross-correlation rule agrees with the named cause, and how much less when it does not.
const RULE_WEIGHT: f64 = 1.5;
/// By how much an explanation that already has an alarm is preferred: a verdict at the edge must not flip to and fro.
const STICKY: f64 = 4.0;
/// Prior scale s of a size, in logarithms: faults that matter are from a few percent to a doubling.
const SIZE_SCALE: f64 = 0.5;
/// A second movement smaller than this part of its warning limit is no second fault. Below 1, as its size is in doubt.
const MATTERS: f64 = 0.75;
/// What each cause beside the first costs: one in a dozen faults comes with a second one.
const SECOND_CAUSE: f64 = 5.0;
/// Part g of a rise of friction by which b0 and a0 move too.
const FRICTION_LEAK: std::ops::RangeInclusive<f64> = 0.0..=0.45;
/// Its standard deviation, where g is read from the drift itself and where it cannot be: even over its range.
const FRICTION_LEAK_SD: (f64, f64) = (0.05, 0.13);
/// Standard deviations that the setting `model_error` stands for: "up to".
const MODEL_ERROR_SD: f64 = 3.0;
/// Beside its leak friction hardly moves the others: this part of what the other causes do.
const FRICTION_ERROR: f64 = 0.3;

/// A drift, or a part of it, as one cause explains it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Explanation {
    pub(super) cause: Cause,
    /// Size in logarithms.
    pub(super) size: f64,
    /// Its standard deviation.
    pub(super) size_sd: f64,
}

/// What a drift is.
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

/// A drift with its name and what speaks for and against it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Finding {
    pub(super) naming: Naming,
    /// Beside a naming with two causes.
    pub(super) rival: Option<Rival>,
    pub(super) runner_up: Option<RunnerUp>,
    pub(super) correlation: Option<Correlation>,
    /// Changes of (ln b0, ln a1, ln a0).
    pub(super) mean: Vector3<f64>,
    /// Its size over the warning limit of what it may be: it matters above 1.
    pub(super) relevance: f64,
    /// Lead of a single name over everything of which it is no part.
    pub(super) lead: f64,
}

/// How well some causes together explain a drift.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Fit<const K: usize> {
    parts: [Explanation; K],
    score: f64,
}

/// The direction of a cause.
pub(super) fn direction_of(cause: Cause) -> Option<Vector3<f64>> {
    match cause {
        Cause::Kt => Some(Vector3::new(1.0, 0.0, 0.0)),
        Cause::Friction => Some(Vector3::new(0.0, 1.0, 0.0)),
        Cause::Stiffness => Some(Vector3::new(0.0, 0.0, 1.0)),
        Cause::Inertia => Some(Vector3::new(-1.0, -1.0, -1.0)),
        _ => None,
    }
}

/// Size of a change in percent.
pub(super) fn percent(log: f64) -> f64 {
    100.0 * log.exp_m1()
}

/// Size of a change over the warning limit of its cause.
pub(super) fn relevance(cause: Cause, size: f64, settings: &Settings) -> f64 {
    settings.limit_pct(cause).map_or(0.0, |limit| percent(size).abs() / limit)
}

/// How one cause explains the drift `m` with covariance `v`.
pub(super) fn single(cause: Cause, m: &Vector3<f64>, v: &Matrix3<f64>, settings: &Settings) -> Explanation {
    fit([cause], m, v, settings).parts[0]
}

impl Finding {
    /// Names the drift of `window`. `open` are the causes with an active alarm.
    pub(super) fn of(window: &Window, correlation: Option<Correlation>, open: &[Cause], settings: &Settings) -> Self {
        let (m, v) = (&window.mean, &window.covariance);
        let singles = ranked(Cause::PHYSICAL.map(|cause| [cause]), window, |[cause]| open.contains(&cause), settings);
        let pairs = ranked(all_pairs(), window, |_| open.contains(&Cause::Unattributed), settings);
        let [best, next, ..] = singles;
        let anything = fit([Cause::Kt, Cause::Friction, Cause::Stiffness], m, v, settings);
        let found = Self {
            naming: Naming::Neither,
            rival: None,
            runner_up: None,
            correlation,
            mean: *m,
            relevance: anything.relevance(settings),
            lead: 0.0,
        };
        if anything.score + CLOSE < best.score.min(pairs[0].score) {
            return found;
        }
        let margin = next.score - best.score;
        let cause = best.parts[0].cause;
        let found = Self { runner_up: Some(RunnerUp { cause: next.parts[0].cause, margin }), ..found };
        // Explanations with two causes that are as good as the best of them.
        let plausible = pairs.iter().filter(|pair| pair.score < pairs[0].score + CLOSE);
        let matters = |pair: &&Fit<2>| pair.parts.iter().all(|part| part.relevance(settings) >= MATTERS);
        let mattering = plausible.clone().find(matters);
        let includes = |pair: &Fit<2>| pair.parts.iter().any(|part| part.cause == cause);
        let rival_pair = mattering.or_else(|| pairs.first().filter(|pair| !includes(pair)));
        let ahead = rival_pair.map_or(f64::INFINITY, |pair| pair.score - best.score);
        if ahead < CLOSE
            && let Some(pair) = rival_pair
        {
            let relevance = plausible.map(|pair| pair.relevance(settings)).fold(0.0, f64::max);
            let other = pairs.iter().find(|other| *other != pair && other.score < pair.score + CLOSE);
            let rival = if ahead > -CLOSE {
                Some(Rival::Alone(cause))
            } else {
                other.map(|other| Rival::Together(other.parts[0].cause, other.parts[1].cause))
            };
            let [mut a, mut b] = pair.parts;
            if a.relevance(settings) < b.relevance(settings) {
                (a, b) = (b, a);
            }
            return Self { naming: Naming::Both(a, b), rival, runner_up: None, relevance, ..found };
        }
        // With a second movement taken out, the size of the first is free of it.
        let beside = Some(&pairs[0]).filter(|pair| includes(pair) && pair.score < best.score);
        let e =
            beside.and_then(|pair| pair.parts.into_iter().find(|part| part.cause == cause)).unwrap_or(best.parts[0]);
        let second = next.parts[0];
        if margin < close(cause, second.cause, correlation, settings) {
            let relevance = e.relevance(settings).max(second.relevance(settings));
            return Self { naming: Naming::Either(e, second), relevance, ..found };
        }
        let strangers = pairs.iter().filter(|pair| !includes(pair)).map(|pair| pair.score - best.score);
        let lead = strangers.fold(margin, f64::min);
        Self { naming: Naming::One(e), relevance: e.relevance(settings), lead, ..found }
    }

    /// The name under which it is alarmed.
    pub(super) fn cause(&self) -> Cause {
        match self.naming {
            Naming::One(e) => e.cause,
            _ => Cause::Unattributed,
        }
    }

    /// Whether `cause` is part of what it is.
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

impl Explanation {
    fn relevance(&self, settings: &Settings) -> f64 {
        relevance(self.cause, self.size, settings)
    }
}

impl<const K: usize> Fit<K> {
    /// The largest part over its limit.
    fn relevance(&self, settings: &Settings) -> f64 {
        self.parts.iter().map(|part| part.relevance(settings)).fold(0.0, f64::max)
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

/// The lead that one name needs over another. The cross-correlation rule tells inertia from the rest, and nothing else: a
/// name that it takes for inertia has to be beyond doubt.
fn close(best: Cause, next: Cause, correlation: Option<Correlation>, settings: &Settings) -> f64 {
    let agrees = correlation.map(|c| c.agrees_with(best, settings.correlation_limit));
    match agrees {
        Some(true) if best == Cause::Inertia || next == Cause::Inertia => CLOSE / RULE_WEIGHT,
        Some(false) if best == Cause::Inertia => CLOSE * RULE_WEIGHT,
        Some(false) if next == Cause::Inertia => DECISIVE,
        _ => CLOSE,
    }
}

fn all_pairs() -> [[Cause; 2]; 6] {
    let [a, b, c, d] = Cause::PHYSICAL;
    [[a, b], [a, c], [a, d], [b, c], [b, d], [c, d]]
}

/// How `causes` together explain the drift `m` with covariance `v`; at most three causes.
fn fit<const K: usize>(causes: [Cause; K], m: &Vector3<f64>, v: &Matrix3<f64>, settings: &Settings) -> Fit<K> {
    const ROUNDS: usize = 3;
    let parts = causes.map(|cause| Explanation { cause, size: 0.0, size_sd: f64::INFINITY });
    let mut fit = Fit { parts, score: f64::INFINITY };
    let (leak, leak_sd) = friction_leak(m, K == 1);
    for _ in 0..ROUNDS {
        let mut u = *v;
        let mut d = Matrix3::zeros();
        // Places without a cause have no effect and the size zero.
        let mut information = Matrix3::identity();
        for (at, part) in fit.parts.iter().enumerate() {
            u += model_error(part, leak_sd, settings);
            d.set_column(at, &effect(part, leak));
            information[(at, at)] = 0.0;
        }
        let Some(inverse) = u.try_inverse() else { return fit };
        information += d.transpose() * inverse * d;
        let Some(spread) = information.try_inverse() else { return fit };
        let gain = spread * d.transpose() * inverse;
        let sizes = gain * m;
        let rest = m - d * sizes;
        let misfit = (rest.transpose() * inverse * rest).x;
        let sd = (gain * v * gain.transpose()).diagonal().map(|variance| variance.max(0.0).sqrt());
        for (at, part) in fit.parts.iter_mut().enumerate() {
            (part.size, part.size_sd) = (sizes[at], sd[at]);
        }
        let prior = 2.0 * K as f64 * SIZE_SCALE.ln() + SECOND_CAUSE * (K as f64 - 1.0);
        fit.score = misfit + u.determinant().ln() + information.determinant().ln() + prior;
    }
    fit
}

/// What a cause of this size does to the coefficients, for each unit of its size, when friction leaks by `leak`.
fn effect(part: &Explanation, leak: f64) -> Vector3<f64> {
    if part.cause == Cause::Friction && part.size > 0.0 {
        return Vector3::new(leak, 1.0, leak);
    }
    direction_of(part.cause).unwrap_or_else(Vector3::zeros)
}

/// Covariance of what a cause of this size may do beside its effect, when the leak of friction is known to `leak_sd`.
fn model_error(part: &Explanation, leak_sd: f64, settings: &Settings) -> Matrix3<f64> {
    let sd = settings.model_error / MODEL_ERROR_SD * part.size;
    if part.cause == Cause::Friction {
        let together = Vector3::new(1.0, 0.0, 1.0) * leak_sd * part.size.max(0.0);
        let rest = Vector3::new(1.0, 0.0, 1.0) * (FRICTION_ERROR * sd).powi(2);
        return together * together.transpose() + Matrix3::from_diagonal(&rest);
    }
    let own = |i: usize| [Cause::Kt, Cause::Friction, Cause::Stiffness][i] == part.cause;
    Matrix3::from_diagonal(&Vector3::from_fn(|i, _| if own(i) { 0.0 } else { sd * sd }))
}

/// The leak of friction and its standard deviation: beside another cause it cannot be told from it.
fn friction_leak(m: &Vector3<f64>, alone: bool) -> (f64, f64) {
    let (least, most) = (*FRICTION_LEAK.start(), *FRICTION_LEAK.end());
    if alone && m.y > 0.0 {
        ((0.5 * (m.x + m.z) / m.y).clamp(least, most), FRICTION_LEAK_SD.0)
    } else {
        (f64::midpoint(least, most), FRICTION_LEAK_SD.1)
    }
}
