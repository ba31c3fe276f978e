//! How the daemon stands: counts that only grow, and one line for people.

use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering::Relaxed},
    },
    time::Instant,
};

use serde::{Deserialize, Serialize};

use super::{clock, heartbeat::Heartbeats};
use crate::{
    bus::{InboxCounters, OutletCounters},
    diagnose::{MachineState, Severity},
    store::{DiskLevel, Recent, Store, Window},
};

/// Counters and states of the loops. Shared by all of them.
#[derive(Debug)]
pub struct Status {
    /// Heartbeats of the loops.
    pub heartbeats: Heartbeats,
    /// Throws that were stored.
    pub stored: AtomicU64,
    /// Throws that were stored before.
    pub duplicates: AtomicU64,
    /// Messages in quarantine since the start.
    pub quarantined: AtomicU64,
    /// Throws and messages that were received and could not be stored.
    pub lost: AtomicU64,
    /// Messages that came from the backlogs of loggers.
    pub backlog_received: AtomicU64,
    /// Replies of loggers that were not what was asked for.
    pub ignored: AtomicU64,
    /// Throws that are missing and may be in a backlog.
    pub backlog: AtomicU64,
    /// Throws that were identified and diagnosed.
    pub judged: AtomicU64,
    /// Of these, throws that gave no estimate.
    pub not_evaluated: AtomicU64,
    /// How the machines are: renewed every few seconds and after every command.
    standing: Mutex<Standing>,
    /// The same by the code of the reason: a few, as the estimator has them.
    refused: Mutex<BTreeMap<String, u64>>,
    /// Throws of new machines that were refused, as `max_machines` are known.
    pub(super) machines_refused: Recent,
    /// Alarm events.
    pub alarm_events: AtomicU64,
    /// Loggers that are connected now.
    pub loggers: AtomicUsize,
    /// Whether a link to others is up.
    pub connected: AtomicBool,
    /// Whether the database refuses writes at the moment.
    pub storing_fails: AtomicBool,
    started: Instant,
}

/// How the machines are, so that a machine in maintenance or a shelved alarm is not forgotten.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Standing {
    /// Machines in each state that occurs.
    pub machines: BTreeMap<MachineState, u64>,
    /// Open alarms that are shelved.
    pub shelved_alarms: u64,
    /// Open alarms about the daemon itself: its disk, its database, what it has to refuse.
    #[serde(default)]
    pub own_alarms: u64,
}

impl Standing {
    /// Machines in a state.
    #[must_use]
    pub fn count(&self, state: MachineState) -> u64 {
        self.machines.get(&state).copied().unwrap_or(0)
    }

    /// Whether every machine is healthy or learns its baseline, no alarm is shelved, and the daemon has none of its own.
    #[must_use]
    pub fn is_well(&self) -> bool {
        let well = |state: &MachineState| matches!(state, MachineState::Healthy | MachineState::Learning);
        self.machines.keys().all(well) && self.shelved_alarms + self.own_alarms == 0
    }
}

/// The status as `pointsd status` gets it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StatusReport {
    /// Program version.
    pub version: String,
    /// Time since the start \[s\].
    pub uptime_s: u64,
    /// The database file.
    pub database: String,
    /// `ok`, `low`, `full` or `failing`.
    pub disk: String,
    /// Size of the write-ahead log \[bytes\].
    pub wal_bytes: u64,
    /// Whether a link to others is up.
    pub connected: bool,
    /// Loggers that are connected now.
    pub loggers: usize,
    /// Messages that arrived.
    pub received: u64,
    /// Messages dropped before storing because too many waited.
    pub dropped: u64,
    /// Replies of loggers that were not what was asked for.
    #[serde(default)]
    pub ignored: u64,
    /// Throws that are missing and may be in the backlogs of their loggers.
    #[serde(default, alias = "behind")]
    pub backlog: u64,
    /// Throws stored.
    pub stored: u64,
    /// Throws that were stored before.
    pub duplicates: u64,
    /// Messages in quarantine since the start.
    pub quarantined: u64,
    /// Throws and messages that could not be kept at all.
    pub lost: u64,
    /// Throws of new machines that were refused, as `max_machines` are known.
    #[serde(default)]
    pub machines_refused: u64,
    /// Throws identified and diagnosed.
    pub judged: u64,
    /// Of these, throws that gave no estimate.
    pub not_evaluated: u64,
    /// Alarm events since the start.
    pub alarm_events: u64,
    /// Messages published.
    pub published: u64,
    /// Health messages that were not published because links were slow.
    pub unpublished: u64,
    /// Loops that hang.
    pub silent: Vec<String>,
    /// How the machines are: `machines` and `shelved_alarms` in JSON.
    #[serde(flatten)]
    pub standing: Standing,
    /// Machines in maintenance and shelved alarms, in the answer to a `status` query.
    #[serde(default)]
    pub windows: Vec<Window>,
}

