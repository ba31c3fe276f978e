//! The monitors of all machines. Turns their changes into outcomes, which the judge loop stores. Does no I/O.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    mem,
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};

use jiff::Timestamp;

use super::{
    health::{OUTDATED, TWO_LOGGERS, health, observation, repeated},
    logger_clocks::{LoggerClocks, OwnClock},
};
use crate::{
    daemon::supervision::{presence::Tokens, status::FleetCounts},
    diagnose::{
        AlarmEvent, AlarmState, Command, Common, Irregularity, MachineMonitor, Missing, Parameters, Settings, Verdict,
    },
    estimate::{Identification, Rejection},
    store::{ALL_MACHINES, Judgement, MonitorRecord, Outcome, StoredMonitor, StoredThrow},
    throw::{MachineId, Name, ThrowRef},
    wire::{Alarm, Health, json},
};

/// Time between two ticks of the monitors, which need at least one tick a minute.
pub(super) const TICK: Duration = Duration::from_secs(5);
const TICKS_AN_HOUR: u64 = 3600 / TICK.as_secs();

/// The name that sorts before every other valid name.
const SMALLEST_NAME: &str = "-";

/// Settings and time of a judgement, and its place in the transaction.
#[derive(Clone, Copy)]
pub(crate) struct JudgementContext<'a> {
    /// Whether the throw is the last of its machine in the transaction. Only this throw stores the monitor.
    pub(super) is_last: bool,
    pub(crate) settings: &'a Settings,
    pub(crate) parameters: Parameters,
    pub(crate) at: Timestamp,
}

/// The monitors of all machines.
#[derive(Default)]
pub(crate) struct Monitors {
    /// Sorted, so that the machines of a site are neighbours. Boxed, as up to half of the slots in a B-tree are empty.
    of_machines: BTreeMap<MachineId, Box<MachineMonitor>>,
    /// Machines whose stored monitor may differ from the monitor in memory. They are stored again at the next tick.
    to_store: HashSet<MachineId>,
    /// The last loss of its token that each monitor knows. A loss is applied once: the logger may go on without a token,
    /// and must not be announced again.
    gone_before: HashMap<MachineId, Instant>,
    /// Number of ticks since the start, modulo [`TICKS_AN_HOUR`].
    ticks: u64,
    /// Comparison of this computer's clock with those of the loggers.
    pub(crate) clocks: LoggerClocks,
}

impl Monitors {
    /// Restores monitors from the database. If a snapshot cannot be read, as after a return to an earlier version, the
    /// machine gets a new monitor, which keeps the text of the snapshot and has a caveat about it. `is_reserved`: whether
    /// a name is that of the daemon or of a site, whose monitors have no throws and get their alarms from the database.
    pub(crate) fn restore(&mut self, stored: Vec<StoredMonitor>, is_reserved: impl Fn(&MachineId) -> bool) {
        for StoredMonitor { machine, snapshot, state } in stored {
            let name = name_of(&machine);
            let monitor = match MachineMonitor::from_snapshot(&snapshot) {
                // Named again, as an earlier version stored the name without the site.
                Ok(monitor) => monitor.named(name),
                Err(error) => {
                    tracing::error!(%machine, %error, "the stored monitor cannot be read: learning a new baseline");
                    self.to_store.insert(machine.clone());
                    if is_reserved(&machine) {
                        MachineMonitor::new(&name)
                    } else {
                        MachineMonitor::instead_of(snapshot, &name)
                    }
                }
            };
            if state != Some(monitor.state()) {
                self.to_store.insert(machine.clone());
            }
            self.of_machines.insert(machine, Box::new(monitor));
        }
    }

    /// Counts the machines in each state, their shelved alarms, and the open alarms about the daemon itself.
    pub(crate) fn fleet_counts(&self, own_machine: &MachineId) -> FleetCounts {
        let own_alarms = self.of_machines.get(own_machine).map_or(0, |monitor| monitor.open_alarms().len() as u64);
        let mut counts = FleetCounts { own_alarms, ..FleetCounts::default() };
        for (machine, monitor) in self.of_machines.iter().filter(|(machine, _)| *machine != own_machine) {
            if machine.machine.as_str() != ALL_MACHINES {
                *counts.machines.entry(monitor.state()).or_default() += 1;
            }
            let shelved = monitor.open_alarms().iter().filter(|alarm| alarm.state == AlarmState::Shelved).count();
            counts.shelved_alarms += shelved as u64;
        }
        counts
    }

