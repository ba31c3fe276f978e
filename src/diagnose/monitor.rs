//! The monitor of a machine, with the effects of throws, commands and ticks.

use jiff::Timestamp;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{
    alarm::{Actor, Alarms},
    baseline::BaselineRecord,
    cause::Known,
    command::{Command, CommandError},
    drift_alarms::{DRIFTS, DriftAlarms, Onset},
    event::{AlarmEvent, Cause, SensorChannel, Severity},
    explain::percent,
    features::FeatureWatch,
    instruments::Instruments,
    observation::{Evaluated, Irregularity, Observation, Parameters},
    operational::{self, Context, Operation},
    settings::Settings,
    site::{self, Common, Trail},
    snapshot::VersionOne,
    text,
    thermometer::{Disbelief, Thermometer},
    track::Tracks,
    verdict::{Blindness, Drifting, HidingTemperature, MachineState, Verdict},
};
use crate::{
    estimate::Features,
    throw::{Direction, POSSIBLE_SUPPLY_V, ThrowRef},
};

/// A maintenance window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Maintenance {
    /// End of the window. `None` only in snapshots of version 1, which allowed windows without end; the next tick sets
    /// it.
    until: Option<Timestamp>,
    by: String,
    why: String,
}

/// The monitor of a machine: baselines, last throws, alarms. The snapshot is complete, so a restart changes nothing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MachineMonitor {
    /// Version of the snapshot.
    version: u32,
    name: String,
    /// Number of observed throws.
    order: u64,
    tracks: Tracks,
    drift: DriftAlarms,
    alarms: Alarms,
    operation: Operation,
    #[serde(default)]
    thermometer: Thermometer,
    #[serde(default)]
    instruments: Instruments,
    #[serde(default)]
    features: FeatureWatch,
    /// The last departures, for the judgement of the other machines of the site.
    #[serde(default)]
    trail: Trail,
    /// Blindness at the last evaluated throw.
    #[serde(default)]
    blind: Option<Blindness>,
    maintenance: Option<Box<Maintenance>>,
    /// Whether an estimate with a toe position was observed since the last rebaseline.
    #[serde(default)]
    has_position: bool,
    /// Parameters of the last identified throw.
    #[serde(default)]
    parameters: Option<Parameters>,
    /// The stored snapshot that this program could not read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    unread: Option<String>,
}

impl MachineMonitor {
    /// Version of written snapshots.
    const VERSION: u32 = 2;

