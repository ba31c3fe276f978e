//! The status of the daemon: counters and states, as JSON and as a line of text.

use std::{
    collections::{BTreeMap, HashMap},
    sync::{Arc, atomic::Ordering::Relaxed},
};

use parking_lot::{Mutex, MutexGuard};
use serde::{Deserialize, Serialize};

use super::heartbeat::Heartbeats;
use crate::{
    bus::{InboxCounters, OutletCounters},
    diagnose::{AlarmState, MachineState, Severity},
    store::{DiskLevel, RecentCount, Store, StoreError, WORST_FIRST, Window, seldom},
    throw::{MachineId, counted},
    wire::Alarm,
};

/// Number of consecutive invalid messages of a machine that raises an alarm; a few may be accidents.
const INVALID_IN_A_ROW: u32 = 5;
/// Largest number of machines in each list of the status: loggers without a throw, machines without a valid message,
/// machines outside `subscribe.key`.
pub(crate) const NAMED: usize = 20;

/// Counters and states that all loops share.
#[derive(Debug, Default)]
pub(crate) struct Status {
    pub heartbeats: Heartbeats,
    pub inbox: Arc<InboxCounters>,
    pub outlet: Arc<OutletCounters>,
    /// The values that the loops write; [`Self::report`] adds the others.
    report: Mutex<StatusReport>,
    /// Number of rejected throws by the code of the reason.
    rejected: Mutex<BTreeMap<String, u64>>,
    /// Invalid messages of the known machines, those with a stored throw.
    invalid: Mutex<HashMap<MachineId, InvalidMessages>>,
    /// Alarms about the daemon itself that are published and that the database cannot store yet.
    uncommitted: Mutex<Vec<Alarm>>,
    /// Messages dropped from the queue, at the last call of [`Status::store_losses`].
    dropped: RecentCount,
    /// Messages lost, at the same call.
    lost: RecentCount,
    /// Numbers of dropped and of lost messages in the counters of the database.
    stored_losses: Mutex<[u64; 2]>,
    pub(crate) machines_refused: RecentCount,
    pub(crate) alarm_events_lost: RecentCount,
}

/// Invalid messages of a machine since its last valid throw.
#[derive(Debug, Default)]
struct InvalidMessages {
    count: u32,
    last_reason: String,
}

/// Number of machines in each state, and of shelved alarms.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct FleetCounts {
    /// Number of machines in each state; states without machines are left out.
    pub machines: BTreeMap<MachineState, u64>,
    /// Number of shelved alarms.
    pub shelved_alarms: u64,
    /// Number of open alarms about the daemon itself: disk, database, refused data.
    #[serde(default)]
    pub own_alarms: u64,
}

impl FleetCounts {
    /// Number of machines in a state.
    pub fn count(&self, state: MachineState) -> u64 {
        self.machines.get(&state).copied().unwrap_or(0)
    }

    /// Whether every machine is healthy or learning, no alarm is shelved, and no alarm about the daemon itself is open.
    pub fn is_well(&self) -> bool {
        self.machines.keys().all(|state| state.is_well()) && self.shelved_alarms + self.own_alarms == 0
    }
}