    /// Whether a machine has a monitor. It gets one with its first throw.
    pub(crate) fn knows(&self, machine: &MachineId) -> bool {
        self.of_machines.contains_key(machine)
    }

    /// Whether the logger of a machine may send throws later whose age will be unknown. Also a connected logger may, as
    /// one that waits for its recorder.
    pub(crate) fn may_send_undated(&self, machine: &MachineId) -> bool {
        self.of_machines.get(machine).is_some_and(|monitor| !monitor.dates_a_backlog())
    }

    fn monitor(&mut self, machine: &MachineId) -> &mut MachineMonitor {
        self.of_machines.entry(machine.clone()).or_insert_with(|| Box::new(MachineMonitor::new(&name_of(machine))))
    }

    /// At the start, adopts or ends the alarms that nothing else would ever clear. Adds the `open` alarms that no monitor
    /// has, as after the loss of a snapshot, to the monitors of their machines. Retires the `former` names of the daemon.
    pub(crate) fn adopt(
        &mut self,
        open: Vec<Alarm>,
        former: &[MachineId],
        own_machine: &MachineId,
        now: Timestamp,
        settings: &Settings,
    ) -> Vec<Outcome> {
        let mut outcomes = Vec::new();
        for Alarm { machine, event, .. } in open {
            let monitor = self.monitor(&machine);
            let is_own = |own: &&AlarmEvent| own.cause == event.cause && own.raised_at == event.raised_at;
            if !monitor.open_alarms().iter().any(is_own) {
                let events = monitor.adopt(event, now);
                outcomes.push(outcome(&machine, Some(monitor), now, events));
            }
        }
        let why = format!("the daemon has the name {own_machine} now");
        let retire = Command::Retire { by: "pointsd".to_owned(), why };
        let retired = former.iter().filter_map(|name| self.apply_command(name, &retire, now, settings).ok());
        outcomes.extend(retired.map(|(outcome, _)| outcome));
        outcomes
    }

    /// The machines of which nothing of a logger was ever received: usually former names of the daemon, from before a
    /// change of `monitor.site` or `monitor.id`.
    pub(crate) fn without_logger(&self, own_machine: &MachineId) -> Vec<MachineId> {
        let is_other = |machine: &MachineId| machine != own_machine && machine.machine.as_str() != ALL_MACHINES;
        let others = self.of_machines.iter().filter(|(machine, monitor)| is_other(machine) && monitor.has_no_logger());
        others.map(|(machine, _)| machine.clone()).collect()
    }

    /// Diagnoses a throw; returns the judgement to store. A throw that makes the diagnosis panic counts as not
    /// evaluated: the defect must not stop the judgement of all other machines, again after each restart. The diagnosis
    /// is repeated without the estimate, so that the monitor counts the throw. After a second panic the throw is unknown
    /// to the monitor.
    pub(crate) fn judge(
        &mut self,
        stored: &StoredThrow,
        identification: Option<Identification>,
        context: JudgementContext,
    ) -> Judgement {
        let before = self.of_machines.get(&stored.machine).cloned();
        for identification in [identification, None] {
            let attempt = AssertUnwindSafe(|| self.diagnose(stored, identification, context));
            if let Ok(judgement) = catch_unwind(attempt) {
                return judgement;
            }
            let ThrowRef { boot_id, throw_no } = &stored.id;
            tracing::error!(machine = %stored.machine, boot_id, throw_no, "the diagnosis failed on this throw: please report it");
            // The panic may have left the monitor half changed. The clocks are not restored: a throw that is noted twice
            // changes them once.
            match &before {
                Some(before) => self.of_machines.insert(stored.machine.clone(), before.clone()),
                None => self.of_machines.remove(&stored.machine),
            };
        }
        // The monitor may have changes by earlier throws of this transaction, which no other judgement stores.
        self.store_again(&stored.machine);
        Judgement {
            row: stored.row,
            // The state is left out, as the monitor may panic again when it derives its state.
            health: Health { state: None, ..health(stored, None, None, &Verdict::default(), None, 0) },
            identification: None,
            baselines: Vec::new(),
            outcome: outcome(&stored.machine, None, context.at, Vec::new()),
        }
    }

