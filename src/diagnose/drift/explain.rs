//! Explanations of a drift by causes, as directions in the space of the three logarithms.
//!
//! b0 = KT/J, a1 = Kf/J, a0 = Kspr/J (equation 13 of the study), so in (ln b0, ln a1, ln a0) the causes have the
//! directions motor (1,0,0), friction (0,1,0), stiffness (0,0,1), inertia (-1,-1,-1). A drift m with covariance V is
//! explained by causes, whose directions are the columns of D, with the sizes f = (D'U^-1 D)^-1 D'U^-1 m and the misfit
//! (m - D f)' U^-1 (m - D f). U is V plus the error of the model, which grows in proportion to f.
//!
//! # Error of the model
//! All figures are from estimates of simulated throws. A change of motor, stiffness or inertia changes each other
//! coefficient by less than a tenth of its size.
//!
//! Dry friction leaks into other coefficients, because the model has viscous friction only. A rise of it increases all
//! three coefficients by a common factor too. So its direction is (g, 1 + g, g), with g = 0 for viscous friction, 0.1
//! to 0.3 with a stiff toe drive (more for larger rises), and 0.67 with a soft toe drive. A fall hardly leaks. The g of
//! a machine is unknown, so the results for several g are averaged. On machines with little inertia, dry friction takes
//! its part of the torque when the machine starts, as if b0 were smaller: (-h, 1 - h, 0) with h from 0.1 to 0.4, and
//! from 0.5 to 1 behind a soft drive that friction winds up.
//!
//! Friction at the far end of a rail that bends grows with the travel until that end slides, as if a spring became
//! stiffer. The force of this spring at the end of the stroke is a part p of the rise of the friction, with p from 0.05
//! to 0.45 on rails of a beam and of three masses. The change of a0 is relative to the spring that the machine has, so
//! the direction is (0, 1, p q), where q = a1 / (a0 T) is the friction over the force of the spring at the end of a
//! stroke of duration T.
//!
//! More friction draws more current. In a series-wound motor this current saturates the iron, so the torque grows less
//! than with its square, as the model has it. The start, which has the largest current, gives b0, so a1 and a0 of the
//! running machine seem larger by a common factor: (0, 1 + s, s). For a torque that grows with the power n of the
//! current, s is (2 - n)/n times the part of the load that is friction: from 0 without saturation to 0.7. The ratio
//! a1/a0 has no such error. A weaker motor draws more current for the whole load: (1, -s, -s) with s = (2 - n)/n, or
//! (1 + s, 0, 0) if b0 comes from the running machine rather than from its start.
//!
//! A motor with weaker magnets turns faster. Dry friction has the same torque at every speed, so in a model with
//! viscous friction the dry part of the friction falls with the motor: (1, c, 0), with c from 0 (viscous load) to 1
//! (dry load).
//!
//! # Score
//! The score of an explanation by k causes is -2 ln of the probability of m, with a wide prior of scale s on the sizes
//! (Laplace's approximation): misfit + ln det U + ln det(D'U^-1 D) + k ln s^2. It penalises additional causes. Two
//! faults at once have an extra penalty, as they are rarer than one.

use nalgebra::{Matrix3, Vector3};

use super::Window;
use crate::diagnose::{
    Cause, Settings,
    statistics::{Level, sym3},
};