/// The status, as in `pointsd status --json`. A daemon of an earlier version does not send all fields.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct StatusReport {
    /// Program version.
    pub version: String,
    /// Time since the start \[s\].
    pub uptime_s: u64,
    /// The key expression of its machines: `subscribe.key`.
    pub key: String,
    /// The database file.
    pub database: String,
    /// State of the disk of the database.
    pub disk: DiskLevel,
    /// Whether the database is being copied to a new file, because another program keeps reading an old state of it.
    /// Writes wait meanwhile.
    pub copying: bool,
    /// Size of the write-ahead log \[bytes\].
    pub wal_bytes: u64,
    /// Whether the zenoh session has a link to another session.
    pub connected: bool,
    /// Number of loggers that have a liveliness token now.
    pub loggers: usize,
    /// Machines whose loggers are connected and have sent no throw yet; at most 20.
    pub without_throw: Vec<String>,
    /// Machines of which every message so far, or since `retire`, went to quarantine, with the last reason; at most 20.
    pub refused: Vec<String>,
    /// Machines of the database that `subscribe.key` does not include, at the start; at most 20. Their states and alarms
    /// stay as they were, and no command reaches them.
    pub not_served: Vec<String>,
    /// Number of loggers, of the last 32, that date their throws a day or more after this computer; 0 if they are not
    /// the majority, or a single logger.
    pub loggers_ahead: usize,
    /// The same for a day or more before this computer, all by the same time.
    pub loggers_behind: usize,
    /// Messages received.
    pub received: u64,
    /// Messages dropped because the queue of received messages was full, or its share for their key. The daemon queries
    /// the logger of a known machine for them, if it has a backlog.
    pub dropped: u64,
    /// Replies of loggers that do not match the query for a backlog.
    pub ignored: u64,
    /// Missing throws that may be in the backlogs of their loggers.
    #[serde(alias = "behind")]
    pub backlog: u64,
    /// Throws stored.
    pub stored: u64,
    /// Repeated messages: throws that are stored already, and messages from backlogs that are in quarantine already.
    pub duplicates: u64,
    /// Messages in quarantine since the start.
    pub quarantined: u64,
    /// Received messages that could not be stored, since the start.
    pub lost: u64,
    /// Live throws of new machines that went to quarantine because `subscribe.max_machines` was reached.
    pub machines_refused: u64,
    /// Throws identified and diagnosed.
    pub judged: u64,
    /// Judged throws that were rejected, so that no estimate of them was evaluated.
    pub not_evaluated: u64,
    /// Alarm events since the start.
    pub alarm_events: u64,
    /// Alarm events that the database rejected, since the start.
    pub alarm_events_lost: u64,
    /// Published messages.
    pub published: u64,
    /// Health messages dropped because the publishing queue was full.
    pub unpublished: u64,
    /// Whether the receiver of the webhook did not accept the last message yet, and it is sent again.
    pub webhook_fails: bool,
    /// Alarm events that the webhook refused.
    pub webhook_refused: u64,
    /// Names of the loops without a fresh heartbeat.
    pub silent: Vec<String>,
    /// States of the machines: `machines` and `shelved_alarms` in JSON.
    #[serde(flatten)]
    pub fleet_counts: FleetCounts,
    /// Open maintenance windows and shelvings; only in the reply to a `status` query.
    pub windows: Vec<Window>,
}

