//! The monitor of a machine, with the effects of commands and ticks. The others are in [`throws`] and [`loggers`].

mod loggers;
mod throws;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::{
    AlarmEvent, Away, Blindness, Cause, Drifting, MachineState, Observation, Parameters, Present, Settings, Severity,
    alarm::{Actor, Alarms, Command, CommandError, Maintenance, Rule, Step},
    baseline::{BaselineRecord, Neutral},
    drift::{DriftAlarms, Instruments},
    gauges::{FeatureWatch, SideWatch, StartWatch},
    operation::{Boots, Common, LoggerClock, Operation, Thermometer, Trail, on_peers, site},
    snapshot::{Header, VersionOne},
    statistics::percent,
    text,
    track::Tracks,
};
use crate::throw::{Direction, ThrowRef};

/// The monitor of a machine: baselines, last throws, alarms. The snapshot has them all, so a restart changes nothing.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct MachineMonitor {
    version: Version,
    name: Box<str>,
    /// Number of observed throws.
    order: u64,
    tracks: Tracks,
    neutral: Neutral,
    drift: DriftAlarms,
    alarms: Alarms,
    operation: Operation,
    thermometer: Thermometer,
    clock: LoggerClock,
    boots: Boots,
    instruments: Instruments,
    features: FeatureWatch,
    start: StartWatch,
    /// The current at the end of the stroke.
    end: SideWatch,
    travel: SideWatch,
    /// The last departures from the baseline, for the diagnosis of the other machines of the site.
    trail: Trail,
    /// What the monitor could not show at the last evaluated throw; `None` if it could show every fault.
    blind: Option<Blindness>,
    maintenance: Option<Box<Maintenance>>,
    /// Time of the last new baseline by an operator, or of the last end of maintenance.
    in_service_since: Option<Timestamp>,
    /// Whether a throw with a toe position was observed since the last rebaseline.
    has_position: bool,
    /// Whether a throw without one was observed since then.
    had_no_position: bool,
    /// Consecutive throws with a toe position of a machine whose throws had none.
    fitted: u8,
    /// Parameters of the last identified throw.
    parameters: Option<Parameters>,
    /// The stored snapshot that this program could not read.
    #[serde(skip_serializing_if = "Option::is_none")]
    unread: Option<Box<str>>,
}

/// Version of a snapshot. The default is the version that this program writes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
struct Version(u32);

impl Default for Version {
    fn default() -> Self {
        Self(2)
    }
}

/// Consecutive throws with a toe position that start a new baseline of a machine without one: a single one may be that
/// of another machine.
const FITTED_IN_A_ROW: u8 = 5;

impl MachineMonitor {
    /// A monitor without throws; `name` is the name of the machine in texts.
    pub fn new(name: &str) -> Self {
        Self { name: name.into(), ..Self::default() }
    }

    /// A new monitor for a machine whose stored snapshot cannot be read, as after a return to an earlier version of the
    /// program. It keeps the text of the snapshot, for a version of the program that can read it.
    pub fn instead_of(unread: String, name: &str) -> Self {
        Self { unread: Some(unread.into()), ..Self::new(name) }
    }

    /// Replaces the name of the machine in later texts.
    #[must_use]
    pub fn named(self, name: String) -> Self {
        Self { name: name.into(), ..self }
    }

    /// Reads a snapshot (the monitor as JSON) of this or an earlier version of the program. A monitor made by
    /// [`Self::instead_of`] keeps an unreadable snapshot; if this program can read that one, returns it instead.
    ///
    /// # Errors
    /// When the text is not a snapshot, or has an unknown version.
    pub fn from_snapshot(json: &str) -> Result<Self, serde_json::Error> {
        let header: Header = serde_json::from_str(json)?;
        match header.version {
            None => serde_json::from_str::<VersionOne>(json).map(Self::from),
            Some(version) if Version(version) == Version::default() => {
                let monitor: Self = serde_json::from_str(json)?;
                let replaced = monitor.unread.as_ref().and_then(|unread| Self::from_snapshot(unread).ok());
                Ok(replaced.unwrap_or(monitor))
            }
            Some(other) => {
                let problem = format!("snapshot version {other} is from a newer program");
                Err(serde::de::Error::custom(problem))
            }
        }
    }

