//! Evidence for the attribution of a drift beside the drift itself: the drifts that have an alarm already, and what the
//! gauges show about the motor.

use nalgebra::Vector3;

use super::{Explanation, LEAKS_OF_SERIES, Leaks, PLAIN_LEAKS, Window, single};
use crate::diagnose::{
    Cause, Settings,
    baseline::{Baseline, usual_friction_over_spring},
    gauges::{BackEmf, Gauges},
};

/// Change of b0 since [`Known::level`] from which it is a new fault of the motor, as part of the motor's warning limit.
const NEW_MOTOR_FAULT: f64 = 0.5;
/// Least change of the back-EMF that decides about the motor beside a known or new fault of it, as part of the change
/// of the motor.
pub(super) const CHANGED: f64 = 0.5;
/// Least significant change of the back-EMF, in its standard deviations.
pub(super) const CHANGED_SD: f64 = 3.0;

/// The drifts of a machine that have an alarm, with its gauges and baselines.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Known<'a> {
    /// The causes of the active drift alarms, without those of rules that name no part.
    pub(crate) causes: Vec<Cause>,
    /// Mean change of (ln b0, ln a1, ln a0) over the throws since these alarms were raised, without the last throws;
    /// `None` with too few throws.
    pub(crate) level: Option<Vector3<f64>>,
    /// The gauges, which distinguish dry friction from a weak motor.
    pub(crate) gauges: Option<&'a Gauges>,
    /// The baselines of both directions.
    pub(crate) baselines: [Option<&'a Baseline>; 2],
    /// Whether the motor is series-wound, so that its iron may saturate.
    pub(crate) is_series: bool,
}

impl Known<'_> {
    /// Whether the cause of `part` has an alarm.
    pub(super) fn includes(&self, part: &Explanation) -> bool {
        self.causes.contains(&part.cause)
    }

    /// Whether the change `back_emf` decides whether the motor has a part in the drift of `window`. A fault of the
    /// motor may change the torque without the back-EMF, so beside a known or a new fault of the motor a small change
    /// decides nothing. A new fault is a change since the level that is mostly a change of b0.
    pub(super) fn is_decided_by(&self, back_emf: &BackEmf, window: &Window, settings: &Settings) -> bool {
        let is_new = self.level.is_some_and(|level| {
            let since = window.mean - level;
            // A window of ratios has another scale than the level. A change of the motor changes both ratios alike.
            let scale = if window.shows(Cause::Inertia) { 0.0 } else { f64::midpoint(since.y, since.z) };
            let since = since.add_scalar(-scale);
            settings.relevance(Cause::Kt, since.x) > NEW_MOTOR_FAULT && since.y.abs() < since.x.abs()
        });
        let is_new = is_new && may_show_weaker_motor(window, Some(back_emf));
        let is_known = self.causes.contains(&Cause::Kt);
        if !is_new && !is_known {
            return true;
        }
        let motor = |mean: &Vector3<f64>| single(Cause::Kt, mean, &window.covariance, settings).size.abs();
        // Beside a known fault of the motor, another fault looks like a larger one of the motor.
        let before = self.level.filter(|_| is_known).map(|level| motor(&level));
        let others = self.causes.iter().filter(|cause| cause.is_part() && **cause != Cause::Kt);
        let beside = others.map(|other| window.fit([Cause::Kt, *other], settings).size_of(Cause::Kt).abs());
        let motor = beside.chain(before).fold(motor(&window.mean), f64::min);
        let change = back_emf.level.value.abs();
        change > CHANGED * motor && change > CHANGED_SD * back_emf.level.sd
    }
}

/// Evidence about the motor beside the coefficients.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MotorEvidence {
    /// The change of the back-EMF, if it decides whether the motor has changed.
    pub(super) back_emf: Option<BackEmf>,
    /// The leaks that are possible with this motor and evidence.
    pub(super) leaks: Leaks,
}

impl MotorEvidence {
    /// Without evidence.
    pub(crate) const NONE: Self = Self { back_emf: None, leaks: PLAIN_LEAKS };

    pub(super) fn new(back_emf: Option<BackEmf>, known: &Known) -> Self {
        let leaks = match back_emf {
            Some(BackEmf { is_wound_up, .. }) => {
                Leaks::beside_gauges(usual_friction_over_spring(known.baselines), is_wound_up)
            }
            None if known.is_series => LEAKS_OF_SERIES,
            None => PLAIN_LEAKS,
        };
        Self { back_emf, leaks }
    }

    /// Whether saturated iron may hide in the drift: the motor is series-wound, and its back-EMF is unknown.
    pub(super) fn may_saturate(&self) -> bool {
        self.leaks == LEAKS_OF_SERIES
    }
}

/// Whether a drift that looks like a weaker motor may be one. Complete coefficients show a loss of torque in b0; of
/// ratios, the gauges may exclude a weaker motor.
pub(super) fn may_show_weaker_motor(window: &Window, back_emf: Option<&BackEmf>) -> bool {
    window.shows(Cause::Inertia) || !back_emf.is_some_and(BackEmf::excludes_weaker_motor)
}