impl Status {
    /// The values that the loops write. They are locked until the returned guard is dropped. The messages received are
    /// those from backlogs, as the inbox counts the others.
    pub(crate) fn edit(&self) -> MutexGuard<'_, StatusReport> {
        self.report.lock()
    }

    /// Counts a rejected throw under the code of its reason.
    pub(crate) fn count_rejected(&self, reason: &str) {
        self.edit().not_evaluated += 1;
        *self.rejected.lock().entry(reason.to_owned()).or_default() += 1;
    }

    /// Counts a message of a known machine that is no valid throw. Messages of others are in quarantine only, as any
    /// sender can invent names.
    pub(crate) fn count_invalid(&self, machine: MachineId, reason: &str) {
        let mut invalid = self.invalid.lock();
        let messages = invalid.entry(machine).or_default();
        messages.count = messages.count.saturating_add(1);
        reason.clone_into(&mut messages.last_reason);
    }

    /// Resets the count of invalid messages of a machine, after a valid throw.
    pub(crate) fn count_valid(&self, machine: &MachineId) {
        self.invalid.lock().remove(machine);
    }

    /// Takes the machines with at least [`INVALID_IN_A_ROW`] invalid messages since their last valid throw or since
    /// they were taken last, with the number of messages and the last reason.
    pub(crate) fn invalid_in_a_row(&self) -> Vec<(MachineId, (u32, String))> {
        let mut invalid = self.invalid.lock();
        let taken = invalid.extract_if(|_, messages| messages.count >= INVALID_IN_A_ROW);
        taken.map(|(machine, messages)| (machine, (messages.count, messages.last_reason))).collect()
    }

    /// Sentences about refused machines, and about lost alarm events and messages, for the alarm about the daemon itself.
    pub(crate) fn trouble(&self, max_machines: usize) -> Vec<(Severity, String)> {
        let refused = self.machines_refused.shown().map(|refused| {
            format!(
                "throws of new machines refused: {refused}. As many machines are known as subscribe.max_machines allows: \
                 {max_machines}. The view quarantined_messages shows the senders"
            )
        });
        // Without a number: each new number would be a new alarm event, which the database may reject too.
        let lost = self.alarm_events_lost.shown().map(|_| {
            "the database rejects alarm events. Their texts are in the log; restore the schema of the database"
                .to_owned()
        });
        // Numbers of dropped and lost messages grow fast, so their text changes at each power of two.
        let at_least = |count: &RecentCount| {
            count.shown().and_then(u64::checked_ilog2).map(|power| counted(1 << power, "message"))
        };
        let lost_messages = at_least(&self.lost).map(|at_least| {
            format!("at least {at_least} could not be stored since the start. Look in the log, and check the disk")
        });
        let dropped_messages = at_least(&self.dropped).map(|at_least| {
            let text = format!(
                "at least {at_least} dropped since the start, as more arrived than could be stored. The throws are fetched \
                 from the backlogs of the loggers where possible. The log names the keys"
            );
            (Severity::Warning, text)
        });
        let critical = refused.into_iter().chain(lost).chain(lost_messages).map(|text| (Severity::Critical, text));
        critical.chain(dropped_messages).collect()
    }

    pub(crate) fn set_uncommitted(&self, alarms: Vec<Alarm>) {
        *self.uncommitted.lock() = alarms;
    }

    /// The open alarms, from those of the database: an uncommitted event replaces the stored one of its alarm.
    pub(crate) fn with_uncommitted(&self, mut stored: Vec<Alarm>) -> Vec<Alarm> {
        for alarm in &*self.uncommitted.lock() {
            stored.retain(|stored| stored.alarm_id != alarm.alarm_id);
            stored.extend((alarm.state != AlarmState::Normal).then(|| alarm.clone()));
        }
        stored
    }

    /// Number of rejected throws by the code of the reason.
    pub(crate) fn rejected(&self) -> BTreeMap<String, u64> {
        self.rejected.lock().clone()
    }

    pub(crate) fn report(&self, store: &Store) -> StatusReport {
        let copying = store.is_copying();
        let written = self.edit().clone();
        StatusReport {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            uptime_s: self.heartbeats.uptime().as_secs(),
            database: store.path().display().to_string(),
            disk: store.disk_level(),
            copying,
            wal_bytes: store.wal_bytes(),
            received: self.inbox.received.load(Relaxed) + written.received,
            dropped: self.inbox.dropped.load(Relaxed),
            machines_refused: self.machines_refused.count(),
            alarm_events_lost: self.alarm_events_lost.count(),
            published: self.outlet.published.load(Relaxed),
            unpublished: self.outlet.dropped.load(Relaxed),
            silent: self.heartbeats.silent(copying).into_iter().map(|task| task.as_ref().to_owned()).collect(),
            ..written
        }
    }

    /// Adds the messages that were dropped or lost since the last call to the counters of the database. A probe changes
    /// a row in any case.
    pub(crate) async fn store_losses(&self, store: &Store, is_probe: bool) -> Result<(), StoreError> {
        let now = [self.inbox.dropped.load(Relaxed), self.edit().lost];
        for (counter, now) in [&self.dropped, &self.lost].into_iter().zip(now) {
            if now > counter.count() {
                counter.add(now - counter.count());
            }
        }
        let before = *self.stored_losses.lock();
        let [dropped, lost] = [0, 1].map(|at| now[at].saturating_sub(before[at]));
        store.count_losses(dropped, lost, is_probe).await?;
        *self.stored_losses.lock() = now;
        Ok(())
    }

    /// The report with the open windows: the reply to a query.
    pub(crate) async fn answer(&self, store: &Store) -> StatusReport {
        let mut report = self.report(store);
        match store.reader().windows(None).await {
            Ok(windows) => report.windows = windows,
            // The rest of the status is most important when the database does not answer.
            Err(error) => seldom!(warn, %error, "the database does not answer: status without maintenance windows"),
        }
        report
    }
}

