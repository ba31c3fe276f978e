//! The judge loop. It is the only owner of the monitors, so operators' commands, ticks and alarms about the daemon go
//! through it too.

use std::{
    collections::{HashMap, VecDeque},
    future,
    sync::Arc,
    time::{Duration, Instant},
};

use jiff::SignedDuration;
use tokio::{
    sync::{broadcast, mpsc},
    time,
};

use super::{
    Batch, Judge, budget::Budget, commands::PendingCommand, daemon_alarms::PendingDaemonAlarm, monitors::TICK,
};
use crate::{
    bus::Outlet,
    daemon::{
        clock,
        config::Config,
        shared::Shared,
        supervision::{heartbeat::TaskName, peers::Peers, status::NAMED},
    },
    diagnose::{Away, Irregularity, MachineMonitor, Missing},
    store::{Gap, Judgement, Outcome, StoreError, seldom},
    throw::MachineId,
    wire::{self, Alarm, Kind},
};

/// Largest number of changed monitors in one transaction.
const CHANGES: usize = 64;
/// Largest number of gaps in one query, so that it takes some tens of milliseconds. The monitor adds up the gaps of
/// several reports.
const GAPS: u32 = 500;
/// Time for which the status lists a machine without a valid throw after its last quarantined message. A machine whose
/// logger has a token stays in the list, as far as the quarantine has its messages.
const REFUSED_FOR: SignedDuration = SignedDuration::from_hours(1);
/// Longest time between two reads of the quarantine for this list. It is also read at a tick after a new message, and
/// while the list has a machine.
const REFUSED_EVERY: Duration = Duration::from_mins(1);
/// Pause after an error of the database.
const PAUSE: Duration = Duration::from_millis(500);
/// Time after which a daemon alarm that cannot be committed is published uncommitted. Usually the store can write again
/// earlier, after it removed its ballast file or reconnected. A longer silence would look like health.
const LONGEST_SILENCE: Duration = Duration::from_secs(10);

/// Channels and handles to the other tasks of the daemon.
pub(crate) struct Links {
    pub(crate) outlet: Outlet,
    pub(crate) watchers: broadcast::Sender<Arc<[Judgement]>>,
    pub(crate) commands: mpsc::Receiver<PendingCommand>,
    pub(crate) peers: Peers,
}

pub(crate) struct JudgeLoop {
    pub(super) shared: Arc<Shared>,
    pub(super) judge: Judge,
    links: Links,
    /// The name of the daemon in the form of a machine's, for alarms about the daemon itself.
    pub(super) own_machine: MachineId,
    /// Watched daemons that were away at the last tick, and whether this daemon itself had a link.
    away: Option<(Vec<MachineId>, bool)>,
    /// Number of quarantined messages, and time, when the quarantine was last read for the list of refused machines.
    refused_read: Option<(u64, Instant)>,
    /// Unstored alarm events about the daemon itself: at most two of each alarm, its raise and its last event.
    daemon_alarms: VecDeque<PendingDaemonAlarm>,
    /// Rate limit of commands.
    pub(super) budget: Budget,
}

impl JudgeLoop {
    pub(crate) fn new(shared: Arc<Shared>, judge: Judge, links: Links) -> Self {
        Self {
            own_machine: shared.config.monitor.as_machine(),
            shared,
            judge,
            links,
            away: None,
            refused_read: None,
            daemon_alarms: VecDeque::new(),
            budget: Budget::new(clock::monotonic()),
        }
    }

    /// Runs until its stop signal, then judges the throws that are still pending.
    pub(crate) async fn run(mut self) -> Result<(), StoreError> {
        // An error is no reason to end: the daemon can work without this list.
        let adopted = self.judge.adopt(&self.own_machine).await.unwrap_or_else(|error| {
            tracing::warn!(%error, "the open alarms cannot be read; those without a monitor stay open");
            Vec::new()
        });
        for adopted in adopted.chunks(CHANGES) {
            self.record_all(adopted.into()).await?;
        }
        let mut tick = clock::every(TICK);
        let mut beat = clock::every(Duration::from_secs(1));
        let mut may_be_pending = true;
        loop {
            self.shared.status.heartbeats.beat(TaskName::Identify);
            // One batch at a time, so that a long queue of throws does not delay commands and ticks.
            tokio::select! {
                () = self.shared.stops.judge.cancelled() => {
                    while !self.shared.stops.give_up.is_cancelled() && self.judge_next().await? {}
                    return Ok(());
                }
                Some(pending) = self.links.commands.recv() => self.answer_command(pending).await?,
                _ = tick.tick() => self.on_tick().await?,
                () = future::ready(()), if may_be_pending => may_be_pending = self.judge_next().await?,
                () = self.shared.stored.notified() => may_be_pending = true,
                _ = beat.tick() => may_be_pending = true,
            }
        }
    }