    fn diagnose(
        &mut self,
        stored: &StoredThrow,
        identification: Option<Identification>,
        JudgementContext { is_last, settings, parameters, at }: JudgementContext,
    ) -> Judgement {
        // A repeated trace is not evidence, neither of health nor of a drift.
        let is_evidence = |found: &Identification| matches!(found.outcome, Ok(_) | Err(Rejection::NoPosition { .. }));
        let repeats = stored.repeats && identification.as_ref().is_some_and(is_evidence);
        let received_at = self.trusted_reception(stored);
        let is_behind = self.clocks.is_last_behind();
        let monitor = self.monitor(&stored.machine);
        let dated = monitor.date(&stored.id, stored.started_at, received_at, is_behind, settings);
        // The store puts throws with a repeated number into a boot of their own, which is no boot of the logger.
        let boot_at = received_at.filter(|_| !stored.renumbered);
        let boot = monitor.boot(&stored.id, stored.started_at, boot_at, dated.at, settings);
        let withheld = boot.two_loggers.map(|sentence| (TWO_LOGGERS, sentence)).or_else(|| repeats.then(repeated));
        let identification = identification.filter(|_| withheld.is_none());
        let mut observation = observation(stored, identification.as_ref());
        observation.started_at = dated.at;
        let common = self.common(&stored.machine.site, Some(&stored.machine), observation.started_at);
        let monitor = self.monitor(&stored.machine);
        let fitted = if dated.is_outdated { None } else { monitor.fitted(&observation) };
        let command = monitor.configured(parameters, observation.started_at).or(boot.command).or(fitted);
        if let Some(Command::Rebaseline { why, .. }) = &command {
            tracing::warn!(machine = %stored.machine, "learning a new baseline: {why}");
        }
        let mut verdict = if dated.is_outdated {
            monitor.observe_outdated(&observation, settings)
        } else {
            monitor.observe_beside(&observation, &common, settings)
        };
        let repeated_trace = repeats.then_some(Irregularity::RepeatedTrace);
        let repeated_number = stored.renumbered.then_some(Irregularity::RepeatedNumber);
        for irregularity in repeated_trace.into_iter().chain(repeated_number) {
            let events = monitor.irregular(irregularity, Some(&stored.id), observation.started_at, settings);
            verdict.events.extend(events);
            verdict.present.state = monitor.state();
        }
        let since_baseline = observation.direction.map_or(0, |direction| monitor.throws_since_baseline(direction));
        let events = mem::take(&mut verdict.events);
        let outcome = Outcome { command, ..outcome(&stored.machine, is_last.then_some(&*monitor), at, events) };
        // Only for throws without changes of the coefficients: their health has the changes of the ratios.
        let baseline = match (observation.direction, verdict.change_pct) {
            (Some(direction), None) => monitor.baseline(direction),
            _ => None,
        };
        let mut health = health(stored, identification.as_ref(), withheld, &verdict, baseline.as_ref(), since_baseline);
        if dated.is_outdated {
            health.detail.get_or_insert_with(|| OUTDATED.to_owned());
        }
        Judgement { row: stored.row, health, identification, baselines: verdict.baselines_taken, outcome }
    }

    /// Time of reception of a throw; `None` if the clock of this computer is not trusted. This clock is not trusted
    /// while it is behind the clocks of most loggers, as after a loss of power without a time server. If no other
    /// logger has sent a throw since the start, it is trusted only if the fleet has no other logger.
    fn trusted_reception(&mut self, stored: &StoredThrow) -> Option<Timestamp> {
        let has_other = |machine: &MachineId| *machine != stored.machine && machine.machine.as_str() != ALL_MACHINES;
        let is_alone = || {
            let mut loggers = self.of_machines.iter().filter(|(_, monitor)| !monitor.has_no_logger());
            !loggers.any(|(machine, _)| has_other(machine))
        };
        let is_trusted = match self.clocks.note(&stored.machine, stored.started_at, stored.received_at) {
            OwnClock::Plausible => true,
            OwnClock::Behind => false,
            OwnClock::Unconfirmed => is_alone(),
        };
        is_trusted.then_some(stored.received_at)
    }