/// Prior scale s of a size, in logarithms: relevant faults are from a few per cent to a doubling.
const SIZE_SCALE: f64 = 0.5;
/// Penalty on the score for each additional cause: one in a dozen faults comes with a second one.
const SECOND_CAUSE: f64 = 5.0;
/// Leaks of a rise of friction, all equally likely: viscous friction, then dry friction with a stiff toe drive, with a
/// soft toe drive, on a rail whose far end sticks, on a machine with little inertia, and on a machine whose drive is
/// wound up before the toe moves.
const OF_FRICTION_WOUND_UP: &[Leak] = &[
    Leak { parts: [0.0, 0.0, 0.0], sd: [0.08, 0.08, 0.08], of_spring: false },
    Leak { parts: [0.25, 0.25, 0.25], sd: [0.12, 0.12, 0.12], of_spring: false },
    Leak { parts: [0.67, 0.67, 0.67], sd: [0.22, 0.22, 0.22], of_spring: false },
    Leak { parts: [0.0, 0.0, 0.25], sd: [0.0, 0.0, 0.12], of_spring: true },
    Leak { parts: [-0.28, -0.28, 0.0], sd: [0.12, 0.12, 0.0], of_spring: false },
    Leak { parts: [-0.75, -0.75, 0.0], sd: [0.2, 0.2, 0.0], of_spring: false },
];
/// [`OF_FRICTION_WOUND_UP`] on a machine whose drive is not wound up.
const OF_FRICTION: &[Leak] = OF_FRICTION_WOUND_UP.split_at(5).0;
/// [`OF_FRICTION`] on a machine with a series-wound motor, whose back-EMF is unknown: the plain leaks, and saturation.
const OF_FRICTION_OF_SERIES: &[Leak] = &[
    OF_FRICTION[0],
    OF_FRICTION[1],
    OF_FRICTION[2],
    Leak { parts: [0.0, 0.3, 0.3], sd: [0.0, 0.18, 0.18], of_spring: false },
];
const NO_LEAK: Leak = Leak { parts: [0.0; 3], sd: [0.0; 3], of_spring: false };
/// Leaks of a change of the motor: with a viscous load, and with loads of which a part is dry, in steps so small that
/// the back-EMF can choose between them.
const OF_MOTOR: &[Leak] =
    &[NO_LEAK, Leak::of_dry_load(0.25), Leak::of_dry_load(0.5), Leak::of_dry_load(0.75), Leak::of_dry_load(1.0)];
/// The leaks that do not resemble another fault.
pub(crate) const PLAIN_LEAKS: Leaks =
    Leaks { friction: OF_FRICTION.split_at(3).0, motor: OF_MOTOR.split_at(1).0, friction_over_spring: 1.0 };
/// Leaks of a change of a series-wound motor: without saturation, and with, where b0 comes from the start or from the
/// running machine.
const OF_SERIES_MOTOR: &[Leak] = &[
    NO_LEAK,
    Leak { parts: [0.0, -0.3, -0.3], sd: [0.0, 0.18, 0.18], of_spring: false },
    Leak { parts: [0.3, 0.0, 0.0], sd: [0.18, 0.0, 0.0], of_spring: false },
];
/// The leaks on a machine with a series-wound motor.
pub(super) const LEAKS_OF_SERIES: Leaks =
    Leaks { friction: OF_FRICTION_OF_SERIES, motor: OF_SERIES_MOTOR, ..PLAIN_LEAKS };
/// The setting `model_error` is an upper bound; it counts as this number of standard deviations.
const MODEL_ERROR_SD: f64 = 3.0;
/// Model error of friction beside its leak, as part of the model error of other causes.
const FRICTION_ERROR: f64 = 0.3;

/// The explanation of a drift, or of a part of it, by one cause.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Explanation {
    pub(crate) cause: Cause,
    /// Size, as the change of a logarithm.
    pub(crate) size: f64,
    /// Standard deviation of the size because of the scatter of the throws.
    pub(crate) size_sd: f64,
    /// Weights of the three logarithms in the size.
    pub(crate) weights: Vector3<f64>,
    /// Standard deviation of the size because of the unknown leaks and the error of the model; more throws do not
    /// change it.
    pub(super) model_sd: f64,
}

/// The explanation of a drift by K causes together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fit<const K: usize> {
    pub(crate) parts: [Explanation; K],
    /// Minus twice the logarithm of the probability: the smallest is the best.
    pub(crate) score: f64,
}

/// Change of the coefficients beside the main effect of a cause, as parts of its size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Leak {
    parts: [f64; 3],
    /// Standard deviations of `parts`, which vary together; chosen so that the leaks of a list cover their range
    /// evenly.
    sd: [f64; 3],
    /// Whether the leak is proportional to the ratio of the friction to the force of the spring; `parts` and `sd` are
    /// those at a ratio of 1.
    of_spring: bool,
}

