//! Judges what a rule said over one life.

use super::timeline::Timeline;
use crate::diagnose::{AlarmEvent, AlarmState, Cause, Severity};

/// A rule named a cause (or could not) at a throw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Call {
    /// The throw of the machine, from 0.
    pub(super) at: usize,
    /// A part, or [`Cause::Unattributed`].
    pub(super) cause: Cause,
    /// Whether at critical severity.
    pub(super) critical: bool,
}

impl Call {
    /// The call that an event of the monitor makes at throw `at`: a drift alarm that is raised or becomes critical.
    pub(super) fn of(event: &AlarmEvent, at: usize) -> Option<Self> {
        let drift = is_part(event.cause) || event.cause == Cause::Unattributed;
        let active = matches!(event.state, AlarmState::ActiveUnacknowledged | AlarmState::ActiveAcknowledged);
        let critical = event.severity == Severity::Critical;
        (drift && active && (event.event_no == 1 || critical)).then_some(Self { at, cause: event.cause, critical })
    }
}

/// How a rule did on one life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Judgement {
    /// Named right, this many throws after the onset (1: at the first throw with the fault).
    Right(usize),
    /// Named wrong, or alarmed before there was a fault.
    Wrong,
    /// Alarmed and named nothing.
    Ambiguous,
    /// Nothing; of two causes, one.
    Missed,
}

fn is_part(cause: Cause) -> bool {
    matches!(cause, Cause::Kt | Cause::Friction | Cause::Stiffness | Cause::Inertia)
}

/// Judges the calls made over a life, in the order in which they were made. The definitions are in [`super`].
pub(super) fn judge(calls: &[Call], life: &Timeline) -> Judgement {
    let before = calls.iter().take_while(|call| call.at < life.onset);
    let after = &calls[before.clone().count()..];
    if before.into_iter().any(|call| Some(call.cause) != life.repaired()) {
        return Judgement::Wrong;
    }
    let truth: Vec<Cause> = life.truth().collect();
    let named = || after.iter().filter(|call| is_part(call.cause));
    let wrong_first = named().next().is_some_and(|first| !truth.contains(&first.cause));
    let wrong_critical = named().any(|call| call.critical && !truth.contains(&call.cause));
    if wrong_first || wrong_critical {
        return Judgement::Wrong;
    }
    let first = |cause: Cause| after.iter().find(|call| call.cause == cause).map(|call| call.at);
    let unattributed = first(Cause::Unattributed);
    let all_named = truth.iter().map(|&cause| first(cause)).collect::<Option<Vec<_>>>();
    let all_named = all_named.and_then(|throws| throws.into_iter().max());
    let (right, ambiguous) = match truth.len() {
        1 => (all_named, unattributed),
        _ => (all_named.into_iter().chain(unattributed).min(), None),
    };
    match (right, ambiguous) {
        (Some(at), _) => Judgement::Right(at - life.onset + 1),
        (None, Some(_)) => Judgement::Ambiguous,
        (None, None) => Judgement::Missed,
    }
}