    /// Advances the time of every monitor, and updates it with the liveliness tokens. Returns the machines to store,
    /// with their events. Each monitor is stored at least once an hour, as it counts the time without a throw. The state
    /// and the alarms of a machine that the daemon does not serve stay as they are: another daemon may publish its alarms.
    /// The alarms of the sites go on.
    pub(crate) fn tick(
        &mut self,
        now: Timestamp,
        settings: &Settings,
        loggers: &Tokens,
        is_served: impl Fn(&MachineId) -> bool,
    ) -> Vec<(MachineId, Vec<AlarmEvent>)> {
        let mut changed = Vec::new();
        self.ticks = (self.ticks + 1) % TICKS_AN_HOUR;
        let served = self.of_machines.iter_mut().filter(|(machine, _)| is_served(machine));
        for (index, (machine, monitor)) in served.enumerate() {
            let before = (monitor.is_announced(), monitor.state());
            let mut events = Vec::new();
            let gone_at = loggers.gone.get(machine);
            if gone_at != self.gone_before.get(machine) {
                self.gone_before.extend(gone_at.map(|at| (machine.clone(), *at)));
                if !monitor.is_announced() && gone_at.is_some() {
                    events.extend(monitor.logger(true, now, settings));
                }
            }
            events.extend(monitor.logger(loggers.alive.contains(machine), now, settings));
            events.extend(monitor.tick(now, settings));
            // The first token of a logger is stored at once, so that its loss is detected after a restart too.
            let changes = before != (monitor.is_announced(), monitor.state()) || !events.is_empty();
            if index as u64 % TICKS_AN_HOUR == self.ticks || changes || self.to_store.contains(machine) {
                changed.push((machine.clone(), events));
            }
        }
        self.to_store.clear();
        self.gone_before.retain(|machine, _| loggers.gone.contains_key(machine));
        let mut sites: Vec<&Name> = self.of_machines.keys().map(|machine| &machine.site).collect();
        sites.dedup();
        for site in sites.into_iter().cloned().collect::<Vec<_>>() {
            let common = self.common(&site, None, now);
            changed.extend(self.update_site_alarm(&site, &common, now, settings));
        }
        changed
    }

    /// The outcome with the present monitor of a machine and new events.
    pub(crate) fn outcome(&self, machine: &MachineId, at: Timestamp, events: Vec<AlarmEvent>) -> Outcome {
        outcome(machine, self.of_machines.get(machine).map(Box::as_ref), at, events)
    }

    /// Stores the monitor of a machine at the next tick even if it does not change.
    pub(super) fn store_again(&mut self, machine: &MachineId) {
        self.to_store.insert(machine.clone());
    }

    /// The common change of the machines of a site, `except` for one of them.
    fn common(&self, site: &Name, except: Option<&MachineId>, at: Timestamp) -> Common {
        let first = MachineId { site: site.clone(), machine: Name::fixed(SMALLEST_NAME) };
        let of_site = self.of_machines.range(first..).take_while(|(machine, _)| machine.site == *site);
        let others = of_site.filter(|(machine, _)| Some(*machine) != except).map(|(_, monitor)| &**monitor);
        MachineMonitor::common(others, at)
    }

    /// Updates the alarm of a site, under the machine name [`ALL_MACHINES`].
    fn update_site_alarm(
        &mut self,
        site: &Name,
        common: &Common,
        now: Timestamp,
        settings: &Settings,
    ) -> Option<(MachineId, Vec<AlarmEvent>)> {
        let id = MachineId { site: site.clone(), machine: Name::fixed(ALL_MACHINES) };
        if !common.is_change() && !self.of_machines.contains_key(&id) {
            return None;
        }
        let events = self.monitor(&id).follow_site(common, now, settings);
        (!events.is_empty()).then_some((id, events))
    }

    /// Applies a change that may raise events, and returns the outcome to store; `None` without an event. A machine
    /// without a monitor then has none afterwards.
    pub(super) fn update(
        &mut self,
        machine: &MachineId,
        now: Timestamp,
        change: impl FnOnce(&mut MachineMonitor) -> Vec<AlarmEvent>,
    ) -> Option<Outcome> {
        let is_new = !self.knows(machine);
        let events = change(self.monitor(machine));
        if events.is_empty() {
            if is_new {
                self.of_machines.remove(machine);
            }
            return None;
        }
        Some(self.outcome(machine, now, events))
    }