    /// Runs a rule with the operational counters; returns the new events.
    fn step(
        &mut self,
        at: Timestamp,
        throw: Option<&ThrowRef>,
        settings: &Settings,
        rule: impl FnOnce(&mut Operation, &mut Step),
    ) -> Vec<AlarmEvent> {
        let Self { operation, alarms, name, .. } = self;
        rule(operation, &mut Step { alarms, name, at: to_micros(at), throw, settings });
        self.alarms.take_events()
    }

    /// Advances the time: ends shelvings and maintenance windows, detects silence. Call it at least once a minute.
    /// Silence is the sum of the times between calls, each at most an hour, so that a jump of the clock is not silence.
    pub fn tick(&mut self, now: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        let now = to_micros(now);
        // Later times show that the clock was set back. Otherwise no throw would count until they are reached.
        let latest = now + settings.longest_shelving();
        self.alarms.unshelve_due(now, latest);
        let ends = self.maintenance.as_mut().map(|maintenance| {
            let until = maintenance.until.map_or(latest, |until| until.min(latest));
            *maintenance.until.insert(until)
        });
        if let Some(until) = ends.filter(|until| *until <= now) {
            self.end_maintenance(Actor::default(), until, now);
        }
        self.in_service_since = self.in_service_since.filter(|since| *since <= now);
        let (in_service, has_thrown) = (self.maintenance.is_none(), self.order > 0 || self.unread.is_some());
        self.step(now, None, settings, |operation, step| operation.on_tick(in_service, has_thrown, step))
    }