impl Leak {
    /// The leak of a motor of whose load this part is dry.
    const fn of_dry_load(part: f64) -> Self {
        Self { parts: [0.0, part, 0.0], sd: [0.0, 0.12, 0.0], of_spring: false }
    }

    /// The leak on a machine with this ratio of the friction to the force of the spring.
    fn beside_spring(self, friction_over_spring: f64) -> Self {
        let factor = if self.of_spring { friction_over_spring } else { 1.0 };
        Self { parts: self.parts.map(|part| factor * part), sd: self.sd.map(|sd| factor * sd), ..self }
    }
}

/// The possible leaks of a rise of friction, and of a change of the motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Leaks {
    friction: &'static [Leak],
    motor: &'static [Leak],
    /// Friction over the force of the spring at the end of the stroke.
    friction_over_spring: f64,
}

impl Leaks {
    /// All leaks on a machine with this ratio of the friction to the force of the spring; `is_wound_up`: its drive is,
    /// before the toe moves. Some look like a fault of the motor or of the stiffness, so they are used only if the
    /// gauges show whether the motor changed.
    pub(super) fn beside_gauges(friction_over_spring: f64, is_wound_up: bool) -> Self {
        let friction = if is_wound_up { OF_FRICTION_WOUND_UP } else { OF_FRICTION };
        Self { friction, motor: OF_MOTOR, friction_over_spring }
    }

    /// The leaks on a machine whose motor has kept its speed.
    pub(super) fn at_equal_speed(self) -> Self {
        Self { motor: &self.motor[..1], ..self }
    }
}

/// The change of (ln b0, ln a1, ln a0) by a physical cause of size 1; `None` for other causes.
pub(super) fn direction_of(cause: Cause) -> Option<Vector3<f64>> {
    match cause {
        Cause::Kt => Some(Vector3::new(1.0, 0.0, 0.0)),
        Cause::Friction => Some(Vector3::new(0.0, 1.0, 0.0)),
        Cause::Stiffness => Some(Vector3::new(0.0, 0.0, 1.0)),
        Cause::Inertia => Some(Vector3::new(-1.0, -1.0, -1.0)),
        _ => None,
    }
}

/// Explains the drift `m` with covariance `v` by one cause.
pub(crate) fn single(cause: Cause, m: &Vector3<f64>, v: &Matrix3<f64>, settings: &Settings) -> Explanation {
    fit(PLAIN_LEAKS, [cause], m, v, settings).parts[0]
}

impl Window {
    /// Explains the mean by `causes`, without the leaks that resemble another fault.
    pub(super) fn fit<const K: usize>(&self, causes: [Cause; K], settings: &Settings) -> Fit<K> {
        fit(PLAIN_LEAKS, causes, &self.mean, &self.covariance, settings)
    }

    /// Explains the mean by one cause.
    pub(super) fn single(&self, cause: Cause, settings: &Settings) -> Explanation {
        single(cause, &self.mean, &self.covariance, settings)
    }
}

/// Explains the drift of `window` by friction, on a machine whose motor has not changed: Kf/KT = a1/b0. Dry
/// friction takes its part of the torque also when the machine starts, as if b0 were smaller. The ratio a1/b0 has no
/// such error.
pub(super) fn friction_of_sound_motor(window: &Window) -> Explanation {
    let weights = Vector3::new(-1.0, 1.0, 0.0);
    let variance = (weights.transpose() * window.covariance * weights).x;
    Explanation {
        cause: Cause::Friction,
        size: weights.dot(&window.mean),
        size_sd: variance.max(0.0).sqrt(),
        weights,
        model_sd: 0.0,
    }
}

impl Explanation {
    /// The size with its standard deviation.
    pub(crate) fn level(&self) -> Level {
        Level { value: self.size, sd: self.size_sd }
    }

    /// Size relative to the warning limit of the cause.
    pub(crate) fn relevance(&self, settings: &Settings) -> f64 {
        settings.relevance(self.cause, self.size)
    }
}

