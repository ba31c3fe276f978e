//! The explanations of a drift by one, two or three causes, ranked by their scores with the evidence about the motor.

use std::ops::Range;

use super::{Explanation, Fit, MotorEvidence, Window, fit, fit_beside};
use crate::diagnose::{
    Cause, Settings,
    gauges::{AtStart, BackEmf},
};

/// Bonus on the score of an explanation whose causes all have an alarm, for each cause, and of every pair while there
/// is an unattributed alarm, so that the name does not alternate from throw to throw.
const ALARM_BONUS: f64 = 4.0;
/// Upper bound of the misfit of the back-EMF, so that a change of the supply does not decide alone.
const MOST_BACK_EMF_MISFIT: f64 = 40.0;
/// Range of the part of a change of the motor that shows in the acceleration per ampere at the start.
const MOTOR_AT_START: Range<f64> = 0.4..1.1;
/// Range of this part on a machine with a late brake. The acceleration is measured when the brake has been released;
/// a faster motor then starts with less current.
const MOTOR_AFTER_BRAKE: Range<f64> = -0.7..1.1;
/// Largest part of a rise of friction that lowers the acceleration at the start: dry friction behind the play of a soft
/// drive.
const FRICTION_AT_START: f64 = 0.4;
/// Upper bound of the misfit of the acceleration at the start, so that a brake or play that changes at the same time
/// does not decide alone.
const MOST_START_MISFIT: f64 = 20.0;
/// Penalty of the explanation that a motor lost torque and kept its back-EMF: odds of 1 to 5 against weak magnets.
const TORQUE_ALONE: f64 = 3.0;
/// Standard deviation of a loss of torque, as a logarithm: commutation loses a part of the torque, not most of it.
const TORQUE_ALONE_SD: f64 = 0.3;

/// The explanations of a drift, of each kind the best first.
pub(super) struct Explanations {
    pub(super) singles: [Fit<1>; 4],
    pub(super) pairs: [Fit<2>; 6],
    /// By motor, friction and stiffness together, which explain any drift.
    pub(super) any: Fit<3>,
}

impl Explanations {
    pub(super) fn of(window: &Window, open: &[Cause], evidence: MotorEvidence, settings: &Settings) -> Self {
        Self {
            singles: ranked(Cause::PHYSICAL.map(|cause| [cause]), window, open, evidence, settings),
            pairs: ranked(Cause::PAIRS, window, open, evidence, settings),
            any: explained(Cause::OF_COEFFICIENTS, window, evidence, settings),
        }
    }

    /// The best single cause. If the best pair includes it and has a better score, its size is that in the pair.
    pub(super) fn freed_best(&self) -> Explanation {
        let alone = self.singles[0].parts[0];
        let [pair, ..] = &self.pairs;
        pair.part(alone.cause).filter(|_| pair.score < self.singles[0].score).unwrap_or(alone)
    }

    /// Score and causes of the best explanation by one or two causes without `cause`.
    pub(super) fn best_without(&self, cause: Cause) -> (f64, &[Explanation]) {
        let singles = self.singles.iter().filter(|fit| !fit.includes(cause)).map(|fit| (fit.score, &fit.parts[..]));
        let pairs = self.pairs.iter().filter(|fit| !fit.includes(cause)).map(|fit| (fit.score, &fit.parts[..]));
        singles.chain(pairs).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, &[]))
    }
}

