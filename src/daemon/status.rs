//! Status of the daemon: counters, and a line of text.

use std::{
    collections::{BTreeMap, HashMap},
    sync::{Arc, atomic::Ordering::Relaxed},
};

use parking_lot::{Mutex, MutexGuard};
use serde::{Deserialize, Serialize};

use super::heartbeat::Heartbeats;
use crate::{
    bus::{InboxCounters, OutletCounters},
    diagnose::{MachineState, Severity},
    store::{DiskLevel, RecentCount, Store, Window, seldom},
    throw::{MachineId, counted},
};

/// Invalid messages of a machine in a row that are an alarm; a few may be accidents.
const INVALID_IN_A_ROW: u32 = 5;
/// Largest number of unknown machines whose invalid messages are counted.
const UNKNOWN: usize = 64;

/// Counters and states, shared by all loops.
#[derive(Debug, Default)]
pub(crate) struct Status {
    pub heartbeats: Heartbeats,
    /// The part of the report that the loops write. `received` has only the messages from the backlogs of loggers;
    /// `standing` is renewed every few seconds and after every command.
    report: Mutex<StatusReport>,
    /// Throws without an estimate, by the code of the reason.
    refused: Mutex<BTreeMap<String, u64>>,
    /// Invalid messages since the last valid throw of a machine: their number and the last reason.
    invalid: Mutex<HashMap<MachineId, (u32, String)>>,
    pub(super) machines_refused: RecentCount,
    pub(super) alarm_events_lost: RecentCount,
}

/// Number of machines in each state, and of shelved alarms.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Standing {
    /// Machines in each state; states without machines are left out.
    pub machines: BTreeMap<MachineState, u64>,
    /// Open alarms that are shelved.
    pub shelved_alarms: u64,
    /// Open alarms about the daemon itself: disk, database, rejected data.
    #[serde(default)]
    pub own_alarms: u64,
}

impl Standing {
    /// Number of machines in a state.
    pub fn count(&self, state: MachineState) -> u64 {
        self.machines.get(&state).copied().unwrap_or(0)
    }

    /// Whether every machine is healthy or learning, no alarm is shelved, and the daemon has no own alarm.
    pub fn is_well(&self) -> bool {
        self.machines.keys().all(|state| state.is_well()) && self.shelved_alarms + self.own_alarms == 0
    }
}

/// The status, as in `pointsd status --json`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct StatusReport {
    /// Program version.
    pub version: String,
    /// Time since the start \[s\].
    pub uptime_s: u64,
    /// The database file.
    pub database: String,
    /// State of the disk of the database.
    pub disk: DiskLevel,
    /// Whether the database is being copied to a new file, as a program keeps reading an old state. Writes wait meanwhile.
    #[serde(default)]
    pub copying: bool,
    /// Size of the write-ahead log \[bytes\].
    pub wal_bytes: u64,
    /// Whether a link to others is up.
    pub connected: bool,
    /// Loggers that are connected now.
    pub loggers: usize,
    /// The first of the machines whose loggers are connected and sent no throw yet.
    #[serde(default)]
    pub without_throw: Vec<String>,
    /// The first of the machines of which every message so far was refused, with the reason.
    #[serde(default)]
    pub refused: Vec<String>,
    /// Number of the last loggers that date their throws a day or more after this computer, if these are most; else 0.
    #[serde(default)]
    pub loggers_ahead: usize,
    /// Number of the last loggers that date their throws a day or more before this computer, all by the same time, if
    /// these are most; else 0.
    #[serde(default)]
    pub loggers_behind: usize,
    /// Messages received.
    pub received: u64,
    /// Messages dropped because the queue was full.
    pub dropped: u64,
    /// Invalid replies of loggers.
    #[serde(default)]
    pub ignored: u64,
    /// Missing throws that may be in the backlogs of their loggers.
    #[serde(default, alias = "behind")]
    pub backlog: u64,
    /// Throws stored.
    pub stored: u64,
    /// Repetitions of stored throws.
    pub duplicates: u64,
    /// Messages in quarantine since the start.
    pub quarantined: u64,
    /// Throws and messages received and not stored, since the start.
    pub lost: u64,
    /// Rejected throws of new machines beyond `max_machines`.
    #[serde(default)]
    pub machines_refused: u64,
    /// Throws identified and diagnosed.
    pub judged: u64,
    /// Of these, throws that were rejected.
    pub not_evaluated: u64,
    /// Alarm events since the start.
    pub alarm_events: u64,
    /// Alarm events that the database rejected, since the start.
    #[serde(default)]
    pub alarm_events_lost: u64,
    /// Messages published.
    pub published: u64,
    /// Health messages dropped because the publishing queue was full.
    pub unpublished: u64,
    /// Whether the webhook did not accept the last message.
    #[serde(default)]
    pub webhook_fails: bool,
    /// Alarm events that the webhook refused.
    #[serde(default)]
    pub webhook_refused: u64,
    /// Loops without a fresh heartbeat.
    pub silent: Vec<String>,
    /// States of the machines: `machines` and `shelved_alarms` in JSON.
    #[serde(flatten)]
    pub standing: Standing,
    /// Open maintenance windows and shelvings; only in the reply to a query for the status.
    #[serde(default)]
    pub windows: Vec<Window>,
}

