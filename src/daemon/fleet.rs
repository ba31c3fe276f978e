//! The monitors of all machines, and what follows from what they see: pure bookkeeping between core and database.

use std::collections::{HashMap, HashSet};

use jiff::Timestamp;

use crate::{
    diagnose::{AlarmEvent, Command, CommandError, MachineMonitor, Observation, Settings, Severity, Verdict},
    estimate::Identification,
    store::{AlarmRecord, BaselineRecord, Judgement, Message, Outcome, StoredThrow},
    throw::MachineId,
    wire::{self, Alarm, Kind},
};

/// `quality` of a throw whose stored trace cannot be read.
const UNREADABLE: &str = "unreadable_trace";
/// `quality` of a throw on which the estimator itself failed.
const ESTIMATOR_FAILED: &str = "estimator_failed";

/// The monitors of all machines.
#[derive(Default)]
pub struct Fleet {
    monitors: HashMap<MachineId, MachineMonitor>,
}

impl Fleet {
    /// The monitors as the database kept them. A snapshot that cannot be read is left out, and said: its machine
    /// learns anew.
    #[must_use]
    pub fn restore(snapshots: Vec<(MachineId, String)>) -> Self {
        let mut fleet = Self::default();
        for (machine, json) in snapshots {
            match serde_json::from_str(&json) {
                Ok(monitor) => drop(fleet.monitors.insert(machine, monitor)),
                Err(error) => tracing::error!(%machine, %error, "its monitor cannot be read and begins anew"),
            }
        }
        fleet
    }

    /// The machines that are monitored.
    pub fn machines(&self) -> impl Iterator<Item = &MachineId> {
        self.monitors.keys()
    }

    fn monitor(&mut self, machine: &MachineId) -> &mut MachineMonitor {
        self.monitors.entry(machine.clone()).or_insert_with(|| MachineMonitor::new(machine.machine.as_str()))
    }

    /// Judges a throw: its diagnosis, and all that is to be committed with it.
    pub fn judge(
        &mut self,
        stored: &StoredThrow,
        found: Option<Identification>,
        settings: &Settings,
        judged_at: Timestamp,
    ) -> (Judgement, Verdict) {
        let (quality, detail) = quality(stored, found.as_ref());
        let monitor = self.monitor(&stored.machine);
        let verdict = monitor.observe(&observation(stored, found.as_ref()), settings);
        let judgement = Judgement {
            row: stored.row,
            machine: stored.machine.clone(),
            judged_at,
            identification: found,
            quality,
            detail,
            change_pct: verdict.change_pct,
            baseline: verdict.baseline,
            baselines: verdict.baselines_taken.iter().map(baseline_record).collect(),
            outcome: outcome(&stored.machine, monitor, &verdict.events),
        };
        (judgement, verdict)
    }

    /// Lets time pass for every machine, with the loggers that show that they are alive: what is to be recorded, per
    /// machine; with `keep_all` also where nothing happened.
    pub fn tick(
        &mut self,
        now: Timestamp,
        settings: &Settings,
        loggers: &HashSet<MachineId>,
        keep_all: bool,
    ) -> Vec<(MachineId, Vec<AlarmEvent>, Outcome)> {
        let mut changed = Vec::new();
        for (machine, monitor) in &mut self.monitors {
            let announced = monitor.is_announced();
            let mut events: Vec<_> = monitor.logger(loggers.contains(machine), now, settings).into_iter().collect();
            events.extend(monitor.tick(now, settings));
            // A logger that is known to show itself is missed after a restart too.
            let first_seen = monitor.is_announced() != announced;
            if keep_all || first_seen || !events.is_empty() {
                let outcome = outcome(machine, monitor, &events);
                changed.push((machine.clone(), events, outcome));
            }
        }
        changed
    }

    /// Takes in what keeps the daemon from keeping data: its own alarm, as if it were a machine.
    pub fn trouble(
        &mut self,
        itself: &MachineId,
        trouble: Option<&(Severity, String)>,
        now: Timestamp,
        settings: &Settings,
    ) -> Option<(MachineId, Vec<AlarmEvent>, Outcome)> {
        if trouble.is_none() && !self.monitors.contains_key(itself) {
            return None;
        }
        let monitor = self.monitor(itself);
        let trouble = trouble.map(|(severity, said)| (*severity, said.as_str()));
        let event = monitor.trouble(trouble, now, settings)?;
        let outcome = outcome(itself, monitor, std::slice::from_ref(&event));
        Some((itself.clone(), vec![event], outcome))
    }