/// Explains the drift of `window` by `causes`. A change of the motor must also explain that of the back-EMF; if only a
/// shorter duration shows the back-EMF, less friction can explain it as well. A motor may also lose torque alone, for
/// example by its commutation, and keep its back-EMF and speed. Together with a rise of friction this is not tried, as
/// dry friction looks the same; nor on a drive that dry friction winds up.
pub(crate) fn explained<const K: usize>(
    causes: [Cause; K],
    window: &Window,
    evidence: MotorEvidence,
    settings: &Settings,
) -> Fit<K> {
    let Window { mean, covariance, .. } = window;
    let MotorEvidence { back_emf, leaks } = evidence;
    let Some(back_emf) = back_emf else { return fit(leaks, causes, mean, covariance, settings) };
    let BackEmf { level, of_duration, at_start, is_wound_up } = back_emf;
    let misfit = |motor: f64| level.misfit(motor, MOST_BACK_EMF_MISFIT);
    // In complete coefficients, b0 contains the acceleration at the start already: it must not count twice.
    let at_start = at_start.filter(|_| !window.shows(Cause::Inertia));
    let of_start = |fit: &Fit<K>| at_start.map_or(0.0, |at_start| misfit_of_start(at_start, is_wound_up, fit));
    // Dry friction leaks into the coefficients. The size of a change of the motor depends on the assumed leaks. The
    // back-EMF shows this size too, so its misfit counts in the odds of the leaks.
    let beside = |fit: &Fit<K>| {
        let is_shorter_by_friction = of_duration && fit.size_of(Cause::Friction) < 0.0;
        of_start(fit) + if is_shorter_by_friction { 0.0 } else { misfit(fit.size_of(Cause::Kt)) }
    };
    let found = fit_beside(leaks, causes, mean, covariance, beside, settings);
    let is_shorter_by_friction = of_duration && found.size_of(Cause::Friction) < 0.0;
    let may_lose_torque = !is_shorter_by_friction && !is_wound_up;
    if found.includes(Cause::Kt) && (K != 2 || !found.includes(Cause::Friction)) && may_lose_torque {
        let mut alone = fit(leaks.at_equal_speed(), causes, mean, covariance, settings);
        alone.score +=
            of_start(&alone) + misfit(0.0) + TORQUE_ALONE + (alone.size_of(Cause::Kt) / TORQUE_ALONE_SD).powi(2);
        if alone.score < found.score {
            return alone;
        }
    }
    found
}

/// Misfit of the acceleration per ampere at the start. A weaker motor lowers this acceleration by about its own change,
/// friction by much less, unless it winds up the drive.
fn misfit_of_start<const K: usize>(AtStart { level, is_prompt }: AtStart, is_wound_up: bool, fit: &Fit<K>) -> f64 {
    let (motor, friction) = (fit.size_of(Cause::Kt), fit.size_of(Cause::Friction));
    let shown = if is_prompt { MOTOR_AT_START } else { MOTOR_AFTER_BRAKE };
    let [a, b] = [shown.start * motor, shown.end * motor];
    let of_friction = -(if is_wound_up { 1.0 } else { FRICTION_AT_START }) * friction;
    let (least, most) = (a.min(b) + of_friction.min(0.0), a.max(b) + of_friction.max(0.0));
    level.misfit(level.value.clamp(least, most), MOST_START_MISFIT)
}

/// The explanations with their bonus for the causes `open`, which have an alarm; the best first. An explanation by a
/// cause that the window does not show is the last.
fn ranked<const N: usize, const K: usize>(
    explanations: [[Cause; K]; N],
    window: &Window,
    open: &[Cause],
    evidence: MotorEvidence,
    settings: &Settings,
) -> [Fit<K>; N] {
    let mut fits = explanations.map(|causes| {
        let mut fit = explained(causes, window, evidence, settings);
        if causes.iter().all(|cause| open.contains(cause)) {
            fit.score -= K as f64 * ALARM_BONUS;
        } else if K == 2 && open.contains(&Cause::Unattributed) {
            fit.score -= ALARM_BONUS;
        }
        if !causes.iter().all(|cause| window.shows(*cause)) {
            fit.score = f64::INFINITY;
        }
        fit
    });
    fits.sort_by(|a, b| a.score.total_cmp(&b.score));
    fits
}

/// The single cause that explains the drift of `window` best, without gauges.
pub(super) fn best_single(window: &Window, settings: &Settings) -> Explanation {
    let [best, ..] = ranked(Cause::PHYSICAL.map(|cause| [cause]), window, &[], MotorEvidence::NONE, settings);
    best.parts[0]
}
