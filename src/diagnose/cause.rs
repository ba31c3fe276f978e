//! Which part it is: the direction of a drift in the space of the three logarithms.
//!
//! b0 = KT/J, a1 = Kf/J, a0 = Kspr/J (equation 13), so in (ln b0, ln a1, ln a0) the four causes are directions: motor
//! (1,0,0), friction (0,1,0), stiffness (0,0,1), inertia (-1,-1,-1). For a drift m with covariance V, cause j with
//! direction d explains it with size f = d'U^-1 m / d'U^-1 d and leaves the misfit (m - f d)' U^-1 (m - f d). U adds
//! to V the model's own error: a fault may move the other coefficients a little, in proportion to f, and less where
//! the other coefficient's own limit is narrower. Dry friction has a leak of its own: fitted with a viscous model it
//! moves b0 and a0 together, by a fifth of a1 and more when it is heavy (simulated throws with slide-chair friction
//! from 0 to 0.3: a1 +57 %, b0 +11 %, a0 +12 %).
//!
//! A single cause must also leave nothing that would be alarmed by itself: a rest above its own coefficient's limit is
//! a second fault, however small it is beside the first.

use nalgebra::{Matrix3, Vector3};

use super::{
    Settings,
    correlation::Correlation,
    drift::Window,
    event::{Cause, RunnerUp},
};

/// A single cause is out of the question above this misfit: chi-square with two degrees of freedom, upper 1 %.
const SINGLE_MISFIT: f64 = 9.21;
/// A pair of causes is out of the question above this misfit: chi-square with one degree of freedom, upper 1 %.
const PAIR_MISFIT: f64 = 6.63;
/// Two causes whose misfits differ by less are too close to call.
const CLOSE: f64 = 4.0;
/// How much closer, when the cross-correlation rule agrees with the named cause, and how much less when it does not.
const RULE_WEIGHT: f64 = 2.0;
/// Part of a friction change by which b0 and a0 move together.
const FRICTION_COUPLING: f64 = 0.12;
/// By how much a cause that already has an alarm is preferred: a verdict at the edge must not flip to and fro.
const STICKY: f64 = 4.0;

/// A drift as one cause explains it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Explanation {
    pub(super) cause: Cause,
    /// Size in logarithms.
    pub(super) size: f64,
    /// Its standard deviation.
    pub(super) size_sd: f64,
    /// What it leaves unexplained.
    pub(super) misfit: f64,
    /// Whether what it leaves is below the limit of every coefficient.
    pub(super) complete: bool,
}

/// What a drift is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Naming {
    /// One cause explains it, and no other does nearly as well.
    One(Explanation),
    /// Two causes explain it equally well, the better first.
    Either(Explanation, Explanation),
    /// No single cause explains it, these two together do.
    Both(Explanation, Explanation),
    /// Nothing simple explains it.
    Neither,
}

/// A drift with its name and what speaks for and against it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Finding {
    pub(super) naming: Naming,
    pub(super) runner_up: Option<RunnerUp>,
    pub(super) correlation: Option<Correlation>,
    /// Changes of (ln b0, ln a1, ln a0).
    pub(super) mean: Vector3<f64>,
    pub(super) sd: Vector3<f64>,
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

impl Finding {
    /// Names the drift of `window`. `open` are the causes with an active alarm.
    pub(super) fn of(window: &Window, correlation: Option<Correlation>, open: &[Cause], settings: &Settings) -> Self {
        let (m, v) = (&window.mean, &window.covariance);
        let mut ranked = Cause::PHYSICAL.map(|cause| single(cause, m, v, settings));
        let bonus = |e: &Explanation| if open.contains(&e.cause) { STICKY } else { 0.0 };
        ranked.sort_by(|a, b| (a.misfit - bonus(a)).total_cmp(&(b.misfit - bonus(b))));
        let [best, next, ..] = ranked;
        let margin = next.misfit - best.misfit;
        let close = match correlation.map(|c| c.agrees_with(best.cause, settings.correlation_limit)) {
            Some(true) => CLOSE / RULE_WEIGHT,
            Some(false) => CLOSE * RULE_WEIGHT,
            None => CLOSE,
        };
        let naming = if best.complete && best.misfit <= SINGLE_MISFIT + bonus(&best) {
            if next.misfit <= SINGLE_MISFIT && margin + bonus(&best) < close {
                Naming::Either(best, next)
            } else {
                Naming::One(best)
            }
        } else {
            best_pair(m, v, settings).map_or(Naming::Neither, |(a, b)| Naming::Both(a, b))
        };
        Self {
            naming,
            runner_up: matches!(naming, Naming::One(_) | Naming::Either(..))
                .then_some(RunnerUp { cause: next.cause, margin }),
            correlation,
            mean: *m,
            sd: v.diagonal().map(f64::sqrt),
        }
    }

    /// The name under which it is alarmed.
    pub(super) fn cause(&self) -> Cause {
        match self.naming {
            Naming::One(e) => e.cause,
            _ => Cause::Unattributed,
        }
    }