    /// Judges and stores the next batch; returns whether further throws may be pending.
    async fn judge_next(&mut self) -> Result<bool, StoreError> {
        if !self.daemon_alarms.is_empty() {
            self.update_daemon_alarms().await?;
        }
        let Batch { throws, may_be_followed } = match self.judge.pending().await {
            Ok(batch) if batch.throws.is_empty() => return Ok(false),
            Ok(batch) => batch,
            Err(StoreError::Closed) => return Err(StoreError::Closed),
            Err(error) => {
                seldom!(error, %error, "reading pending throws failed; retrying");
                self.pause().await;
                return Ok(false);
            }
        };
        // After the throws are read, so that their monitors know every gap before them. A throw without a gap before it
        // shows that no data was lost.
        self.report_gaps().await?;
        let judgements = self.judge.judge(&throws).await;
        self.shared.status.heartbeats.beat(TaskName::Identify);
        match self.until_judged(&judgements).await {
            Ok(true) => self.publish(judgements),
            Ok(false) => {}
            Err(StoreError::Refused(_)) => self.judge_one_by_one(&judgements).await?,
            Err(error) => return Err(error),
        }
        Ok(may_be_followed)
    }

    /// Stores the judgements of a batch that the database rejects, each in its own transaction. If the database rejects
    /// a judgement again, its throw is stored as not evaluated. A retry would fail for ever, and block all later
    /// throws.
    async fn judge_one_by_one(&mut self, judgements: &[Judgement]) -> Result<(), StoreError> {
        for judgement in judgements {
            let Some(problem) = self.refusal(judgement.clone()).await? else { continue };
            let (machine, throw_no) = (&judgement.health.machine, judgement.health.throw.throw_no);
            seldom!(error, %machine, throw_no, problem, "the database rejects a judgement: the throw is stored as not evaluated");
            self.judge.monitors.store_again(machine);
            let [with_events, alone] = judgement.instead(&problem);
            let Some(problem) = self.refusal(with_events).await? else { continue };
            self.log_lost(&judgement.outcome, &problem);
            if let Some(problem) = self.refusal(alone).await? {
                seldom!(error, %machine, throw_no, problem, "the database rejects every judgement of a throw; retrying");
                self.pause().await;
            }
        }
        Ok(())
    }

    /// Stores and publishes a single judgement; returns the reason if the database rejects it.
    async fn refusal(&mut self, judgement: Judgement) -> Result<Option<String>, StoreError> {
        let alone: Arc<[Judgement]> = Arc::new([judgement]);
        match self.until_judged(&alone).await {
            Ok(true) => self.publish(alone),
            Ok(false) => {}
            Err(StoreError::Refused(problem)) => return Ok(Some(problem)),
            Err(error) => return Err(error),
        }
        Ok(None)
    }

    async fn until_judged(&mut self, judgements: &Arc<[Judgement]>) -> Result<bool, StoreError> {
        let store = self.judge.store.clone();
        self.until_stored("judgements", || store.judge_all(Arc::clone(judgements))).await
    }

    /// Repeats a write until it is stored, or the database rejects it. Returns false if the daemon must end before. The
    /// next start then continues with the older monitors of the database.
    async fn until_stored<W: Future<Output = Result<(), StoreError>>>(
        &mut self,
        what: &str,
        write: impl Fn() -> W,
    ) -> Result<bool, StoreError> {
        loop {
            self.shared.status.heartbeats.beat(TaskName::Identify);
            match write().await {
                Ok(()) => return Ok(true),
                Err(error @ (StoreError::Closed | StoreError::Refused(_))) => return Err(error),
                Err(error) => seldom!(warn, %error, what, "storing failed; retrying"),
            }
            // The call below may store a newer monitor of the daemon, which the retry then replaces by an older one.
            self.judge.monitors.store_again(&self.own_machine);
            self.update_daemon_alarms().await?;
            if self.shared.stops.give_up.is_cancelled() {
                return Ok(false);
            }
            self.pause().await;
        }
    }

