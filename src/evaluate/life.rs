//! One life, observed by the monitor and both comparators.

use super::{
    comparator::Comparator,
    coverage::Coverage,
    cusum::{Cusum, Design},
    judge::Call,
    paper::PaperRule,
    scenario::Limits,
    timeline::Timeline,
};
use crate::diagnose::{AlarmState, Cause, Command, MachineMonitor, Observation, Settings};

/// Source of the throws of a life: the observation of each throw by its number. The directions alternate.
pub(super) type Source<'a> = Box<dyn FnMut(usize) -> Observation + 'a>;

/// Settings of the three rules.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rules<'a> {
    pub(super) settings: &'a Settings,
    pub(super) limits: Limits,
    /// Throws in the baseline of each direction of the comparators.
    pub(super) baseline: usize,
    pub(super) cusum: Design,
}

/// The calls of the three rules over one life.
#[derive(Debug, Default)]
pub(super) struct Calls {
    pub(super) monitor: Vec<Call>,
    /// Alarms of the monitor, except those that the machine is not monitored.
    pub(super) raised: usize,
    /// Alarms that the machine is not monitored, because its scatter hides a fault.
    pub(super) not_monitored: usize,
    /// First throw at which the monitor stated that its baseline has a trend.
    pub(super) trend: Option<usize>,
    /// Correctness of the monitor's sizes and forecasts.
    pub(super) coverage: Coverage,
    pub(super) paper: Vec<Call>,
    pub(super) cusum: Vec<Call>,
}

/// Simulates a life and applies the three rules.
pub(super) fn live(mut source: Source<'_>, life: &Timeline, rules: Rules<'_>) -> Calls {
    let mut monitor = MachineMonitor::new("evaluated");
    let mut paper = Comparator::new(PaperRule { limits: rules.limits, recent: Vec::new() }, rules.baseline);
    let mut cusum = Comparator::new(Cusum::new(rules.cusum), rules.baseline);
    let mut calls = Calls::default();
    for at in 0..life.throws {
        let observation = source(at);
        let verdict = monitor.observe(&observation, rules.settings);
        if calls.trend.is_none() && verdict.has_trend {
            calls.trend = Some(at);
        }
        calls.coverage.add(at, &verdict, life, rules.settings);
        let events = verdict.events;
        // Acknowledged, so that the next raise of the alarm is a new alarm: the comparators count each of their calls.
        for event in events.iter().filter(|event| event.state == AlarmState::ClearedUnacknowledged) {
            let command = Command::Ack { cause: event.cause, by: "evaluation".to_owned() };
            // Can fail only without this alarm, and the alarm is open.
            let _ = monitor.command(&command, observation.started_at, rules.settings);
        }
        let raised = events.iter().filter(|event| event.event_no == 1);
        let not_monitored = raised.clone().filter(|event| event.cause == Cause::NotMonitored).count();
        calls.raised += raised.count() - not_monitored;
        calls.not_monitored += not_monitored;
        calls.monitor.extend(events.iter().filter_map(|event| Call::of(event, at)));
        paper.observe(at, &observation);
        cusum.observe(at, &observation);
    }
    Calls { paper: paper.calls, cusum: cusum.calls, ..calls }
}
