//! The monitor of one machine.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::{AlarmEvent, BaselineRecord, Command, CommandError, Observation, Settings, Verdict};
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

/// The monitor of one machine: baselines, windows, alarms. Serialises completely, so that a restart changes nothing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MachineMonitor {
    name: String,
}

impl MachineMonitor {
    /// A monitor that has seen nothing; `name` is how its texts call the machine.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self { name: name.to_owned() }
    }

    /// Takes in one throw, evaluated or not. Throws come in the order in which the machine made them.
    pub fn observe(&mut self, observation: &Observation, settings: &Settings) -> Verdict {
        let _ = (observation, settings);
        Verdict::default()
    }

    /// Lets time pass: shelving and maintenance windows end, silence is noticed. Call it at least once a minute:
    /// silence is the sum of the time between calls, each counted as an hour at most, so that a clock that jumps
    /// is no silence.
    pub fn tick(&mut self, now: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        let _ = (now, settings);
        Vec::new()
    }

    /// Takes in that `lost` throws of the machine never arrived.
    pub fn gap(&mut self, lost: u64, at: Timestamp, settings: &Settings) -> Vec<AlarmEvent> {
        let _ = (lost, at, settings);
        Vec::new()
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
        let _ = settings;
        command.validate(now)?;
        Ok(Vec::new())
    }

    /// The latest event of every open alarm (any state but `normal`), oldest alarm first.
    #[must_use]
    pub fn open_alarms(&self) -> Vec<AlarmEvent> {
        Vec::new()
    }

    /// How the machine is, in one word.
    #[must_use]
    pub fn state(&self) -> MachineState {
        MachineState::Learning
    }

    /// Throws in the baseline of a direction so far, and how many make it complete.
    #[must_use]
    pub fn baseline_progress(&self, direction: Direction, settings: &Settings) -> (usize, usize) {
        let _ = direction;
        (0, settings.baseline_throws)
    }

    /// The baseline in use for a direction.
    #[must_use]
    pub fn baseline(&self, direction: Direction) -> Option<BaselineRecord> {
        let _ = direction;
        None
    }

    /// Evaluated throws of a direction since its baseline.
    #[must_use]
    pub fn throws_since_baseline(&self, direction: Direction) -> u64 {
        let _ = direction;
        0
    }
}