    /// Stores an outcome and notifies the publisher of its events; returns whether it is stored.
    pub(super) async fn record(&mut self, outcome: Outcome) -> Result<bool, StoreError> {
        self.record_all(Arc::new([outcome])).await
    }

    /// Stores outcomes in one transaction, like [`Self::record`].
    async fn record_all(&mut self, outcomes: Arc<[Outcome]>) -> Result<bool, StoreError> {
        let store = self.judge.store.clone();
        let write = || store.record_all(Arc::clone(&outcomes));
        match self.until_stored("changes of monitors", write).await {
            Ok(stored) => {
                outcomes.iter().filter(|_| stored).for_each(|outcome| self.announce(outcome));
                Ok(stored)
            }
            Err(StoreError::Refused(_)) if outcomes.len() > 1 => {
                let mut stored = true;
                for outcome in &*outcomes {
                    stored &= Box::pin(self.record(outcome.clone())).await?;
                }
                Ok(stored)
            }
            Err(StoreError::Refused(problem)) => {
                outcomes.iter().for_each(|outcome| self.log_lost(outcome, &problem));
                Ok(false)
            }
            Err(error) => Err(error),
        }
    }

    fn publish(&self, judgements: Arc<[Judgement]>) {
        let status = &self.shared.status;
        for Judgement { health, outcome, .. } in &*judgements {
            status.edit().judged += 1;
            if health.is_rejected() {
                status.count_rejected(&health.quality);
            }
            self.links.outlet.health(wire::machine_key(&health.machine, Kind::Health), wire::json_bytes(health));
            self.announce(outcome);
        }
        // Fails without observers.
        let _ = self.links.watchers.send(judgements);
    }

    fn announce(&self, Outcome { machine, events, .. }: &Outcome) {
        for event in events {
            tracing::warn!(%machine, cause = event.cause.as_str(), state = event.state.as_str(), "{}", event.text);
        }
        if !events.is_empty() {
            self.shared.status.edit().alarm_events += events.len() as u64;
            self.shared.outbox.notify_one();
            self.shared.webhook.notify_one();
        }
    }

    /// The periodic work. The alarms about the daemon itself come first, as the other steps wait while the database
    /// accepts no writes. The time of the monitors is advanced before the other alarms, which depend on whether a
    /// shelving or a maintenance has ended. The report is last, as it shows the result.
    async fn on_tick(&mut self) -> Result<(), StoreError> {
        self.update_daemon_alarms().await?;
        self.advance_monitors().await?;
        self.report_gaps().await?;
        self.report_invalid_messages().await?;
        self.update_peer_alarm().await?;
        self.update_refused().await;
        self.update_report();
        Ok(())
    }

    async fn advance_monitors(&mut self) -> Result<(), StoreError> {
        let (config, now) = (self.judge.config(), clock::now());
        // A copy: the callback of zenoh that changes the set must not wait for a tick of a large fleet.
        let loggers = self.shared.loggers.borrow().clone();
        let changed = self.judge.monitors.tick(now, &config.diagnosis, &loggers, |machine| is_served(&config, machine));
        for changed in changed.chunks(CHANGES) {
            let outcome = |(machine, events): &(_, Vec<_>)| self.judge.monitors.outcome(machine, now, events.clone());
            self.record_all(changed.iter().map(outcome).collect()).await?;
        }
        Ok(())
    }

    /// Reports consecutive invalid messages to the monitors of their machines. A machine without a monitor, as after
    /// `retire`, is in the list of refused machines.
    async fn report_invalid_messages(&mut self) -> Result<(), StoreError> {
        let (config, now) = (self.judge.config(), clock::now());
        for (machine, (count, reason)) in self.shared.status.invalid_in_a_row() {
            if !is_judged(&self.judge, &config, &machine) {
                continue;
            }
            let invalid = Irregularity::Invalid { count, reason: &reason };
            let report = |monitor: &mut MachineMonitor| monitor.irregular(invalid, None, now, &config.diagnosis);
            if let Some(outcome) = self.judge.monitors.update(&machine, now, report) {
                self.record(outcome).await?;
            }
        }
        Ok(())
    }

