//! Judges the calls of a rule over one life.

use super::timeline::Timeline;
use crate::diagnose::{AlarmEvent, Cause, Severity};

/// A cause named by a rule at a throw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Call {
    /// Index of the throw, from 0.
    pub(super) at: usize,
    /// The named part, or [`Cause::Unattributed`].
    pub(super) cause: Cause,
    /// Whether the severity is critical.
    pub(super) critical: bool,
    /// Whether the alarm names a sensor as equally possible.
    pub(super) or_sensor: bool,
}

impl Call {
    /// The call of an alarm event at throw `at`. `None` unless the alarm is about a drift, a sensor, the supply or slow
    /// throws, and the event raises it or is critical.
    pub(super) fn of(event: &AlarmEvent, at: usize) -> Option<Self> {
        let named = event.cause.is_drift() || matches!(event.cause, Cause::Sensor | Cause::Supply | Cause::SlowThrow);
        let critical = event.severity == Severity::Critical;
        let or_sensor = event.runner_up.is_some_and(|other| other.cause == Cause::Sensor);
        let call = Self { at, cause: event.cause, critical, or_sensor };
        (named && event.state.is_active() && (event.event_no == 1 || critical)).then_some(call)
    }
}

/// Judgement of a rule over a life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Judgement {
    /// Named right, with the delay: throws from the onset to the name, 1 at the first throw with the fault.
    Right(usize),
    /// Named wrong, or an alarm before the fault, or any alarm about a fault that the baseline contains.
    Wrong,
    /// An alarm without a name.
    Ambiguous,
    /// No alarm, or only one of two causes named.
    Missed,
}

/// Judges the calls of a life, in their order, by the definitions in [`super`]. `trend`: first throw at which the rule
/// stated that its baseline has a trend.
pub(super) fn judge(calls: &[Call], trend: Option<usize>, life: &Timeline) -> Judgement {
    if life.fault_is_in_baseline() && !calls.is_empty() {
        return Judgement::Wrong;
    }
    let (before, after) = calls.split_at(calls.partition_point(|call| call.at < life.onset));
    // The name of an earlier fault that still exists is neither an answer nor an error.
    let after: Vec<Call> = after.iter().filter(|call| Some(call.cause) != life.lasting()).copied().collect();
    let truth: Vec<Cause> = life.truth().collect();
    if before.iter().any(|call| Some(call.cause) != life.earlier()) || is_wrong(&after, &truth) {
        return Judgement::Wrong;
    }
    let (right, ambiguous) = answers(&after, &truth);
    // For wear from the first throw, an early statement about the baseline is a name, and a late name does not count.
    let right = match life.deadline() {
        Some(deadline) => right.into_iter().chain(trend).min().filter(|at| *at < deadline),
        None => right,
    };
    match (right, ambiguous) {
        (Some(at), _) => Judgement::Right(at - life.onset + 1),
        (None, Some(_)) => Judgement::Ambiguous,
        (None, None) => Judgement::Missed,
    }
}

/// Whether the first named part, or one at critical severity, is healthy.
fn is_wrong(after: &[Call], truth: &[Cause]) -> bool {
    let mut named = after.iter().filter(|call| call.cause.is_part() && !leaves_sensor_open(call, truth)).enumerate();
    named.any(|(at, call)| (at == 0 || call.critical) && !truth.contains(&call.cause))
}

/// The throws at which the calls answer the whole truth, and at which they leave it open: an alarm without a name. Such an
/// alarm is the right answer to two faults.
fn answers(after: &[Call], truth: &[Cause]) -> (Option<usize>, Option<usize>) {
    let first = |is: &dyn Fn(&Call) -> bool| after.iter().find(|call| is(call)).map(|call| call.at);
    let named: Option<Vec<usize>> = truth.iter().map(|&cause| first(&|call| call.cause == cause)).collect();
    let named = named.and_then(|throws| throws.into_iter().max());
    let unattributed = first(&|call| call.cause == Cause::Unattributed || leaves_sensor_open(call, truth));
    match truth.len() {
        1 => (named, unattributed),
        _ => (named.into_iter().chain(unattributed).min(), None),
    }
}