    /// Common change of machines with these monitors in the hours before `at`.
    pub fn common<'a>(machines: impl Iterator<Item = &'a Self>, at: Timestamp) -> Common {
        site::common(machines.map(|monitor| &monitor.trail), to_micros(at))
    }

    /// Raises or clears the alarms about a change that most machines of a site have in common, as by weather. Call it
    /// on the monitor of the site, not on the monitor of a machine, after [`Self::tick`].
    pub fn follow_site(&mut self, common: &Common, now: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        self.step(now, None, settings, |operation, step| operation.on_common(common, step))
    }

    /// Takes over an open alarm that no monitor has, as after the loss of a snapshot: an operator can acknowledge it.
    pub fn adopt(&mut self, last: AlarmEvent, now: Timestamp) -> Vec<AlarmEvent> {
        let text = text::orphaned(&self.name);
        self.alarms.adopt(last, text, to_micros(now));
        self.alarms.take_events()
    }

    /// Applies a failure of the daemon to store data; `None` without one. Only the monitor of the daemon itself has
    /// this alarm, which ends after ten minutes without a failure. Call it with each [`Self::tick`].
    pub fn trouble(
        &mut self,
        trouble: Option<(Severity, &str)>,
        now: Timestamp,
        settings: &Settings,
    ) -> Vec<AlarmEvent> {
        self.step(now, None, settings, |operation, step| operation.on_daemon_trouble(trouble, step))
    }

    /// Updates the alarm about watched daemons that are not reachable. Only the daemon's own monitor has this alarm.
    pub fn peers(&mut self, away: &Away, now: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        self.step(now, None, settings, |_, step| on_peers(away, step))
    }

    /// Clears the alarms whose latest event satisfies `which`.
    fn clear_all(&mut self, which: impl Fn(&AlarmEvent) -> bool, text: &str, now: Timestamp) {
        for cause in self.causes(which) {
            self.alarms.clear(cause, text.to_owned(), now);
        }
    }

    /// Causes of the open alarms whose latest event satisfies `which`.
    fn causes(&self, which: impl Fn(&AlarmEvent) -> bool) -> Vec<Cause> {
        self.alarms.events().filter(|event| which(event)).map(|event| event.cause).collect()
    }

    /// Applies the parameters with which the next throw was identified. Estimates with other parameters cannot be
    /// compared, so a change starts a new baseline; returns the command that does this. The verdict on the throw has
    /// the events.
    pub fn configured(&mut self, parameters: Parameters, now: Timestamp) -> Option<Command> {
        let before = self.parameters;
        self.parameters = Some(parameters.with_last_stroke(before));
        let changed = before?.changed(&parameters, self.has_position)?;
        let why = format!("the configuration of the machine changed: {changed}");
        let now = to_micros(now);
        // Earlier throws are estimated with the new parameters too, so they count: `in_service_since` stays.
        self.forget_boots(now);
        Some(self.rebaseline_by_itself(why, now))
    }

    /// Counts the throws with a toe position of a machine whose throws had none. Their durations end with the arrival of
    /// the toe, and not with the motor, so they cannot be compared with earlier ones: after five of them in a row a
    /// new baseline starts. Returns the command that does this. Call it before the throw is observed.
    pub fn fitted(&mut self, throw: &Observation) -> Option<Command> {
        if self.maintenance.is_some() || !throw.has_result() {
            return None;
        }
        self.fitted = if self.has_new_position(throw) { self.fitted.saturating_add(1) } else { 0 };
        (self.fitted >= FITTED_IN_A_ROW).then(|| {
            let why = "the throws have a toe position (position_mm) now, and had none before".to_owned();
            self.rebaseline_by_itself(why, to_micros(throw.started_at))
        })
    }

    /// Starts a new baseline, as the throws cannot be compared with the present one; returns the command that does this.
    fn rebaseline_by_itself(&mut self, why: String, now: Timestamp) -> Command {
        let by = "pointsd".to_owned();
        self.rebaseline(&by, &why, Actor { by: Some(&by), why: Some(&why) }, now);
        Command::Rebaseline { by, why }
    }

    /// Removes and returns the events since the last verdict, as those of [`Self::date`].
    pub fn take_events(&mut self) -> Vec<AlarmEvent> {
        self.alarms.take_events()
    }

    /// Applies an operator's command.
    ///
    /// # Errors
    /// When it cannot be applied; then nothing has changed.
    pub fn command(
        &mut self,
        command: &Command,
        now: Timestamp,
        settings: &Settings,
    ) -> Result<Vec<AlarmEvent>, CommandError> {
        let now = to_micros(now);
        command.validate(now, settings)?;
        let actor = Actor { by: Some(command.by()), why: command.why() };
        match command {
            Command::Ack { cause, by } => self.alarms.acknowledge(*cause, by, now)?,
            Command::Shelve { cause, until, .. } => self.alarms.shelve(*cause, to_micros(*until), actor, now)?,
            Command::Unshelve { cause, .. } => self.alarms.unshelve(*cause, actor, now)?,
            Command::Rebaseline { by, why } => {
                self.forget_boots(now);
                self.in_service_since = Some(now);
                self.rebaseline(by, why, actor, now);
                self.unread = None;
            }
            Command::Retire { by, why } => {
                // Maintenance would show the ended alarms as out of service.
                self.alarms.out_of_service = false;
                for cause in self.causes(|_| true) {
                    self.alarms.close(cause, text::retired(&self.name, by, why), actor, now);
                }
            }
            // A machine that is in maintenance gets the new window instead of the old one, as with a second shelving.
            Command::MaintenanceStart { until, .. } => {
                self.maintenance = Some(Box::new(Maintenance { until: Some(to_micros(*until)) }));
                self.alarms.set_out_of_service(true, actor, now);
            }
            Command::MaintenanceEnd { .. } if self.maintenance.is_none() => return Err(CommandError::NotInMaintenance),
            Command::MaintenanceEnd { .. } => self.end_maintenance(actor, now, now),
        }
        Ok(self.alarms.take_events())
    }

    fn rebaseline(&mut self, by: &str, why: &str, actor: Actor, now: Timestamp) {
        // These compare with the baseline, with the gauges' normal values or with earlier values of a sensor, which are
        // all learned anew.
        let compares = |event: &AlarmEvent| match event.cause {
            Cause::Sensor => self.alarms.owned_by(Rule::Dates).is_none(),
            Cause::NotMonitored => self.alarms.owned_by(Rule::Blind).is_some(),
            cause => cause.is_drift() || matches!(cause, Cause::Supply | Cause::SlowThrow),
        };
        for cause in self.causes(compares) {
            self.alarms.close(cause, text::rebaselined(&self.name, by, why), actor, now);
        }
        self.forget_recent(now);
        self.drift.conditions = Default::default();
        self.operation.forget_normal();
        self.thermometer = Thermometer::default();
        (self.has_position, self.had_no_position, self.fitted) = (false, false, 0);
        self.tracks = Tracks::default();
        self.neutral = Neutral::default();
        self.instruments = Instruments::default();
        self.trail = Trail::default();
    }

    /// Clears the alarms of rules that lose their last throws, and so could not clear them later.
    fn end_rules(&mut self, now: Timestamp) {
        let of_rules: Vec<Cause> = self.alarms.giving_way().collect();
        // Throws do not show whether the clock of the logger is right; their dates do.
        let sensor = self.alarms.owned_by(Rule::Dates).is_none().then_some(Cause::Sensor);
        for cause in sensor.into_iter().chain([Cause::Supply]).chain(of_rules) {
            self.alarms.clear(cause, text::machine(&self.name, text::CHECKED_ANEW), now);
        }
    }

    /// Throws made after `until` count. It is before `now` if the daemon was off when the window ended.
    fn end_maintenance(&mut self, actor: Actor, until: Timestamp, now: Timestamp) {
        self.maintenance = None;
        self.in_service_since = Some(until);
        self.alarms.set_out_of_service(false, actor, now);
        self.forget_recent(now);
        self.operation.reset();
        if self.alarms.rule(Cause::NotMonitored) == Some(Rule::Usual) {
            self.operation.wait_for_evaluated();
        }
    }

    /// Forgets the last throws, and keeps the baselines.
    fn forget_recent(&mut self, now: Timestamp) {
        self.tracks.forget_recent();
        self.instruments.forget_recent();
        self.features = FeatureWatch::default();
        self.start = StartWatch::default();
        self.end = SideWatch::default();
        self.travel = SideWatch::default();
        self.drift.reset();
        self.blind = None;
        self.end_rules(now);
    }

    /// The latest event of every open alarm (any state but `normal`), oldest alarm first.
    pub fn open_alarms(&self) -> Vec<&AlarmEvent> {
        self.alarms.events().collect()
    }

    /// The drifts with an active alarm whose present size is known; named parts first, then the most severe.
    pub fn drifts(&self) -> Vec<Drifting> {
        self.drift.now.iter().filter(|drifting| drifting.has_size()).copied().collect()
    }

    /// Sentences about limits of the monitoring at present, and about the faults that it cannot show.
    pub fn caveats(&self) -> Vec<String> {
        let blind = self.blind.as_ref().map(|blind| text::blind(&self.name, blind));
        let only_features = self.features.is_monitoring() && !self.tracks.any_baseline();
        // The alarm about a lost toe sensor says what is known of its machine.
        let had_coefficients = self.tracks.any_baseline() && !self.has_position;
        let unread = self.unread.as_ref().map(|_| text::machine(&self.name, text::UNREAD));
        unread
            .into_iter()
            .chain(self.two_loggers())
            .chain(blind)
            .chain(self.tracks.trend().map(|slopes| text::trend(&self.name, slopes, self.tracks.any_of_ratios())))
            .chain(self.drift.season_pct.map(|pct| text::season(&self.name, pct)))
            .chain(self.features.season_pct.map(|pct| text::season_of_features(&self.name, pct.into())))
            .chain(self.drift.shared_changes().map(|(cause, pct)| text::shared(&self.name, cause, pct)))
            .chain(self.instruments.known_gain.map(|gain| text::known_gain(&self.name, percent(gain.into()))))
            .chain(self.instruments.gauges.normal_rest_a().map(|amperes| text::at_rest(&self.name, amperes)))
            .chain(only_features.then(|| text::machine(&self.name, text::ONLY_FEATURES)))
            .chain(self.operation.is_contradicted().then(|| text::machine(&self.name, text::CONTRADICTED)))
            .chain(self.operation.is_exchanged().then(|| text::machine(&self.name, text::EXCHANGED)))
            .chain(self.operation.caveats(&self.name, self.alarms.is_active(Cause::Sensor), had_coefficients))
            .chain(self.neutral_elsewhere())
            .chain(self.small_travel_mm().map(|travel_mm| text::small_travel(&self.name, travel_mm)))
            .chain(self.tracks.lacks_scale().then(|| text::ratios_only(&self.name, self.tracks.any_of_ratios())))
            .collect()
    }

    /// The normal travel \[mm\] if it is implausibly small: points open by 50 mm and more.
    fn small_travel_mm(&self) -> Option<f64> {
        const SMALL_MM: f64 = 25.0;
        self.instruments.gauges.normal_travel_mm().filter(|travel_mm| *travel_mm < SMALL_MM)
    }

    /// A sentence about a neutral position that differs from the configured one.
    fn neutral_elsewhere(&self) -> Option<String> {
        let share = self.neutral.elsewhere(self.tracks.centres())?;
        let configured_mm = self.parameters.map_or(0.0, |parameters| parameters.neutral_mm);
        let is_corrected = matches!(self.neutral, Neutral::Elsewhere(_));
        let travel_mm = self.instruments.gauges.normal_travel_mm()?;
        Some(text::neutral(&self.name, configured_mm, f64::from(share) * travel_mm, is_corrected))
    }

    /// State, drifts and caveats, as published after every throw.
    pub fn present(&self) -> Present {
        Present { state: self.state(), drifts: self.drifts(), caveats: self.caveats() }
    }

    /// The state of the machine.
    pub fn state(&self) -> MachineState {
        if self.maintenance.is_some() {
            return MachineState::Maintenance;
        }
        let of_machine = |event: &&AlarmEvent| event.cause != Cause::NotMonitored;
        match self.alarms.active().filter(of_machine).map(|event| event.severity).max() {
            Some(Severity::Critical) => MachineState::Critical,
            _ if self.alarms.is_active(Cause::NotMonitored) => MachineState::NotMonitored,
            Some(Severity::Warning) => MachineState::Warning,
            None if self.tracks.any_baseline() || self.features.is_monitoring() => MachineState::Healthy,
            None => MachineState::Learning,
        }
    }

    /// Throws in the baseline of a direction, and throws that a complete baseline needs.
    pub fn baseline_progress(&self, direction: Direction, settings: &Settings) -> (usize, usize) {
        self.tracks.progress(direction, settings)
    }

    /// Throws in the baseline of each direction, and throws that a complete baseline needs. `None` if both are
    /// complete, or for a machine that is monitored by its features only.
    pub fn learning(&self, settings: &Settings) -> Option<[(usize, usize); 2]> {
        let progress = Direction::BOTH.map(|direction| self.baseline_progress(direction, settings));
        let by_features = self.features.is_monitoring() && !self.tracks.any_baseline();
        let is_learning = progress.iter().any(|(throws, needed)| throws < needed);
        (is_learning && !by_features).then_some(progress)
    }

    /// The baseline in use for a direction.
    pub fn baseline(&self, direction: Direction) -> Option<BaselineRecord> {
        self.tracks.record(direction).map(|record| self.neutral.as_estimated(record))
    }

    /// Evaluated throws of a direction since its baseline was taken.
    pub fn throws_since_baseline(&self, direction: Direction) -> u64 {
        self.tracks.since_baseline(direction)
    }
}

impl From<VersionOne> for MachineMonitor {
    fn from(old: VersionOne) -> Self {
        let alarms = Alarms::from(old.board);
        let conditions = std::array::from_fn(|at| old.conditions[at].now(alarms.is_active(Cause::DRIFTS[at])));
        let mut tracks = old.tracks;
        tracks.add_temperature();
        Self {
            order: old.order,
            tracks,
            drift: DriftAlarms { history: old.history, onset: old.onset, conditions, ..DriftAlarms::default() },
            alarms,
            operation: old.operation,
            maintenance: old.maintenance,
            ..Self::new(&old.name)
        }
    }
}

/// Rounds to microseconds as in the database, so that the identity of an alarm does not change there.
fn to_micros(at: Timestamp) -> Timestamp {
    Timestamp::from_microsecond(at.as_microsecond()).unwrap_or(at)
}