    /// Updates the alarm about watched daemons that are not reachable, if they changed.
    async fn update_peer_alarm(&mut self) -> Result<(), StoreError> {
        let Some(daemons) = self.links.peers.away() else { return Ok(()) };
        let away = Away { daemons, has_link: self.shared.status.edit().connected };
        // Without the times, which are computed anew and differ by microseconds.
        let names = (away.daemons.iter().map(|(name, _)| name.clone()).collect(), away.has_link);
        if self.away.as_ref() == Some(&names) {
            return Ok(());
        }
        let (config, now) = (self.judge.config(), clock::now());
        let update = |monitor: &mut MachineMonitor| monitor.peers(&away, now, &config.diagnosis);
        let outcome = self.judge.monitors.update(&self.own_machine, now, update);
        self.away = Some(names);
        if let Some(outcome) = outcome {
            self.record(outcome).await?;
        }
        Ok(())
    }

    /// Reports gaps that no backlog will fill to the monitors.
    async fn report_gaps(&mut self) -> Result<(), StoreError> {
        let (config, now) = (self.judge.config(), clock::now());
        let read = self.judge.store.reader().unreported_gaps(GAPS, now, self.judge.backlog_wait()).await;
        let read = read.unwrap_or_else(|error| {
            seldom!(warn, %error, "reading gaps failed; retrying");
            Vec::new()
        });
        let mut of_machines = HashMap::<_, Vec<_>>::new();
        for gap in read {
            of_machines.entry(gap.machine.clone()).or_default().push(gap);
        }
        for (machine, gaps) in of_machines {
            let told = |reported_gaps: Vec<Gap>| Outcome {
                machine: machine.clone(),
                at: now,
                monitor: None,
                events: Vec::new(),
                reported_gaps,
                command: None,
            };
            if !is_served(&config, &machine) {
                // Another daemon serves the machine now, and may have these throws.
                self.record(told(gaps)).await?;
                continue;
            }
            let reason = gaps.iter().rev().find_map(|gap| gap.reason.as_deref()).unwrap_or_default();
            let mut missing = Missing { reason, ..Missing::default() };
            for gap in &gaps {
                let throws = (gap.last_no - gap.first_no + 1).min(Missing::MOST);
                missing.throws = missing.throws.saturating_add(throws);
                missing.refused += gap.refused.min(throws);
            }
            let outcome = self.judge.monitors.report_gap(&machine, missing, now, &config.diagnosis);
            let is_recorded = self.record(Outcome { reported_gaps: gaps.clone(), ..outcome }).await?;
            // A report that the database rejects would be repeated at each tick, and would add up the same throws.
            if !is_recorded && !self.shared.stops.give_up.is_cancelled() {
                self.judge.monitors.store_again(&machine);
                self.record(told(gaps)).await?;
            }
        }
        Ok(())
    }

    /// Lists the machines of which every message since their last throw or `retire` is in quarantine, and that are not
    /// judged: those with the most messages first. A logger need not have a token. Without one its machine is listed for some time only, as any sender can invent machines.
    async fn update_refused(&mut self) {
        let Shared { config, status, loggers, .. } = &*self.shared;
        let quarantined = status.edit().quarantined;
        let is_same = |(count, at): (u64, Instant)| count == quarantined && at.elapsed() < REFUSED_EVERY;
        if self.refused_read.is_some_and(is_same) && status.edit().refused.is_empty() {
            return;
        }
        let rows = match self.judge.store.reader().last_refused().await {
            Ok(rows) => rows,
            Err(error) => return seldom!(warn, %error, "reading the quarantine failed; retrying"),
        };
        self.refused_read = Some((quarantined, clock::monotonic()));
        let earliest_us = (clock::now() - REFUSED_FOR).as_microsecond();
        let loggers = loggers.borrow();
        let refused = rows.into_iter().filter_map(|(key, reason, at_us)| {
            let (machine, _) = wire::parse_key(&key).ok()?;
            let is_listed = is_served(config, &machine)
                && !is_judged(&self.judge, config, &machine)
                && (at_us > earliest_us || loggers.alive.contains(&machine));
            is_listed.then(|| format!("{machine} ({reason})"))
        });
        status.edit().refused = refused.take(NAMED).collect();
    }

    pub(super) fn update_report(&mut self) {
        let fleet_counts = self.judge.monitors.fleet_counts(&self.own_machine);
        let loggers = self.shared.loggers.borrow().alive.clone();
        let silent = loggers.iter().filter(|machine| !self.judge.monitors.knows(machine));
        let mut without_throw: Vec<String> = silent.map(ToString::to_string).collect();
        without_throw.sort_unstable();
        without_throw.truncate(NAMED);
        let mut status = self.shared.status.edit();
        status.loggers_ahead = self.judge.monitors.clocks.ahead();
        status.loggers_behind = self.judge.monitors.clocks.behind();
        (status.fleet_counts, status.without_throw) = (fleet_counts, without_throw);
    }