impl StatusReport {
    /// Problems of the daemon itself: disk, loops, clock, webhook, lost or refused messages. The dashboard shows the
    /// same sentences.
    pub fn problems(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let mut add = |is_so: bool, problem: &str| problems.extend(is_so.then(|| problem.to_owned()));
        add(self.disk == DiskLevel::Low, "DISK LOW: traces of judged throws are dropped, free some space");
        add(self.disk == DiskLevel::Full, "DISK FULL: nothing can be stored, free some space");
        add(self.disk == DiskLevel::Failing, "DATABASE FAILING: writes do not succeed");
        add(self.copying, "COPYING THE DATABASE to a new file: writes wait");
        add(!self.silent.is_empty(), &format!("HANGING: {}", self.silent.join(", ")));
        add(self.loggers_ahead > 0, "CLOCK BEHIND: most loggers date their throws a day or more after this computer");
        add(
            self.loggers_behind > 0,
            "CLOCK AHEAD: most loggers date their throws a day or more before this computer, all by the same time",
        );
        add(!self.refused.is_empty(), &format!("EVERY MESSAGE REFUSED: {}", self.refused.join("; ")));
        let not_served = self.not_served.join(", ");
        add(
            !self.not_served.is_empty(),
            &format!(
                "NOT SERVED: {not_served}: in the database, but not in subscribe.key, so their states and alarms are old"
            ),
        );
        add(self.webhook_fails, "WEBHOOK FAILS: alarms wait for its receiver");
        let refused = counted(self.webhook_refused, "alarm event");
        add(self.webhook_refused > 0, &format!("WEBHOOK REFUSED {refused}: not sent again, look in the log"));
        let rejected = counted(self.alarm_events_lost, "alarm event");
        add(self.alarm_events_lost > 0, &format!("{rejected} LOST: the database rejects them, look in the log"));
        let dropped = counted(self.dropped, "message");
        add(
            self.dropped > 0,
            &format!(
                "{dropped} DROPPED: more arrived than could be stored; throws are fetched from backlogs where possible"
            ),
        );
        let lost = counted(self.lost, "message");
        add(self.lost > 0, &format!("{lost} LOST: received and not stored"));
        problems
    }

    /// The status as one line of text, problems first.
    pub fn line(&self) -> String {
        self.parts().join("; ")
    }

    /// The parts of [`Self::line`]: each problem, then the counts.
    pub fn parts(&self) -> Vec<String> {
        let mut parts = self.problems();
        let states: Vec<String> = WORST_FIRST
            .into_iter()
            .filter(|state| !state.is_well())
            .map(|state| (self.fleet_counts.count(state), state.as_str().replace('_', " ")))
            .filter(|(count, _)| *count > 0)
            .map(|(count, state)| format!("{count} {state}"))
            .collect();
        let FleetCounts { own_alarms, shelved_alarms, .. } = self.fleet_counts;
        let mut add = |is_so: bool, part: String| parts.extend(is_so.then_some(part));
        add(!self.connected, "not connected".to_owned());
        add(!states.is_empty(), format!("machines: {}", states.join(", ")));
        add(own_alarms > 0, format!("{} OF THE DAEMON ITSELF", counted(own_alarms, "alarm").to_uppercase()));
        add(shelved_alarms > 0, format!("{} shelved", counted(shelved_alarms, "alarm")));
        let without_throw = self.without_throw.join(", ");
        add(!without_throw.is_empty(), format!("connected, but no throw yet: {without_throw}"));
        let are = if self.backlog == 1 { "is" } else { "are" };
        let missing = counted(self.backlog, "throw");
        add(self.backlog > 0, format!("{missing} {are} still in the backlogs of loggers"));
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