    /// A monitor without throws; `name` is the name of the machine in texts.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self {
            version: Self::VERSION,
            name: name.to_owned(),
            order: 0,
            tracks: Tracks::default(),
            drift: DriftAlarms::default(),
            alarms: Alarms::default(),
            operation: Operation::default(),
            thermometer: Thermometer::default(),
            instruments: Instruments::default(),
            features: FeatureWatch::default(),
            trail: Trail::default(),
            blind: None,
            maintenance: None,
            has_position: false,
            parameters: None,
            unread: None,
        }
    }

    /// A monitor in the place of one whose snapshot cannot be read, as after a return to an earlier version of the
    /// program. It keeps this text, for a version that can.
    #[must_use]
    pub fn instead_of(unread: String, name: &str) -> Self {
        Self { unread: Some(unread), ..Self::new(name) }
    }

    /// Replaces the name of the machine in later texts.
    #[must_use]
    pub fn named(self, name: String) -> Self {
        Self { name, ..self }
    }

    /// Reads a snapshot (the monitor as JSON) of this or an earlier version of the program. Of a monitor in the place of
    /// another, it is that other one, if it can be read now.
    ///
    /// # Errors
    /// When the text is not a snapshot, or has an unknown version.
    pub fn from_snapshot(json: &str) -> Result<Self, serde_json::Error> {
        #[derive(Deserialize)]
        struct Stamp {
            version: Option<u32>,
        }
        match serde_json::from_str(json)? {
            Stamp { version: None } => serde_json::from_str::<VersionOne>(json).map(Self::from),
            Stamp { version: Some(Self::VERSION) } => {
                let monitor: Self = serde_json::from_str(json)?;
                let replaced = monitor.unread.as_ref().and_then(|unread| Self::from_snapshot(unread).ok());
                Ok(replaced.unwrap_or(monitor))
            }
            Stamp { version: Some(other) } => {
                let problem = format!("snapshot version {other} is from a newer program");
                Err(serde::de::Error::custom(problem))
            }
        }
    }

    /// Applies a throw, evaluated or not. Throws must come in the order in which the machine made them.
    pub fn observe(&mut self, observation: &Observation, settings: &Settings) -> Verdict {
        self.observe_beside(observation, &Common::default(), settings)
    }

    /// Observes a throw like [`Self::observe`], without the change `common` of the other machines of the site.
    pub fn observe_beside(&mut self, observation: &Observation, common: &Common, settings: &Settings) -> Verdict {
        self.order += 1;
        let at = to_micros(observation.started_at);
        let temperature = self.thermometer.read(observation.temperature_c, at);
        // Without its toe sensor a machine is not what its baseline describes.
        let without_position = self.has_position && observation.is_without_position();
        self.has_position |= observation.estimate.is_some() && !observation.is_without_position();
        let mut evaluated = Evaluated::of(observation)
            .filter(|_| !without_position)
            .map(|throw| self.tracks.compared(throw))
            .map(|throw| Evaluated { temperature_c: temperature.celsius, ..throw });
        let residual = evaluated.as_ref().and_then(|throw| self.tracks.residual(throw));
        if let (Some(throw), Some(residual)) = (&mut evaluated, &residual) {
            if let Some(of_one_throw) = self.tracks.of_one_throw(throw.direction) {
                self.trail.push(at, residual, &of_one_throw);
            }
            throw.log = (Vector3::from(throw.log) - site::excused(residual, common)).into();
        }
        let mut verdict =
            Verdict { change_pct: residual.map(|residual| residual.map(percent).into()), ..Verdict::default() };
        if self.maintenance.is_none() {
            let (operation, alarms, context) = self.parts(at, Some(&observation.throw), settings);
            let supply_v = observation.features.supply_v.filter(|volts| !POSSIBLE_SUPPLY_V.contains(volts));
            let disbelief = temperature.disbelief.or(supply_v.map(Disbelief::Supply));
            verdict.events.extend(operation.on_sensors(disbelief, alarms, context));
            let faulty = observation.faulty.or(without_position.then_some(SensorChannel::Position));
            verdict.events.extend(operation.on_channel(faulty, alarms, context));
            self.observe_in_service(observation, evaluated.as_ref(), at, settings, &mut verdict);
        }
        verdict.baseline =
            observation.direction.filter(|_| !observation.features_only).map(|d| self.baseline_progress(d, settings));
        verdict.state = self.state();
        verdict.drifts = self.drifts().to_vec();
        verdict.blind = self.blind;
        verdict.has_trend = self.tracks.trend().is_some();
        verdict.caveats = self.caveats();
        verdict
    }

    fn observe_in_service(
        &mut self,
        observation: &Observation,
        evaluated: Option<&Evaluated>,
        at: Timestamp,
        settings: &Settings,
        verdict: &mut Verdict,
    ) {
        let (operation, alarms, context) = self.parts(at, Some(&observation.throw), settings);
        verdict.events.extend(operation.on_throw(observation.incomplete, observation.direction, alarms, context));
        if let Some(throw) = evaluated {
            let suspicious = self.drift.is_suspicious(&self.alarms);
            let features = &observation.features;
            self.instruments.gauges.push(throw.direction, features, throw.temperature_c, suspicious);
            self.observe_evaluated(throw, &observation.throw, at, settings, verdict);
        } else {
            self.drift.on_unjudged();
            self.observe_features(observation, at, settings, verdict);
        }
        // Ratios show less than coefficients, so their machines keep the features.
        let is_judged = evaluated.is_some_and(|throw| self.tracks.has_coefficients(throw.direction));
        let watched = self.watch_features(observation, is_judged, at, settings, verdict);
        let blind = self.blind;
        let (operation, alarms, context) = self.parts(at, Some(&observation.throw), settings);
        let evaluated_or_watched = evaluated.is_some() || watched;
        let direction = observation.direction;
        let event = operation.on_evaluation(evaluated_or_watched, direction, blind.as_ref(), alarms, context);
        verdict.events.extend(event);
        if let (Some(direction), Some(duration_s), false) =
            (observation.direction, observation.features.duration_s, observation.incomplete)
            && let Some(normal_s) = self.tracks.duration_s(direction)
        {
            let longer_pct = 100.0 * (duration_s / normal_s - 1.0);
            let explained = self.alarms.active().any(|event| is_drift(event) || event.cause == Cause::Supply);
            let (operation, alarms, context) = self.parts(at, Some(&observation.throw), settings);
            verdict.events.extend(operation.on_duration(longer_pct, direction, explained, alarms, context));
        }
    }

    /// Adds a throw without an estimate to the gauges. A rejected one shows those that need no model. In a direction without
    /// a baseline they are learned as well: what follows a row of rejections must not be learned as normal unseen.
    fn observe_features(
        &mut self,
        observation: &Observation,
        at: Timestamp,
        settings: &Settings,
        verdict: &mut Verdict,
    ) {
        let Observation { features: all, features_only, incomplete, faulty, .. } = observation;
        let Some(direction) = observation.direction.filter(|_| !incomplete && faulty.is_none()) else { return };
        let features = if *features_only {
            all.clone()
        } else {
            Features {
                duration_s: all.duration_s,
                supply_v: all.supply_v,
                peak_current_a: all.peak_current_a,
                running_current_a: all.running_current_a,
                charge_as: all.charge_as,
                ..Features::default()
            }
        };
        let has_baseline = self.tracks.of_one_throw(direction).is_some();
        let unusual = self.drift.is_suspicious(&self.alarms) || !features_only && has_baseline;
        self.instruments.gauges.push(direction, &features, observation.temperature_c, unusual);
        if !features_only && features.supply_v.is_some() {
            let context = Context { name: &self.name, at, throw: Some(&observation.throw), settings };
            verdict.events.extend(self.instruments.judge_supply(None, &mut self.alarms, context));
        }
    }

    /// Watches the features of a throw whose coefficients cannot be judged: it has none, or there is no baseline yet, as
    /// on a machine whose every throw is rough. Returns whether the machine is monitored by them.
    fn watch_features(
        &mut self,
        observation: &Observation,
        is_judged: bool,
        at: Timestamp,
        settings: &Settings,
        verdict: &mut Verdict,
    ) -> bool {
        let context = Context { name: &self.name, at, throw: Some(&observation.throw), settings };
        if is_judged {
            verdict.events.extend(self.features.on_estimate(observation.direction, &mut self.alarms, context));
            return true;
        }
        let Some(direction) = observation.direction.filter(|_| !observation.incomplete) else { return false };
        let (features, gauges) = (&observation.features, &self.instruments.gauges);
        verdict.events.extend(self.features.on_features(direction, features, gauges, &mut self.alarms, context));
        let has_features = !self.has_position && observation.features_only && features.running_current_a.is_some();
        self.features.is_alarmed() || has_features
    }

    fn observe_evaluated(
        &mut self,
        throw: &Evaluated,
        id: &ThrowRef,
        at: Timestamp,
        settings: &Settings,
        verdict: &mut Verdict,
    ) {
        let suspicious = self.drift.is_suspicious(&self.alarms);
        let departure = self.tracks.departure(throw);
        let residual = self.tracks.push(throw, self.order, suspicious, settings);
        let context = Context { name: &self.name, at, throw: Some(id), settings };
        let drift = residual.map(|residual| {
            // The alarm of the features has no cause, so no part of the drift is known by it.
            let of_features = self.features.is_alarmed();
            let gauges = &self.instruments.gauges;
            let known = if of_features {
                Known { gauges: Some(gauges), ..Known::default() }
            } else {
                self.drift.known(&self.alarms, gauges)
            };
            let wild = self.drift.intermittent.is_wild();
            let mut drift = self.tracks.drift(throw.direction, wild, &known, settings);
            drift.testimony = self.instruments.testimony(&drift, settings);
            drift.of_features = of_features.then_some(Cause::Unattributed);
            let events = self.drift.judge(&drift, &residual, self.order, &self.tracks, &mut self.alarms, context);
            verdict.events.extend(events);
            let events = self.instruments.judge(&drift, drift.testimony, &mut self.alarms, context);
            verdict.events.extend(events);
            drift
        });
        let excused = drift.as_ref().is_some_and(|drift| drift.testimony.excuses());
        if let Some(departure) = departure {
            verdict.events.extend(self.drift.judge_departure(departure, excused, &mut self.alarms, context));
        }
        let hidden = drift.as_ref().and_then(|drift| drift.hidden);
        let by_temperature = hidden.and_then(|(cause, below_pct)| {
            let baseline_c = self.tracks.reference_c(throw.direction)?;
            let temperature = HidingTemperature { temperature_c: throw.temperature_c?, baseline_c };
            Some(Blindness { cause, below_pct, temperature: Some(temperature) })
        });
        self.blind = by_temperature.or_else(|| {
            let (cause, below_pct) = self.tracks.hidden_by_scatter(settings)?;
            Some(Blindness { cause, below_pct, temperature: None })
        });
        let suspicion = self.drift.suspicion(drift.as_ref(), &self.alarms);
        let taken = self.tracks.learn(throw, self.order, at, suspicion, settings);
        if !taken.is_empty() {
            self.drift.forget_history();
        }
        verdict.baselines_taken.extend(taken);
    }

    /// The operational counters, the alarms, and the context of events.
    fn parts<'a>(
        &'a mut self,
        at: Timestamp,
        throw: Option<&'a ThrowRef>,
        settings: &'a Settings,
    ) -> (&'a mut Operation, &'a mut Alarms, Context<'a>) {
        (&mut self.operation, &mut self.alarms, Context { name: &self.name, at, throw, settings })
    }

    /// Advances the time: ends shelvings and maintenance windows, detects silence. Call it at least once a minute.
    /// Silence is the sum of the times between calls, each at most an hour, so that a jump of the clock does not count
    /// as silence.
    pub fn tick(&mut self, now: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        let now = to_micros(now);
        let mut events = self.alarms.unshelve_due(now);
        let longest = settings.longest_shelving();
        let ends = self.maintenance.as_mut().map(|maintenance| *maintenance.until.get_or_insert(now + longest));
        if ends.is_some_and(|until| until <= now) {
            events.extend(self.end_maintenance(Actor::default(), now));
        }
        // Silence counts only after a first throw.
        let in_service = self.maintenance.is_none() && self.order > 0;
        let (operation, alarms, context) = self.parts(now, None, settings);
        events.extend(operation.on_tick(in_service, alarms, context));
        events
    }

    /// Applies the presence of the logger's token. A logger that never declared one raises no alarm. Call it before
    /// each [`Self::tick`].
    pub fn logger(&mut self, there: bool, now: Timestamp, settings: &Settings) -> Option<AlarmEvent> {
        let (operation, alarms, context) = self.parts(to_micros(now), None, settings);
        operation.on_liveliness(there, alarms, context)
    }

    /// Whether the machine has a departure from a baseline, which [`Self::common`] needs.
    #[must_use]
    pub fn is_witness(&self) -> bool {
        !self.trail.is_empty()
    }

    /// Common change of machines with these monitors in the hours before `at`.
    #[must_use]
    pub fn common<'a>(machines: impl Iterator<Item = &'a Self>, at: Timestamp) -> Common {
        site::common(machines.map(|monitor| &monitor.trail), to_micros(at))
    }

    /// Applies the common change of a site to the monitor for all its machines.
    pub fn follow_site(&mut self, common: &Common, now: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        let (_, alarms, context) = self.parts(to_micros(now), None, settings);
        site::judge(common, alarms, context)
    }

    /// Whether the logger ever declared a token.
    #[must_use]
    pub fn is_announced(&self) -> bool {
        self.operation.is_announced()
    }

    /// Takes over an open alarm that no monitor has, as after the loss of a snapshot: an operator can acknowledge it.
    pub fn adopt(&mut self, last: AlarmEvent, now: Timestamp) -> AlarmEvent {
        let text = text::orphaned(&self.name);
        self.alarms.adopt(last, text, to_micros(now))
    }

    /// Whether neither a throw nor a token of a logger was ever received, as for the name of a daemon.
    #[must_use]
    pub fn has_no_logger(&self) -> bool {
        self.order == 0 && !self.is_announced()
    }

    /// Applies a problem of the daemon with storing data, for the monitor of the daemon itself; the alarm ends after
    /// ten minutes without a problem. Call it with each [`Self::tick`].
    pub fn trouble(
        &mut self,
        trouble: Option<(Severity, &str)>,
        now: Timestamp,
        settings: &Settings,
    ) -> Option<AlarmEvent> {
        let (operation, alarms, context) = self.parts(to_micros(now), None, settings);
        operation.on_daemon_trouble(trouble, alarms, context)
    }

    /// Applies a change of the watched daemons that are away, with the time since when, for the monitor of the daemon
    /// itself.
    pub fn peers(&mut self, away: &[(String, Timestamp)], now: Timestamp, settings: &Settings) -> Option<AlarmEvent> {
        let (_, alarms, context) = self.parts(to_micros(now), None, settings);
        let text = (!away.is_empty()).then(|| text::peers_away(away));
        operational::on_peers(text, alarms, context)
    }

    /// Applies `lost` missing throws.
    pub fn gap(&mut self, lost: u64, at: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        let (operation, alarms, context) = self.parts(to_micros(at), None, settings);
        operation.on_gap(lost, alarms, context).into_iter().collect()
    }

    /// Applies the time when the next throw was received: judged after the loss of its logger, an earlier one is no sign
    /// of life.
    pub fn received(&mut self, at: Timestamp) {
        self.operation.on_receipt(to_micros(at));
    }

    /// Counts the throws whose movement contradicts the direction that the logger names.
    pub fn direction(&mut self, contradicted: bool) {
        self.operation.on_direction(contradicted);
    }

    /// Applies the parameters with which the next throw was identified. Estimates with other parameters cannot be
    /// compared, so a change starts a new baseline; returns the command that does this, with its events.
    pub fn configured(
        &mut self,
        parameters: Parameters,
        now: Timestamp,
        settings: &Settings,
    ) -> Option<(Command, Vec<AlarmEvent>)> {
        let changed = self.parameters.replace(parameters)?.changed(&parameters)?;
        let why = format!("the configuration of the machine changed: {changed}");
        let command = Command::Rebaseline { by: "pointsd".to_owned(), why };
        let events = self.command(&command, now, settings).ok()?;
        Some((command, events))
    }

    /// Applies an irregularity of the logger, in a throw if it is one of a throw.
    pub fn irregular(
        &mut self,
        irregularity: Irregularity,
        throw: Option<&ThrowRef>,
        at: Timestamp,
        settings: &Settings,
    ) -> Option<AlarmEvent> {
        if self.maintenance.is_some() {
            return None;
        }
        let (operation, alarms, context) = self.parts(to_micros(at), throw, settings);
        operation.on_irregularity(irregularity, alarms, context)
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
            Command::Ack { cause, by } => Ok(vec![self.alarms.acknowledge(*cause, by, now)?]),
            Command::Shelve { cause, until, .. } => {
                Ok(vec![self.alarms.shelve(*cause, to_micros(*until), actor, now)?])
            }
            Command::Unshelve { cause, .. } => Ok(vec![self.alarms.unshelve(*cause, actor, now)?]),
            Command::Rebaseline { by, why } => Ok(self.rebaseline(by, why, actor, now)),
            Command::MaintenanceStart { .. } if self.maintenance.is_some() => Err(CommandError::InMaintenance),
            Command::MaintenanceStart { until, by, why } => {
                let until = Some(to_micros(*until));
                self.maintenance = Some(Box::new(Maintenance { until, by: by.clone(), why: why.clone() }));
                Ok(self.alarms.set_out_of_service(true, actor, now))
            }
            Command::MaintenanceEnd { .. } if self.maintenance.is_none() => Err(CommandError::NotInMaintenance),
            Command::MaintenanceEnd { .. } => Ok(self.end_maintenance(actor, now)),
        }
    }

    fn rebaseline(&mut self, by: &str, why: &str, actor: Actor, now: Timestamp) -> Vec<AlarmEvent> {
        let mut events = self.end_rules(now);
        self.operation.forget_channel();
        self.thermometer = Thermometer::default();
        self.has_position = false;
        self.tracks = Tracks::default();
        self.drift.reset();
        self.drift.now.clear();
        self.instruments = Instruments::default();
        self.features.reset();
        self.trail = Trail::default();
        self.blind = None;
        self.unread = None;
        let text = text::rebaselined(&self.name, by, why);
        let drifts: Vec<Cause> =
            self.alarms.events().filter(|event| is_drift(event)).map(|event| event.cause).collect();
        events.extend(drifts.into_iter().filter_map(|cause| self.alarms.close(cause, text.clone(), actor, now)));
        events
    }

    /// Ends the alarms of rules that forget their last throws, and could not end them any more.
    fn end_rules(&mut self, now: Timestamp) -> Vec<AlarmEvent> {
        let of_features = self.features.is_alarmed().then_some(Cause::Unattributed);
        let causes = [Cause::Sensor, Cause::Supply].into_iter().chain(of_features);
        causes.filter_map(|cause| self.alarms.clear(cause, text::checked_anew(&self.name), now)).collect()
    }

    fn end_maintenance(&mut self, actor: Actor, now: Timestamp) -> Vec<AlarmEvent> {
        self.maintenance = None;
        self.drift.now.clear();
        let mut events = self.alarms.set_out_of_service(false, actor, now);
        events.extend(self.end_rules(now));
        self.tracks.forget_recent();
        self.instruments.forget_recent();
        self.features.reset();
        self.drift.reset();
        self.operation.reset();
        events
    }

    /// The latest event of every open alarm (any state but `normal`), oldest alarm first.
    #[must_use]
    pub fn open_alarms(&self) -> Vec<AlarmEvent> {
        self.alarms.events().cloned().collect()
    }

    /// The drifts with an active alarm with their present size, the largest relative to its warning limit first.
    #[must_use]
    pub fn drifts(&self) -> &[Drifting] {
        &self.drift.now
    }

    /// Sentences about what the monitor cannot show at present.
    #[must_use]
    pub fn caveats(&self) -> Vec<String> {
        let blind = self.blind.as_ref().map(|blind| text::blind(&self.name, blind));
        let only_features = self.features.is_monitoring() && !self.tracks.any_baseline();
        let unread = self.unread.as_ref().map(|_| text::unread(&self.name));
        unread
            .into_iter()
            .chain(blind)
            .chain(self.tracks.trend().map(|slopes| text::trend(&self.name, slopes)))
            .chain(only_features.then(|| text::only_features(&self.name)))
            .chain(self.operation.is_contradicted().then(|| text::contradicted(&self.name)))
            .chain(self.tracks.lacks_scale().then(|| text::ratios_only(&self.name)))
            .collect()
    }

    /// The state of the machine.
    #[must_use]
    pub fn state(&self) -> MachineState {
        if self.maintenance.is_some() {
            return MachineState::Maintenance;
        }
        let of_machine = |event: &&AlarmEvent| event.cause != Cause::NotMonitored;
        match self.alarms.active().filter(of_machine).map(|event| event.severity).max() {
            Some(Severity::Critical) => MachineState::Critical,
            _ if self.alarms.is_active(Cause::NotMonitored) => MachineState::NotMonitored,
            Some(Severity::Warning) => MachineState::Warning,
            None if self.tracks.any_baseline() => MachineState::Healthy,
            None if self.features.is_monitoring() && !self.operation.is_rejecting() => MachineState::Healthy,
            None => MachineState::Learning,
        }
    }

    /// Throws in the baseline of a direction, and throws that it needs.
    #[must_use]
    pub fn baseline_progress(&self, direction: Direction, settings: &Settings) -> (usize, usize) {
        self.tracks.progress(direction, settings)
    }

    /// The baseline in use for a direction.
    #[must_use]
    pub fn baseline(&self, direction: Direction) -> Option<BaselineRecord> {
        self.tracks.record(direction)
    }

    /// Evaluated throws of a direction since its baseline.
    #[must_use]
    pub fn throws_since_baseline(&self, direction: Direction) -> u64 {
        self.tracks.since_baseline(direction)
    }
}