impl Status {
    /// The report, for a loop to change; locked until the end of the statement.
    pub(super) fn edit(&self) -> MutexGuard<'_, StatusReport> {
        self.report.lock()
    }

    /// Counts a rejected throw.
    pub(super) fn refuse(&self, reason: &str) {
        self.edit().not_evaluated += 1;
        *self.refused.lock().entry(reason.to_owned()).or_default() += 1;
    }

    /// Counts a message of a machine that is no valid throw. Of unknown machines at most [`UNKNOWN`] are counted, as any
    /// sender can invent names.
    pub(super) fn count_invalid(&self, machine: MachineId, is_known: bool, reason: &str) {
        let mut invalid = self.invalid.lock();
        if !is_known && invalid.len() >= UNKNOWN && !invalid.contains_key(&machine) {
            return;
        }
        let (count, last) = invalid.entry(machine).or_default();
        *count = count.saturating_add(1);
        reason.clone_into(last);
    }

    /// Notes a valid throw of a machine.
    pub(super) fn count_valid(&self, machine: &MachineId) {
        self.invalid.lock().remove(machine);
    }

    /// Machines of which [`INVALID_IN_A_ROW`] messages or more were no valid throws since the last call or the last valid
    /// one, with their number and the last reason.
    pub(super) fn invalid_in_a_row(&self) -> Vec<(MachineId, (u32, String))> {
        let mut invalid = self.invalid.lock();
        invalid.extract_if(|_, (count, _)| *count >= INVALID_IN_A_ROW).collect()
    }

    /// Rejected data, for the alarm about the daemon.
    pub(super) fn trouble(&self, max_machines: usize) -> Vec<(Severity, String)> {
        let refused = self.machines_refused.shown().map(|refused| {
            format!(
                "throws of new machines refused: {refused}. As many machines are known as subscribe.max_machines allows: \
                 {max_machines}. Look in the quarantine who sends them"
            )
        });
        // Without a number: each new number would be a new alarm event, which the database may reject too.
        let lost = self.alarm_events_lost.shown().map(|_| {
            "the database rejects alarms, which were not published. Their texts are in the log; restore the schema of the database"
                .to_owned()
        });
        refused.into_iter().chain(lost).map(|said| (Severity::Critical, said)).collect()
    }

    /// Number of throws without an estimate, by the code of the reason.
    pub(crate) fn refused(&self) -> BTreeMap<String, u64> {
        self.refused.lock().clone()
    }
}

/// The sources of a status report.
#[derive(Clone)]
pub(crate) struct StatusSources {
    pub(crate) status: Arc<Status>,
    pub(crate) inbox: Arc<InboxCounters>,
    pub(super) outlet: Arc<OutletCounters>,
    pub(crate) store: Store,
}

impl StatusSources {
    pub(crate) fn report(&self) -> StatusReport {
        let status = &self.status;
        let copying = self.store.is_copying();
        let report = status.edit().clone();
        StatusReport {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            uptime_s: status.heartbeats.uptime().as_secs(),
            database: self.store.path().display().to_string(),
            disk: self.store.disk_level(),
            copying,
            wal_bytes: self.store.wal_bytes(),
            received: self.inbox.received.load(Relaxed) + report.received,
            dropped: self.inbox.dropped.load(Relaxed),
            machines_refused: status.machines_refused.count(),
            alarm_events_lost: status.alarm_events_lost.count(),
            published: self.outlet.published.load(Relaxed),
            unpublished: self.outlet.dropped.load(Relaxed),
            silent: status.heartbeats.silent(copying).into_iter().map(|task| task.as_ref().to_owned()).collect(),
            ..report
        }
    }