    /// Reports missing throws to the monitor of a machine.
    pub(super) fn report_gap(
        &mut self,
        machine: &MachineId,
        missing: Missing,
        at: Timestamp,
        settings: &Settings,
    ) -> Outcome {
        let monitor = self.monitor(machine);
        let events = monitor.gap(missing, at, settings);
        outcome(machine, Some(monitor), at, events)
    }

    /// Applies an operator's command. Returns the outcome to store and a confirmation for the operator, or the reason
    /// for a refusal. The command `retire` removes the monitor.
    pub(super) fn apply_command(
        &mut self,
        machine: &MachineId,
        command: &Command,
        now: Timestamp,
        settings: &Settings,
    ) -> Result<(Outcome, String), String> {
        let unknown = || format!("no machine {machine} is known here: it has sent no throw yet, or was retired");
        let monitor = self.of_machines.get_mut(machine).ok_or_else(unknown)?;
        let confirmation = command.confirmation(machine, monitor.learning(settings));
        let events = monitor.command(command, now, settings).map_err(|error| error.to_string())?;
        let confirmation = confirmation + &command.consequence(&events);
        if matches!(command, Command::Retire { .. }) {
            self.of_machines.remove(machine);
        }
        Ok((Outcome { command: Some(command.clone()), ..self.outcome(machine, now, events) }, confirmation))
    }
}

/// The name of a machine in alarm texts. It includes the site, as a text may be read alone.
fn name_of(id: &MachineId) -> String {
    if id.machine.as_str() == ALL_MACHINES { format!("All machines of {}", id.site) } else { id.to_string() }
}

/// The outcome with new events, and with the present monitor if it is to be stored.
fn outcome(machine: &MachineId, monitor: Option<&MachineMonitor>, at: Timestamp, events: Vec<AlarmEvent>) -> Outcome {
    let record = monitor.map(|monitor| MonitorRecord { snapshot: json(monitor), present: monitor.present() });
    Outcome { machine: machine.clone(), at, monitor: record, events, reported_gaps: Vec::new(), command: None }
}

#[cfg(test)]
mod tests {
    use jiff::SignedDuration;

    use super::*;
    use crate::{
        daemon::clock,
        diagnose::{MachineState, Severity},
        estimate,
        store::ThrowRow,
        throw::{Throw, Trace},
    };

    /// A throw without a movement.
    fn still_throw(machine: &MachineId, throw_no: u64) -> StoredThrow {
        let id = ThrowRef { boot_id: "boot".to_owned(), throw_no };
        let at = Timestamp::UNIX_EPOCH;
        let throw =
            Throw { id: id.clone(), ..Throw::recorded(Trace::new(1000.0, vec![0.0; 9], vec![0.0; 9]).unwrap()) };
        StoredThrow {
            row: ThrowRow::START,
            machine: machine.clone(),
            id,
            started_at: at,
            received_at: at,
            throw: Ok(throw),
            repeats: false,
            renumbered: false,
        }
    }