impl<const K: usize> Fit<K> {
    /// Whether `cause` is one of the causes.
    pub(super) fn includes(&self, cause: Cause) -> bool {
        self.part(cause).is_some()
    }

    /// The part of `cause`.
    pub(super) fn part(&self, cause: Cause) -> Option<Explanation> {
        self.parts.into_iter().find(|part| part.cause == cause)
    }

    /// Size of `cause`; 0 if it is no part.
    pub(crate) fn size_of(&self, cause: Cause) -> f64 {
        self.part(cause).map_or(0.0, |part| part.size)
    }

    /// The largest size relative to its limit.
    pub(crate) fn relevance(&self, settings: &Settings) -> f64 {
        self.parts.iter().map(|part| part.relevance(settings)).fold(0.0, f64::max)
    }
}

/// Explains the drift `m` with covariance `v` by `causes`, at most three. The result is the mean over their possible
/// leaks, weighted by the odds.
pub(crate) fn fit<const K: usize>(
    leaks: Leaks,
    causes: [Cause; K],
    m: &Vector3<f64>,
    v: &Matrix3<f64>,
    settings: &Settings,
) -> Fit<K> {
    fit_beside(leaks, causes, m, v, |_| 0.0, settings)
}

/// [`fit`] with further evidence: `misfit` gives the misfit of this evidence to a fit with given leaks, and counts in
/// the odds of these leaks.
pub(super) fn fit_beside<const K: usize>(
    leaks: Leaks,
    causes: [Cause; K],
    m: &Vector3<f64>,
    v: &Matrix3<f64>,
    misfit: impl Fn(&Fit<K>) -> f64,
    settings: &Settings,
) -> Fit<K> {
    let of = |cause: Cause, leaks: &'static [Leak]| if causes.contains(&cause) { leaks } else { &leaks[..1] };
    let (of_friction, of_motor) = (of(Cause::Friction, leaks.friction), of(Cause::Kt, leaks.motor));
    let of_friction = of_friction.iter().map(|leak| leak.beside_spring(leaks.friction_over_spring));
    let both = of_friction.flat_map(|friction| of_motor.iter().map(move |motor| [friction, *motor]));
    let with = |leaks| {
        let fit = fit_with_leaks(leaks, causes, m, v, settings);
        Fit { score: fit.score + misfit(&fit), ..fit }
    };
    let fits: Vec<Fit<K>> = both.map(with).collect();
    if let [only] = fits[..] {
        return only;
    }
    let best = fits.iter().map(|fit| fit.score).fold(f64::INFINITY, f64::min);
    let odds: Vec<f64> = fits.iter().map(|fit| (0.5 * (best - fit.score)).exp()).collect();
    let total: f64 = odds.iter().sum();
    let mut mean = Fit { score: best - 2.0 * (total / fits.len() as f64).ln(), ..fits[0] };
    for (at, part) in mean.parts.iter_mut().enumerate() {
        let average = |of: &dyn Fn(&Explanation) -> f64| -> f64 {
            fits.iter().zip(&odds).map(|(fit, odds)| odds / total * of(&fit.parts[at])).sum()
        };
        let size = average(&|part| part.size);
        let between = average(&|part| (part.size - size).powi(2));
        let variance = average(&|part| part.size_sd.powi(2)) + between;
        let of_model = average(&|part| part.model_sd.powi(2)) + between;
        (part.size, part.size_sd, part.model_sd) = (size, variance.sqrt(), of_model.sqrt());
        part.weights = Vector3::from_fn(|i, _| average(&|part| part.weights[i]));
    }
    mean
}