    /// The report with the open windows: the reply to a query.
    pub(crate) async fn answer(&self) -> StatusReport {
        let mut report = self.report();
        match self.store.reader().windows(None).await {
            Ok(windows) => report.windows = windows,
            // The rest of the status is most important when the database does not answer.
            Err(error) => seldom!(warn, %error, "the database does not answer: status without maintenance windows"),
        }
        report
    }
}

impl StatusReport {
    /// Problems of the daemon itself: disk, loops, clock, webhook, lost or refused messages. The pages show the same
    /// sentences.
    pub fn problems(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let mut add = |is_so: bool, problem: &str| problems.extend(is_so.then(|| problem.to_owned()));
        add(self.disk == DiskLevel::Low, "DISK LOW: old traces are dropped, free some space");
        add(self.disk == DiskLevel::Full, "DISK FULL: nothing can be stored, free some space");
        add(self.disk == DiskLevel::Failing, "DATABASE FAILING: writes do not succeed");
        add(self.copying, "COPYING THE DATABASE: a program keeps reading an old state, and writes wait");
        add(!self.silent.is_empty(), &format!("HANGING: {}", self.silent.join(", ")));
        add(self.loggers_ahead > 0, "CLOCK BEHIND: most loggers date their throws a day or more after this computer");
        add(
            self.loggers_behind > 0,
            "CLOCK AHEAD: most loggers date their throws a day or more before this computer, all by the same time",
        );
        add(!self.refused.is_empty(), &format!("EVERY MESSAGE REFUSED: {}", self.refused.join("; ")));
        add(self.webhook_fails, "WEBHOOK FAILS: alarms wait for its receiver");
        let refused = counted(self.webhook_refused, "alarm event");
        add(self.webhook_refused > 0, &format!("WEBHOOK REFUSED {refused}: not sent again, look in the log"));
        let rejected = counted(self.alarm_events_lost, "alarm event");
        add(self.alarm_events_lost > 0, &format!("{rejected} LOST: the database rejects them, look in the log"));
        let lost = self.dropped + self.lost;
        add(lost > 0, &format!("{} LOST: received and not stored", counted(lost, "message")));
        problems
    }

    /// One line of text, problems first.
    pub fn line(&self) -> String {
        self.parts().join("; ")
    }

    /// The parts of [`Self::line`]: each problem, then the counts.
    pub fn parts(&self) -> Vec<String> {
        let mut parts = self.problems();
        if !self.connected {
            parts.push("not connected".to_owned());
        }
        let states: Vec<String> =
            [MachineState::Critical, MachineState::Warning, MachineState::NotMonitored, MachineState::Maintenance]
                .into_iter()
                .map(|state| (self.standing.count(state), state.as_str().replace('_', " ")))
                .filter(|(count, _)| *count > 0)
                .map(|(count, state)| format!("{count} {state}"))
                .collect();
        if !states.is_empty() {
            parts.push(format!("machines: {}", states.join(", ")));
        }
        if self.standing.own_alarms > 0 {
            parts.push(format!("{} OF THE DAEMON ITSELF", counted(self.standing.own_alarms, "alarm").to_uppercase()));
        }
        if self.standing.shelved_alarms > 0 {
            parts.push(format!("{} shelved", counted(self.standing.shelved_alarms, "alarm")));
        }
        if !self.without_throw.is_empty() {
            parts.push(format!("connected, but no throw yet: {}", self.without_throw.join(", ")));
        }
        if self.backlog > 0 {
            let are = if self.backlog == 1 { "is" } else { "are" };
            parts.push(format!("{} {are} still in the backlogs of loggers", counted(self.backlog, "throw")));
        }
        parts.push(format!(
            "{}, {} stored, {} judged ({} not evaluated), {} in quarantine",
            counted(self.loggers as u64, "logger"),
            counted(self.stored, "throw"),
            self.judged,
            self.not_evaluated,
            self.quarantined
        ));
        parts
    }
}