    /// Takes in that throws of a machine never came.
    pub fn gap(
        &mut self,
        machine: &MachineId,
        lost: u64,
        at: Timestamp,
        settings: &Settings,
    ) -> (Vec<AlarmEvent>, Outcome) {
        let monitor = self.monitor(machine);
        let events = monitor.gap(lost, at, settings);
        let outcome = outcome(machine, monitor, &events);
        (events, outcome)
    }

    /// Carries out an operator's command. `None` when no such machine is monitored.
    pub fn command(
        &mut self,
        machine: &MachineId,
        command: &Command,
        now: Timestamp,
        settings: &Settings,
    ) -> Option<Result<(Vec<AlarmEvent>, Outcome), CommandError>> {
        let monitor = self.monitors.get_mut(machine)?;
        let result = monitor.command(command, now, settings);
        Some(result.map(|events| {
            let outcome = outcome(machine, monitor, &events);
            (events, Outcome { command: Some(command.clone()), ..outcome })
        }))
    }
}

fn quality(stored: &StoredThrow, found: Option<&Identification>) -> (String, Option<String>) {
    match (&stored.throw, found.map(|found| &found.outcome)) {
        (_, Some(Ok(_))) => (wire::GOOD.to_owned(), None),
        (_, Some(Err(rejection))) => (rejection.code().to_owned(), Some(rejection.to_string())),
        (Err(unreadable), None) => (UNREADABLE.to_owned(), Some(unreadable.to_string())),
        (Ok(_), None) => {
            let detail = "the estimator failed on this throw: please report it, with the throw".to_owned();
            (ESTIMATOR_FAILED.to_owned(), Some(detail))
        }
    }
}

fn observation(stored: &StoredThrow, found: Option<&Identification>) -> Observation {
    let outcome = found.map(|found| &found.outcome);
    let estimate = outcome.and_then(|outcome| outcome.as_ref().ok());
    let rejection = outcome.and_then(|outcome| outcome.as_ref().err());
    let declared = stored.throw.as_ref().ok();
    Observation {
        throw: stored.id.clone(),
        started_at: stored.started_at,
        direction: found.and_then(|found| found.direction).or(declared.and_then(|throw| throw.direction)),
        estimate: estimate.map(|e| ([e.b0, e.a1, e.a0], e.covariance)),
        incomplete: rejection.is_some_and(crate::estimate::Rejection::is_incomplete),
        features: found.map(|found| found.features.clone()).unwrap_or_default(),
        temperature_c: declared.and_then(|throw| throw.temperature_c),
    }
}

/// The monitor as it is now, the events, and the messages that tell the world.
fn outcome(machine: &MachineId, monitor: &MachineMonitor, events: &[AlarmEvent]) -> Outcome {
    let key = wire::machine_key(machine, Kind::Alarm);
    let mut outcome = Outcome { snapshot: snapshot(machine, monitor), ..Outcome::default() };
    for event in events {
        let payload = Alarm::new(machine, event).to_json();
        let text = String::from_utf8_lossy(&payload).into_owned();
        outcome.alarms.push(AlarmRecord { event: event.clone(), payload: text });
        outcome.outbox.push(Message { key: key.clone(), payload });
    }
    outcome
}

fn snapshot(machine: &MachineId, monitor: &MachineMonitor) -> Option<String> {
    serde_json::to_string(monitor)
        .inspect_err(|error| tracing::error!(%machine, %error, "its monitor cannot be kept: a restart would forget"))
        .ok()
}

fn baseline_record(record: &crate::diagnose::BaselineRecord) -> BaselineRecord {
    BaselineRecord {
        direction: record.direction,
        throws: record.throws,
        centre: record.center,
        // Numbers and words into memory: nothing in it can fail.
        details: serde_json::to_string(record).unwrap_or_default(),
        by: None,
        why: None,
    }
}
