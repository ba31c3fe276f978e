//! The monitor of one machine: what one throw, one command or the passing of time does to it.

use jiff::Timestamp;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{
    AlarmEvent, BaselineRecord, Cause, Command, CommandError, Observation, Settings, Severity, Verdict,
    alarm::{Actor, Board},
    condition::Condition,
    explain::percent,
    operational::{Operation, Scene},
    track::{Standing, Tracks},
    trend::History,
    verdict::{Drift, Onset},
};
use crate::throw::Direction;

/// How a machine is, in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MachineState {
    /// No baseline is usable yet.
    Learning,
    /// Monitored, no alarm is active.
    Healthy,
    /// An alarm of severity warning is active.
    Warning,
    /// An alarm of severity critical is active.
    Critical,
    /// Its throws cannot be evaluated, or none come.
    NotMonitored,
    /// Out of service.
    Maintenance,
}

impl MachineState {
    /// The word used in the database.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Learning => "learning",
            Self::Healthy => "healthy",
            Self::Warning => "warning",
            Self::Critical => "critical",
            Self::NotMonitored => "not_monitored",
            Self::Maintenance => "maintenance",
        }
    }
}

/// A maintenance window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Maintenance {
    until: Option<Timestamp>,
    by: String,
    why: String,
}

/// The monitor of one machine: baselines, windows, alarms. Serialises completely, so that a restart changes nothing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MachineMonitor {
    pub(super) name: String,
    /// Throws observed.
    pub(super) order: u64,
    pub(super) tracks: Tracks,
    pub(super) history: History,
    pub(super) onset: Option<Onset>,
    pub(super) conditions: [Condition; 5],
    pub(super) board: Board,
    operation: Operation,
    maintenance: Option<Maintenance>,
}