    fn context(settings: &Settings) -> JudgementContext<'_> {
        let parameters = Parameters::of(&estimate::Settings::default());
        JudgementContext { is_last: true, settings, parameters, at: Timestamp::UNIX_EPOCH }
    }

    #[test]
    fn a_throw_that_makes_the_diagnosis_panic_twice_changes_no_monitor() {
        let (machine, settings) = (MachineId::new("north", "21B").unwrap(), Settings::default());
        // The counter of its throws is at its end, so the next one makes the diagnosis panic, with or without estimate.
        let full = format!("\"order\":{}", u64::MAX);
        let snapshot = json(&MachineMonitor::new("north/21B")).replace("\"order\":0", &full);
        assert!(snapshot.contains(&full));
        let mut monitors = Monitors::default();
        monitors.restore(
            vec![StoredMonitor {
                machine: machine.clone(),
                snapshot: snapshot.clone(),
                state: Some(MachineState::Learning),
            }],
            |_| false,
        );
        let judgement = monitors.judge(&still_throw(&machine, 1), None, context(&settings));
        assert_eq!((&*judgement.health.quality, judgement.outcome.monitor), ("estimator_failed", None));
        assert_eq!(monitors.of_machines.get(&machine).map(json), Some(snapshot));
        assert!(monitors.to_store.contains(&machine));
    }

    /// A gap may be reported before the first throw of a machine is judged.
    #[test]
    fn only_a_former_name_of_the_daemon_loses_its_alarms_at_the_start() {
        let (settings, now) = (Settings::default(), Timestamp::UNIX_EPOCH);
        let [own, former, machine] = ["pointsd", "old", "21B"].map(|name| MachineId::new("north", name).unwrap());
        let mut monitors = Monitors::default();
        let full = |monitor: &mut MachineMonitor| monitor.trouble(Some((Severity::Critical, "full")), now, &settings);
        for daemon in [&own, &former] {
            assert!(monitors.update(daemon, now, full).is_some());
        }
        let gap = Missing { throws: 3, ..Missing::default() };
        assert_eq!(monitors.report_gap(&machine, gap, now, &settings).events.len(), 1);
        let ended = |changed: Vec<(MachineId, Vec<AlarmEvent>)>| {
            changed.into_iter().filter(|(_, events)| !events.is_empty()).map(|(machine, _)| machine).collect::<Vec<_>>()
        };
        assert_eq!(ended(monitors.tick(now, &settings, &Tokens::default(), |_| true)), []);
        let without = monitors.without_logger(&own);
        assert!(matches!(&without[..], [only] if *only == former), "{without:?}");
        let adopted = monitors.adopt(Vec::new(), &without, &own, now, &settings);
        let [Outcome { machine: name, monitor: None, command: Some(Command::Retire { .. }), events, .. }] =
            &adopted[..]
        else {
            panic!("{adopted:?}")
        };
        assert!(*name == former && events.len() == 1 && !monitors.knows(&former), "{adopted:?}");
    }

    #[test]
    fn a_logger_that_goes_on_without_its_token_is_not_announced_again() {
        let (machine, settings) = (MachineId::new("north", "21B").unwrap(), Settings::default());
        let (mut monitors, mut loggers, mut now) = (Monitors::default(), Tokens::default(), Timestamp::UNIX_EPOCH);
        loggers.gone.insert(machine.clone(), clock::monotonic());
        let is_announced = |monitors: &Monitors| monitors.of_machines[&machine].is_announced();
        monitors.judge(&still_throw(&machine, 1), None, context(&settings));
        let is_raised = (0..1000).any(|_| {
            let changed = monitors.tick(now, &settings, &loggers, |_| true);
            assert!(is_announced(&monitors));
            now += SignedDuration::from_secs(30);
            changed.iter().any(|(_, events)| !events.is_empty())
        });
        assert!(is_raised);
        monitors.judge(&still_throw(&machine, 2), None, context(&settings));
        monitors.tick(now, &settings, &loggers, |_| true);
        assert!(!is_announced(&monitors));
        // It connects and disconnects between two ticks.
        loggers.gone.insert(machine.clone(), clock::monotonic());
        monitors.tick(now, &settings, &loggers, |_| true);
        assert!(is_announced(&monitors));
    }

    #[test]
    fn a_monitor_that_cannot_be_read_is_kept() {
        let machine = MachineId::new("north", "21B").unwrap();
        let written = json(&MachineMonitor::new("north/21B").named("21B".to_owned()));
        let newer = written.replacen("\"version\":2", "\"version\":3", 1);
        assert_ne!(newer, written);
        let mut monitors = Monitors::default();
        let stored = |snapshot| vec![StoredMonitor { machine: machine.clone(), snapshot, state: None }];
        monitors.restore(stored(newer.clone()), |_| false);
        let record = monitors.outcome(&machine, Timestamp::UNIX_EPOCH, Vec::new()).monitor.unwrap();
        let caveats = &record.present.caveats;
        assert!(caveats.iter().any(|caveat| caveat.contains("cannot read")), "{caveats:?}");
        // This version stands for the newer one, which must be able to read the text that was kept.
        let again =
            MachineMonitor::from_snapshot(&record.snapshot.replace("\\\"version\\\":3", "\\\"version\\\":2")).unwrap();
        assert_eq!(json(&again), written);
        let again = MachineMonitor::from_snapshot(&record.snapshot).unwrap();
        assert_eq!(json(&again), record.snapshot);
        // The monitor of the daemon would wait for a throw for ever.
        monitors.restore(stored(newer), |_| true);
        assert_eq!(json(&*monitors.of_machines[&machine]), json(&MachineMonitor::new(&name_of(&machine))));
    }
}