/// [`fit`] with given leaks of friction and motor.
fn fit_with_leaks<const K: usize>(
    [of_friction, of_motor]: [Leak; 2],
    causes: [Cause; K],
    m: &Vector3<f64>,
    v: &Matrix3<f64>,
    settings: &Settings,
) -> Fit<K> {
    const ROUNDS: usize = 3;
    let parts = causes.map(|cause| Explanation {
        cause,
        size: 0.0,
        size_sd: f64::INFINITY,
        weights: Vector3::zeros(),
        model_sd: 0.0,
    });
    let mut fit = Fit { parts, score: f64::INFINITY };
    for _ in 0..ROUNDS {
        let mut u = *v;
        let mut d = Matrix3::zeros();
        // The rows without a cause have no effect, and get the size 0.
        let mut information = Matrix3::identity();
        for (at, part) in fit.parts.iter().enumerate() {
            let leak = match part.cause {
                Cause::Friction => of_friction,
                Cause::Kt => of_motor,
                _ => NO_LEAK,
            };
            u += model_error(part, leak, settings);
            d.set_column(at, &effect(part, leak));
            information[(at, at)] = 0.0;
        }
        let Some(inverse) = sym3::inverse(&u) else { return fit };
        information += d.transpose() * inverse * d;
        let Some(spread) = sym3::inverse(&information) else { return fit };
        let gain = spread * d.transpose() * inverse;
        let sizes = gain * m;
        let rest = m - d * sizes;
        let misfit = (rest.transpose() * inverse * rest).x;
        let sd = |of: Matrix3<f64>| (gain * of * gain.transpose()).diagonal().map(|variance| variance.max(0.0).sqrt());
        let (of_noise, of_model) = (sd(*v), sd(u - v));
        for (at, part) in fit.parts.iter_mut().enumerate() {
            (part.size, part.size_sd, part.model_sd) = (sizes[at], of_noise[at], of_model[at]);
            part.weights = gain.row(at).transpose();
        }
        let prior = 2.0 * K as f64 * SIZE_SCALE.ln() + SECOND_CAUSE * (K as f64 - 1.0);
        fit.score = misfit + u.determinant().ln() + information.determinant().ln() + prior;
    }
    fit
}

/// Fit of an effect `d` to the drift `m` with covariance `v`: size, and a score that can be compared with that of
/// causes.
pub(crate) fn fit_along(
    d: &Vector3<f64>,
    m: &Vector3<f64>,
    v: &Matrix3<f64>,
    settings: &Settings,
) -> Option<(Level, f64)> {
    let (mut size, mut found) = (0.0, None);
    for _ in 0..2 {
        let error = Matrix3::from_diagonal_element((settings.model_error / MODEL_ERROR_SD * size).powi(2));
        let u = v + error;
        let inverse = sym3::inverse(&u)?;
        let information = (d.transpose() * inverse * d).x;
        size = (d.transpose() * inverse * m).x / information;
        let rest = m - d * size;
        let misfit = (rest.transpose() * inverse * rest).x;
        let score = misfit + u.determinant().ln() + information.ln() + 2.0 * SIZE_SCALE.ln();
        found = Some((Level { value: size, sd: information.sqrt().recip() }, score));
    }
    found
}

/// Effect of a cause with this leak on the logarithms of the coefficients, per unit of its size. A fall of friction
/// hardly leaks. A size of 0, the first guess, counts as a rise.
fn effect(part: &Explanation, leak: Leak) -> Vector3<f64> {
    let own = direction_of(part.cause).unwrap_or_else(Vector3::zeros);
    if part.cause == Cause::Friction && part.size < 0.0 { own } else { own + Vector3::from(leak.parts) }
}

/// Covariance of the model error of a cause of this size with this leak.
fn model_error(part: &Explanation, leak: Leak, settings: &Settings) -> Matrix3<f64> {
    let sd = settings.model_error / MODEL_ERROR_SD * part.size;
    let (leaking, sd) =
        if part.cause == Cause::Friction { (part.size.max(0.0), FRICTION_ERROR * sd) } else { (part.size, sd) };
    let together = Vector3::from(leak.sd) * leaking;
    let own = |i: usize| Cause::OF_COEFFICIENTS[i] == part.cause;
    let others = Vector3::from_fn(|i, _| if own(i) { 0.0 } else { sd * sd });
    together * together.transpose() + Matrix3::from_diagonal(&others)
}