/// Whether an alarm names part and sensor as equally possible, and the fault is one of a sensor. Such an alarm is no name.
fn leaves_sensor_open(call: &Call, truth: &[Cause]) -> bool {
    call.or_sensor && truth.contains(&Cause::Sensor)
}

/// Whether any call named a healthy part at critical severity.
pub(super) fn names_wrongly(calls: &[Call], life: &Timeline) -> bool {
    let at_fault = |call: &Call| {
        if call.at < life.onset {
            Some(call.cause) == life.earlier()
        } else {
            life.truth().chain(life.lasting()).any(|part| part == call.cause)
        }
    };
    calls.iter().any(|call| call.critical && call.cause.is_part() && !at_fault(call))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::{
        random::stream,
        scenario::{Depth, Growth, Noise, Scenario, Situation},
    };

    const BASELINE: usize = 100;

    fn life(situation: Situation, parts: &[Cause]) -> Timeline {
        let faults = parts.iter().map(|&part| (part, 0.2)).collect();
        let shape = if situation == Situation::Wear { Growth::Wear } else { Growth::Step };
        let (depth, noise, hard) = (Depth::Parameter, Noise::Default, false);
        let earlier = (situation == Situation::OnTop).then_some((Cause::Friction, 0.3));
        let scenario = Scenario { depth, situation, faults, earlier, shape, noise, hard };
        Timeline::of(&scenario, 0, BASELINE, &mut stream(1, 0, 0, 0))
    }

    /// Judges calls given as (throws after the onset, cause, critical).
    fn judged(life: &Timeline, calls: &[(isize, Cause, bool)]) -> Judgement {
        let at = |after: isize| life.onset.checked_add_signed(after).unwrap();
        let calls: Vec<Call> = calls
            .iter()
            .map(|&(after, cause, critical)| Call { at: at(after), cause, critical, or_sensor: false })
            .collect();
        judge(&calls, None, life)
    }

    /// Calls as in `judged`, and their judgement.
    type Case = (&'static [(isize, Cause, bool)], Judgement);

    fn check(life: &Timeline, cases: &[Case]) {
        for (calls, expected) in cases {
            assert_eq!(judged(life, calls), *expected, "{calls:?}");
        }
    }

    #[test]
    fn one_cause_is_judged_by_its_first_name_and_by_critical_names() {
        use Cause::{Inertia, Kt, Unattributed};
        let life = life(Situation::Plain, &[Kt]);
        let cases: &[Case] = &[
            (&[], Judgement::Missed),
            (&[(0, Kt, false)], Judgement::Right(1)),
            (&[(4, Kt, false), (9, Inertia, false)], Judgement::Right(5)),
            (&[(4, Kt, false), (9, Inertia, true)], Judgement::Wrong),
            (&[(4, Inertia, false), (9, Kt, true)], Judgement::Wrong),
            (&[(2, Unattributed, true)], Judgement::Ambiguous),
            (&[(2, Unattributed, true), (6, Kt, false)], Judgement::Right(7)),
            (&[(-1, Kt, false), (1, Kt, false)], Judgement::Wrong),
            (&[(-1, Unattributed, false), (1, Kt, false)], Judgement::Wrong),
        ];
        check(&life, cases);
    }

    #[test]
    fn any_alarm_about_a_fault_that_is_in_the_baseline_is_wrong() {
        let life = life(Situation::FromFirstThrow, &[Cause::Kt]);
        assert_eq!(judged(&life, &[]), Judgement::Missed);
        for cause in [Cause::Kt, Cause::Inertia, Cause::Unattributed] {
            assert_eq!(judged(&life, &[(112, cause, false)]), Judgement::Wrong);
        }
    }

    #[test]
    fn a_sound_part_at_critical_severity_is_distinguished_from_a_warning() {
        let life = life(Situation::Pair, &[Cause::Kt, Cause::Friction]);
        let call = |cause, critical| [Call { at: life.onset + 5, cause, critical, or_sensor: false }];
        assert!(names_wrongly(&call(Cause::Inertia, true), &life));
        assert!(!names_wrongly(&call(Cause::Inertia, false), &life));
        assert!(!names_wrongly(&call(Cause::Friction, true), &life));
        assert!(!names_wrongly(&call(Cause::Unattributed, true), &life));
        assert!(names_wrongly(
            &[Call { at: life.onset - 1, cause: Cause::Kt, critical: true, or_sensor: false }],
            &life
        ));
    }

    #[test]
    fn two_causes_need_both_names_or_none() {
        use Cause::{Friction, Inertia, Kt, Unattributed};
        let life = life(Situation::Pair, &[Kt, Friction]);
        let cases: &[Case] = &[
            (&[], Judgement::Missed),
            (&[(3, Kt, true)], Judgement::Missed),
            (&[(3, Kt, true), (7, Friction, false)], Judgement::Right(8)),
            (&[(3, Unattributed, true)], Judgement::Right(4)),
            (&[(3, Inertia, false)], Judgement::Wrong),
            (&[(3, Unattributed, false), (5, Inertia, true)], Judgement::Wrong),
        ];
        check(&life, cases);
    }

    #[test]
    fn after_a_repair_only_the_second_fault_counts_and_the_first_may_be_named_in_its_time() {
        let life = life(Situation::Repaired, &[Cause::Kt]);
        let first = life.earlier().unwrap();
        assert_ne!(first, Cause::Kt);
        assert_eq!(judged(&life, &[(-110, first, true), (2, Cause::Kt, false)]), Judgement::Right(3));
        assert_eq!(judged(&life, &[(-110, Cause::Kt, true), (2, Cause::Kt, false)]), Judgement::Wrong);
        assert_eq!(judged(&life, &[(-110, first, true), (2, first, false)]), Judgement::Wrong);
    }

    #[test]
    fn a_second_fault_needs_its_own_name_beside_the_first() {
        use Cause::{Friction, Inertia, Kt, Unattributed};
        let life = life(Situation::OnTop, &[Kt]);
        let cases: &[Case] = &[
            (&[(-50, Friction, false)], Judgement::Missed),
            (&[(-50, Friction, false), (3, Kt, false)], Judgement::Right(4)),
            (&[(-50, Friction, false), (2, Friction, true), (3, Kt, false)], Judgement::Right(4)),
            (&[(-50, Friction, false), (2, Unattributed, false)], Judgement::Ambiguous),
            (&[(-50, Friction, false), (2, Inertia, false), (3, Kt, false)], Judgement::Wrong),
            (&[(-50, Kt, false), (3, Kt, false)], Judgement::Wrong),
        ];
        check(&life, cases);
    }

    #[test]
    fn wear_from_the_first_throw_needs_a_name_or_a_trend_in_time() {
        let life = life(Situation::Wear, &[Cause::Friction]);
        let deadline = life.deadline().unwrap();
        let friction = |at| Call { at, cause: Cause::Friction, critical: false, or_sensor: false };
        assert_eq!(judge(&[], None, &life), Judgement::Missed);
        assert_eq!(judge(&[friction(deadline - 1)], None, &life), Judgement::Right(deadline));
        assert_eq!(judge(&[friction(deadline)], None, &life), Judgement::Missed);
        assert_eq!(judge(&[friction(deadline)], Some(40), &life), Judgement::Right(41));
        let inertia = Call { cause: Cause::Inertia, ..friction(deadline) };
        assert_eq!(judge(&[inertia], Some(40), &life), Judgement::Wrong);
    }
}