impl Status {
    /// Nothing has happened yet.
    #[must_use]
    pub fn new() -> Self {
        Self {
            heartbeats: Heartbeats::new(),
            stored: AtomicU64::new(0),
            duplicates: AtomicU64::new(0),
            quarantined: AtomicU64::new(0),
            lost: AtomicU64::new(0),
            backlog_received: AtomicU64::new(0),
            ignored: AtomicU64::new(0),
            backlog: AtomicU64::new(0),
            judged: AtomicU64::new(0),
            not_evaluated: AtomicU64::new(0),
            standing: Mutex::default(),
            refused: Mutex::default(),
            machines_refused: Recent::default(),
            alarm_events: AtomicU64::new(0),
            loggers: AtomicUsize::new(0),
            connected: AtomicBool::new(false),
            storing_fails: AtomicBool::new(false),
            started: clock::monotonic(),
        }
    }
}

impl Status {
    /// Counts a throw that gave no estimate, with the code of the reason.
    pub(super) fn refuse(&self, reason: &str) {
        self.not_evaluated.fetch_add(1, Relaxed);
        *self.refused.lock().unwrap_or_else(PoisonError::into_inner).entry(reason.to_owned()).or_default() += 1;
    }

    pub(super) fn set_standing(&self, standing: Standing) {
        *self.standing.lock().unwrap_or_else(PoisonError::into_inner) = standing;
    }

    /// What the daemon has to refuse, for its own alarm.
    pub(super) fn trouble(&self, max_machines: usize) -> Option<(Severity, String)> {
        let refused = self.machines_refused.shown()?;
        let said = format!(
            "{refused} throws of new machines were refused: {max_machines} machines are known, as many as \
             subscribe.max_machines allows. Look in the quarantine who sends them"
        );
        Some((Severity::Critical, said))
    }

    /// Throws that gave no estimate, by the code of the reason.
    pub(super) fn refused(&self) -> BTreeMap<String, u64> {
        self.refused.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Default for Status {
    fn default() -> Self {
        Self::new()
    }
}

/// The sources of a status report.
#[derive(Clone)]
pub(super) struct Gauges {
    pub(super) status: Arc<Status>,
    pub(super) inbox: Arc<InboxCounters>,
    pub(super) outlet: Arc<OutletCounters>,
    pub(super) store: Store,
}

impl Gauges {
    pub(super) fn report(&self) -> StatusReport {
        let status = &self.status;
        StatusReport {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            uptime_s: clock::monotonic().duration_since(status.started).as_secs(),
            database: self.store.path().display().to_string(),
            disk: match self.store.disk_level() {
                DiskLevel::Ample => "ok",
                DiskLevel::Low => "low",
                DiskLevel::Full => "full",
                DiskLevel::Failing => "failing",
            }
            .to_owned(),
            wal_bytes: self.store.wal_bytes(),
            connected: status.connected.load(Relaxed),
            loggers: status.loggers.load(Relaxed),
            received: self.inbox.received.load(Relaxed) + status.backlog_received.load(Relaxed),
            dropped: self.inbox.dropped.load(Relaxed),
            ignored: status.ignored.load(Relaxed),
            backlog: status.backlog.load(Relaxed),
            stored: status.stored.load(Relaxed),
            duplicates: status.duplicates.load(Relaxed),
            quarantined: status.quarantined.load(Relaxed),
            lost: status.lost.load(Relaxed),
            machines_refused: status.machines_refused.count(),
            judged: status.judged.load(Relaxed),
            not_evaluated: status.not_evaluated.load(Relaxed),
            alarm_events: status.alarm_events.load(Relaxed),
            published: self.outlet.published.load(Relaxed),
            unpublished: self.outlet.dropped.load(Relaxed),
            silent: status.heartbeats.silent().into_iter().map(|task| task.as_ref().to_owned()).collect(),
            standing: status.standing.lock().unwrap_or_else(PoisonError::into_inner).clone(),
            windows: Vec::new(),
        }
    }
}

impl StatusReport {
    /// Whether the daemon itself has no trouble: disk, loops, lost messages.
    #[must_use]
    pub fn is_well(&self) -> bool {
        self.disk == "ok" && self.silent.is_empty() && self.dropped + self.lost == 0
    }

    /// One line for people: trouble first.
    #[must_use]
    pub fn line(&self) -> String {
        let mut parts = Vec::new();
        match self.disk.as_str() {
            "ok" => {}
            "low" => parts.push("DISK LOW: old traces are dropped".to_owned()),
            "full" => parts.push("DISK FULL: nothing can be stored, free some space".to_owned()),
            _ => parts.push("DATABASE FAILING: writes do not succeed".to_owned()),
        }
        if !self.silent.is_empty() {
            parts.push(format!("HANGING: {}", self.silent.join(", ")));
        }
        if !self.connected {
            parts.push("not connected".to_owned());
        }
        if self.dropped + self.lost > 0 {
            parts.push(format!("{} messages LOST", self.dropped + self.lost));
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
            parts.push(format!("{} ALARMS OF THE DAEMON ITSELF", self.standing.own_alarms));
        }
        if self.standing.shelved_alarms > 0 {
            parts.push(format!("{} alarms shelved", self.standing.shelved_alarms));
        }
        if self.backlog > 0 {
            parts.push(format!("{} throws are still in the backlogs of loggers", self.backlog));
        }
        parts.push(format!(
            "{} loggers, {} throws stored, {} judged ({} not evaluated), {} in quarantine",
            self.loggers, self.stored, self.judged, self.not_evaluated, self.quarantined
        ));
        parts.join("; ")
    }
}