impl From<VersionOne> for MachineMonitor {
    fn from(old: VersionOne) -> Self {
        let alarms = Alarms::from(old.board);
        let conditions = std::array::from_fn(|at| old.conditions[at].now(alarms.is_active(DRIFTS[at])));
        let onset = old.onset.map(|onset| Onset { first: onset.first, order: onset.order });
        let maintenance =
            old.maintenance.map(|window| Box::new(Maintenance { until: window.until, by: window.by, why: window.why }));
        let mut tracks = old.tracks;
        tracks.add_temperature();
        Self {
            version: Self::VERSION,
            name: old.name,
            order: old.order,
            tracks,
            drift: DriftAlarms { history: old.history, onset, conditions, ..DriftAlarms::default() },
            alarms,
            operation: old.operation,
            thermometer: Thermometer::default(),
            instruments: Instruments::default(),
            features: FeatureWatch::default(),
            trail: Trail::default(),
            blind: None,
            maintenance,
            has_position: false,
            parameters: None,
            unread: None,
        }
    }
}

fn is_drift(event: &AlarmEvent) -> bool {
    event.cause.is_drift()
}

/// Rounds to microseconds as in the database, so that the identity of an alarm does not change there.
fn to_micros(at: Timestamp) -> Timestamp {
    Timestamp::from_microsecond(at.as_microsecond()).unwrap_or(at)
}