impl MachineMonitor {
    /// A monitor that has seen nothing; `name` is how its texts call the machine.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            order: 0,
            tracks: Tracks::default(),
            history: History::default(),
            onset: None,
            conditions: [Condition::default(); 5],
            board: Board::default(),
            operation: Operation::default(),
            maintenance: None,
        }
    }

    /// Takes in one throw, evaluated or not. Throws come in the order in which the machine made them.
    pub fn observe(&mut self, observation: &Observation, settings: &Settings) -> Verdict {
        self.order += 1;
        let at = to_micros(observation.started_at);
        let evaluated = Evaluated::of(observation);
        let mut verdict = Verdict::default();
        if let Some(throw) = &evaluated {
            verdict.change_pct = self.tracks.residual(throw).map(|(residual, _)| residual.map(percent).into());
        }
        if self.maintenance.is_none() {
            self.observe_in_service(observation, evaluated.as_ref(), at, settings, &mut verdict);
        }
        verdict.baseline = observation.direction.map(|d| self.baseline_progress(d, settings));
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
        let name = self.name.clone();
        let scene = Scene { name: &name, at, throw: Some(&observation.throw), settings };
        verdict.events.extend(self.operation.arrived(observation.incomplete, &mut self.board, scene));
        verdict.events.extend(self.operation.evaluated(evaluated.is_some(), &mut self.board, scene));
        if let Some(throw) = evaluated {
            let drift = self.tracks.push(throw, self.order, settings).map(|residual| {
                self.history.push(&residual);
                self.tracks.drift(throw.direction, &self.open_causes(), settings)
            });
            if let Some(drift) = &drift {
                verdict.events.extend(self.judge(drift, &observation.throw, at, settings));
            }
            let standing = if self.board.active().any(is_drift) {
                Standing::Alarmed
            } else if drift.as_ref().is_some_and(Drift::matters) {
                Standing::Shown
            } else if self.onset.is_some() {
                Standing::Suspected
            } else {
                Standing::Plain
            };
            let taken = self.tracks.learn(throw, self.order, at, standing, settings);
            if taken.is_some() {
                // Residuals from another centre: what came before is no history of this one.
                self.history = History::default();
                self.onset = None;
            }
            verdict.baselines_taken.extend(taken);
        }
        if let (Some(direction), Some(duration_s), false) =
            (observation.direction, observation.features.duration_s, observation.incomplete)
            && let Some(normal_s) = self.tracks.duration_s(direction)
        {
            let longer_pct = 100.0 * (duration_s / normal_s - 1.0);
            let explained = self.board.active().any(is_drift);
            verdict.events.extend(self.operation.took(longer_pct, direction, explained, &mut self.board, scene));
        }
    }

    /// Lets time pass: shelving and maintenance windows end, silence is noticed. Call it at least once a minute:
    /// silence is the sum of the time between calls, each counted as an hour at most, so that a clock that jumps
    /// is no silence.
    pub fn tick(&mut self, now: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        let now = to_micros(now);
        let mut events = self.board.unshelve_due(now);
        if self.maintenance.as_ref().is_some_and(|m| m.until.is_some_and(|until| until <= now)) {
            events.extend(self.end_maintenance(Actor::default(), now));
        }
        // A machine is expected to throw once it has.
        let counts = self.maintenance.is_none() && self.order > 0;
        let name = self.name.clone();
        let scene = Scene { name: &name, at: now, throw: None, settings };
        events.extend(self.operation.tick(counts, &mut self.board, scene));
        events
    }

    /// Takes in whether the machine's logger shows now that it is alive. One that never has is not missed. Call it
    /// before each [`Self::tick`].
    pub fn logger(&mut self, there: bool, now: Timestamp, settings: &Settings) -> Option<AlarmEvent> {
        let name = self.name.clone();
        let scene = Scene { name: &name, at: to_micros(now), throw: None, settings };
        self.operation.logger(there, &mut self.board, scene)
    }

    /// Whether the machine's logger has ever shown that it is alive.
    #[must_use]
    pub fn is_announced(&self) -> bool {
        self.operation.is_announced()
    }

    /// Takes in what keeps the daemon from keeping data, for the monitor that stands for the daemon itself; its alarm
    /// ends after ten minutes without trouble. Call it with each [`Self::tick`].
    pub fn trouble(
        &mut self,
        trouble: Option<(Severity, &str)>,
        now: Timestamp,
        settings: &Settings,
    ) -> Option<AlarmEvent> {
        let name = self.name.clone();
        let scene = Scene { name: &name, at: to_micros(now), throw: None, settings };
        self.operation.trouble(trouble, &mut self.board, scene)
    }

    /// Takes in that `lost` throws of the machine never arrived.
    pub fn gap(&mut self, lost: u64, at: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        let name = self.name.clone();
        let scene = Scene { name: &name, at: to_micros(at), throw: None, settings };
        self.operation.gap(lost, &mut self.board, scene)
    }

    /// Carries out what an operator asks. After `Rebaseline` the store ends the history rows of the baselines that
    /// [`Self::baseline`] gave before.
    ///
    /// # Errors
    /// When it cannot be carried out; nothing has changed then.
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
            Command::Ack { cause, by } => match self.board.acknowledge(*cause, by, now) {
                None => Err(CommandError::NoSuchAlarm { cause: *cause }),
                Some(Err(by)) => Err(CommandError::AlreadyAcknowledged { cause: *cause, by }),
                Some(Ok(event)) => Ok(vec![event]),
            },
            Command::Shelve { cause, until, .. } => {
                let event = self.board.shelve(*cause, to_micros(*until), actor, now);
                event.map(|event| vec![event]).ok_or(CommandError::NoSuchAlarm { cause: *cause })
            }
            Command::Unshelve { cause, .. } => match self.board.unshelve(*cause, actor, now) {
                None => Err(CommandError::NoSuchAlarm { cause: *cause }),
                Some(None) => Err(CommandError::NotShelved { cause: *cause }),
                Some(Some(event)) => Ok(vec![event]),
            },
            Command::Rebaseline { by, why } => Ok(self.rebaseline(by, why, actor, now)),
            Command::MaintenanceStart { until, by, why } => {
                if self.maintenance.is_some() {
                    return Err(CommandError::InMaintenance);
                }
                self.maintenance = Some(Maintenance { until: *until, by: by.clone(), why: why.clone() });
                Ok(self.board.set_out_of_service(true, actor, now))
            }
            Command::MaintenanceEnd { .. } => {
                if self.maintenance.is_none() {
                    return Err(CommandError::NotInMaintenance);
                }
                Ok(self.end_maintenance(actor, now))
            }
        }
    }

    fn rebaseline(&mut self, by: &str, why: &str, actor: Actor, now: Timestamp) -> Vec<AlarmEvent> {
        self.tracks = Tracks::default();
        self.forget_recent();
        let said = format!("Machine {}: a new baseline is being taken ({by}: {why}).", self.name);
        let drifts: Vec<Cause> = self.board.open().filter(|event| is_drift(event)).map(|event| event.cause).collect();
        drifts.into_iter().filter_map(|cause| self.board.close(cause, said.clone(), actor, now)).collect()
    }

    fn end_maintenance(&mut self, actor: Actor, now: Timestamp) -> Vec<AlarmEvent> {
        self.maintenance = None;
        self.tracks.forget_recent();
        self.forget_recent();
        self.operation.reset();
        self.board.set_out_of_service(false, actor, now)
    }

    fn forget_recent(&mut self) {
        self.history = History::default();
        self.onset = None;
        self.conditions.iter_mut().for_each(Condition::reset);
    }

    fn open_causes(&self) -> Vec<Cause> {
        self.board.active().map(|event| event.cause).collect()
    }

    /// The latest event of every open alarm (any state but `normal`), oldest alarm first.
    #[must_use]
    pub fn open_alarms(&self) -> Vec<AlarmEvent> {
        self.board.open().cloned().collect()
    }

    /// How the machine is, in one word.
    #[must_use]
    pub fn state(&self) -> MachineState {
        let worst = self.board.active().map(|event| event.severity).max();
        if self.maintenance.is_some() {
            MachineState::Maintenance
        } else if self.board.is_active(Cause::NotMonitored) {
            MachineState::NotMonitored
        } else {
            match worst {
                Some(Severity::Critical) => MachineState::Critical,
                Some(Severity::Warning) => MachineState::Warning,
                None if self.tracks.any_baseline() => MachineState::Healthy,
                None => MachineState::Learning,
            }
        }
    }

    /// Throws in the baseline of a direction so far, and how many make it complete.
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