    /// Its size over the warning limit of what it is: it matters above 1.
    pub(super) fn relevance(&self, settings: &Settings) -> f64 {
        let of = |e: &Explanation| relevance(e.cause, e.size, settings);
        match &self.naming {
            Naming::One(e) => of(e),
            Naming::Either(a, b) | Naming::Both(a, b) => of(a).max(of(b)),
            Naming::Neither => [Cause::Kt, Cause::Friction, Cause::Stiffness]
                .into_iter()
                .zip(self.mean.iter())
                .map(|(cause, size)| relevance(cause, *size, settings))
                .fold(0.0, f64::max),
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

/// Size of a change over the warning limit of its cause.
pub(super) fn relevance(cause: Cause, size: f64, settings: &Settings) -> f64 {
    settings.limit_pct(cause).map_or(0.0, |limit| percent(size).abs() / limit)
}

/// How one cause explains the drift `m` with covariance `v`.
pub(super) fn single(cause: Cause, m: &Vector3<f64>, v: &Matrix3<f64>, settings: &Settings) -> Explanation {
    const ROUNDS: usize = 3;
    let d = direction_of(cause).unwrap_or_else(Vector3::zeros);
    let mut size = m.dot(&d) / d.dot(&d);
    let mut explanation = Explanation { cause, size, size_sd: f64::INFINITY, misfit: f64::INFINITY, complete: false };
    for _ in 0..ROUNDS {
        let u = v + leak(&[(cause, size)], settings);
        let Some(inverse) = u.try_inverse() else { return explanation };
        let weights = inverse * d / (d.transpose() * inverse * d).x;
        size = weights.dot(m);
        let rest = m - d * size;
        let misfit = (rest.transpose() * inverse * rest).x;
        let size_sd = (weights.transpose() * v * weights).x.max(0.0).sqrt();
        let complete = leaves_nothing(cause, size, rest, v, settings);
        explanation = Explanation { cause, size, size_sd, misfit, complete };
    }
    explanation
}

/// Whether no coefficient's rest reaches its own warning limit beyond doubt.
fn leaves_nothing(cause: Cause, size: f64, mut rest: Vector3<f64>, v: &Matrix3<f64>, settings: &Settings) -> bool {
    const DOUBT_SD: f64 = 2.0;
    if cause == Cause::Friction {
        // Simulated throws: half of the square of a rise, and at most this much of a fall.
        let reach = if size > 0.0 { 0.5 * size * size } else { FRICTION_COUPLING * size.abs() };
        let together = (0.5 * (rest.x + rest.z)).clamp(-reach, reach);
        rest -= Vector3::new(together, 0.0, together);
    }
    let own = [Cause::Kt, Cause::Friction, Cause::Stiffness];
    (0..3).all(|i| {
        let sure = (rest[i].abs() - DOUBT_SD * v[(i, i)].sqrt()).max(0.0);
        relevance(own[i], sure, settings) < 1.0
    })
}

/// The pair of causes that explains the drift best, if one does: the larger, by its limit, first.
fn best_pair(m: &Vector3<f64>, v: &Matrix3<f64>, settings: &Settings) -> Option<(Explanation, Explanation)> {
    let mut best: Option<(Explanation, Explanation)> = None;
    for (at, &first) in Cause::PHYSICAL.iter().enumerate() {
        for &second in &Cause::PHYSICAL[at + 1..] {
            let Some(pair) = pair(first, second, m, v, settings) else { continue };
            if pair.0.misfit <= PAIR_MISFIT && best.is_none_or(|best| pair.0.misfit < best.0.misfit) {
                best = Some(pair);
            }
        }
    }
    best.map(|(a, b)| {
        let ahead = relevance(a.cause, a.size, settings) >= relevance(b.cause, b.size, settings);
        if ahead { (a, b) } else { (b, a) }
    })
}

fn pair(
    first: Cause,
    second: Cause,
    m: &Vector3<f64>,
    v: &Matrix3<f64>,
    settings: &Settings,
) -> Option<(Explanation, Explanation)> {
    let d = nalgebra::Matrix3x2::from_columns(&[direction_of(first)?, direction_of(second)?]);
    let mut sizes = (d.transpose() * d).try_inverse()? * d.transpose() * m;
    let u = v + leak(&[(first, sizes.x), (second, sizes.y)], settings);
    let inverse = u.try_inverse()?;
    let gain = (d.transpose() * inverse * d).try_inverse()? * d.transpose() * inverse;
    sizes = gain * m;
    let rest = m - d * sizes;
    let misfit = (rest.transpose() * inverse * rest).x;
    let sd = (gain * v * gain.transpose()).diagonal().map(|variance| variance.max(0.0).sqrt());
    Some((
        Explanation { cause: first, size: sizes.x, size_sd: sd.x, misfit, complete: true },
        Explanation { cause: second, size: sizes.y, size_sd: sd.y, misfit, complete: true },
    ))
}

/// The model's own error: each cause of a size may move every coefficient by `model_error` of it, less where the
/// coefficient's own limit is narrower than the cause's.
fn leak(causes: &[(Cause, f64)], settings: &Settings) -> Matrix3<f64> {
    let own = [settings.kt_limit_pct, settings.friction_limit_pct, settings.stiffness_limit_pct];
    let mut variance = Vector3::zeros();
    let mut coupled = 0.0;
    for (cause, size) in causes {
        // Friction has its coupling; beside it there is hardly any leak.
        let part = if *cause == Cause::Friction { 0.5 } else { 1.0 } * settings.model_error;
        if *cause == Cause::Friction {
            coupled += (FRICTION_COUPLING * size).powi(2);
        }
        let limit = settings.limit_pct(*cause).unwrap_or(f64::INFINITY);
        for i in 0..3 {
            variance[i] += (part * size * (own[i] / limit).min(1.0)).powi(2);
        }
    }
    let together = Vector3::new(1.0, 0.0, 1.0);
    Matrix3::from_diagonal(&variance) + together * together.transpose() * coupled
}