    /// Raises and clears the alarms about the daemon itself. If the database accepts no writes, such an alarm is
    /// published before it is committed, and again afterwards.
    async fn update_daemon_alarms(&mut self) -> Result<(), StoreError> {
        // The write before this one may have waited for as long as the one below.
        self.shared.status.heartbeats.beat(TaskName::Identify);
        let (config, now) = (self.judge.config(), clock::now());
        let trouble = self.judge.store.trouble(self.shared.status.trouble(config.subscribe.max_machines));
        let text = trouble.as_ref().map(|(severity, text)| (*severity, text.as_str()));
        let update = |monitor: &mut MachineMonitor| monitor.trouble(text, now, &config.diagnosis);
        let new = self.judge.monitors.update(&self.own_machine, now, update);
        let raised = clock::monotonic();
        if let Some(outcome) = new {
            PendingDaemonAlarm { outcome, raised, published: false }.queue(&mut self.daemon_alarms);
        }
        while let Some(alarm) = self.daemon_alarms.pop_front() {
            match self.judge.store.record(alarm.outcome.clone()).await {
                Ok(()) => self.announce(&alarm.outcome),
                Err(StoreError::Closed) => return Err(StoreError::Closed),
                Err(StoreError::Refused(problem)) => self.log_lost(&alarm.outcome, &problem),
                Err(_) => {
                    self.daemon_alarms.push_front(alarm);
                    self.publish_uncommitted().await;
                    break;
                }
            }
        }
        let published = self.daemon_alarms.iter().filter(|alarm| alarm.published).map(|alarm| &alarm.outcome);
        let uncommitted = published
            .flat_map(|Outcome { machine, events, .. }| events.iter().map(move |event| Alarm::new(machine, event)));
        let uncommitted: Vec<Alarm> = uncommitted.collect();
        let has_uncommitted = !uncommitted.is_empty();
        self.shared.status.set_uncommitted(uncommitted);
        if has_uncommitted {
            self.shared.webhook.notify_one();
        }
        Ok(())
    }

    async fn publish_uncommitted(&mut self) {
        let overdue = |alarm: &PendingDaemonAlarm| !alarm.published && alarm.raised.elapsed() >= LONGEST_SILENCE;
        for alarm in self.daemon_alarms.iter_mut().filter(|alarm| overdue(alarm)) {
            alarm.published = true;
            let Outcome { machine, events, .. } = &alarm.outcome;
            for event in events {
                let (cause, text) = (event.cause, &event.text);
                tracing::error!(%machine, %cause, "an alarm cannot be stored yet, and is published uncommitted: {text}");
                let key = wire::machine_key(machine, Kind::Alarm);
                let message = Alarm::new(machine, event).into_message();
                // If the publication fails, the alarm is at least in the log.
                let _ = time::timeout(PAUSE, self.links.outlet.alarm(key, message)).await;
            }
        }
    }

    /// Logs an outcome that the database rejects, and logs and counts its alarm events.
    fn log_lost(&self, Outcome { machine, events, .. }: &Outcome, problem: &str) {
        seldom!(error, %machine, problem, "the database rejects the change of a monitor: it is LOST");
        for event in events {
            tracing::error!(%machine, problem, "an alarm event is LOST: {}", event.text);
        }
        if !events.is_empty() {
            self.shared.status.alarm_events_lost.add(events.len() as u64);
        }
    }

    async fn pause(&self) {
        tokio::select! {
            () = time::sleep(PAUSE) => {}
            () = self.shared.stops.give_up.cancelled() => {}
        }
    }
}

/// Whether this daemon serves a machine. `subscribe.key` need not include the names of the daemon and of its sites.
fn is_served(config: &Config, machine: &MachineId) -> bool {
    config.subscribe.serves(machine) || config.monitor.reserves(machine).is_some()
}

/// Whether throws of a machine are judged. A monitor with a reserved name is that of the daemon or of a site.
fn is_judged(judge: &Judge, config: &Config, machine: &MachineId) -> bool {
    judge.monitors.knows(machine) && config.monitor.reserves(machine).is_none()
}