fn is_drift(event: &AlarmEvent) -> bool {
    event.cause.is_drift()
}

/// A throw with a direction and a usable estimate, in logarithms.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Evaluated {
    pub(super) direction: Direction,
    pub(super) log: [f64; 3],
    /// Covariance of the logarithms.
    pub(super) sensor: Matrix3<f64>,
    pub(super) temperature_c: Option<f64>,
    pub(super) duration_s: Option<f64>,
}

impl Evaluated {
    /// `None` unless the direction is known and the estimate is positive with a finite, positive covariance.
    fn of(observation: &Observation) -> Option<Self> {
        /// Relative standard deviation above which an estimate tells nothing: the logarithm is no longer linear.
        const WORST_SD: f64 = 0.5;
        let (estimate, covariance) = observation.estimate.as_ref()?;
        let direction = observation.direction?;
        if observation.incomplete || !estimate.iter().all(|v| v.is_finite() && *v > 0.0) {
            return None;
        }
        let scale = Matrix3::from_diagonal(&Vector3::from(*estimate).map(f64::recip));
        let sensor = scale * covariance * scale;
        let usable = sensor.iter().all(|v| v.is_finite())
            && sensor.diagonal().iter().all(|v| (0.0..WORST_SD * WORST_SD).contains(v));
        usable.then(|| Self {
            direction,
            log: estimate.map(f64::ln),
            sensor: 0.5 * (sensor + sensor.transpose()),
            temperature_c: observation.temperature_c.filter(|t| t.is_finite()),
            duration_s: observation.features.duration_s.filter(|d| d.is_finite() && *d > 0.0),
        })
    }
}

/// Microseconds, as the database keeps them: an alarm's identity must survive the way there and back.
fn to_micros(at: Timestamp) -> Timestamp {
    Timestamp::from_microsecond(at.as_microsecond()).unwrap_or(at)
}
