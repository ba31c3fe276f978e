//! What the estimator has to know of each machine: defaults for all, and what differs for some.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};

use crate::{
    estimate::{Motor, Settings},
    throw::{MachineId, Name},
};

/// The `[machines]` section: what holds for every machine that says nothing else. All keys are optional.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MachineDefaults {
    /// Ball-screw lead \[mm per revolution\], 0.5 to 500.
    pub lead_mm: f64,
    /// Toe position at which the rails are unstressed \[mm from normal\], -1,000 to 1,000.
    pub neutral_mm: f64,
    /// Nominal stroke \[mm\], 1 to 1,000; without it only the trace itself tells an incomplete throw.
    pub stroke_mm: Option<f64>,
    /// Kind of motor.
    pub motor: Motor,
    /// Noise of the current sensor, standard deviation \[A\], 0.000001 to 10.
    pub current_noise_a: f64,
    /// Noise of the position sensor, standard deviation \[mm\], 0.000001 to 10.
    pub position_noise_mm: f64,
    /// Least fit of an accepted estimate \[%\], 0 to 100.
    pub fit_floor_pct: f64,
    /// Refine each estimate with the prefilter that matches the sensors' noise.
    pub refined: bool,
}

impl Default for MachineDefaults {
    fn default() -> Self {
        let Settings {
            lead_mm,
            neutral_mm,
            stroke_mm,
            motor,
            current_noise_a,
            position_noise_mm,
            fit_floor_pct,
            refined,
        } = Settings::default();
        Self { lead_mm, neutral_mm, stroke_mm, motor, current_noise_a, position_noise_mm, fit_floor_pct, refined }
    }
}

/// One `[[machine]]`: the keys of `[machines]` that differ for it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MachineEntry {
    /// Its site.
    pub site: Name,
    /// Its name there.
    pub machine: Name,
    lead_mm: Option<f64>,
    neutral_mm: Option<f64>,
    stroke_mm: Option<f64>,
    motor: Option<Motor>,
    current_noise_a: Option<f64>,
    position_noise_mm: Option<f64>,
    fit_floor_pct: Option<f64>,
    refined: Option<bool>,
}

/// The settings of every machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Machines {
    default: Settings,
    own: HashMap<MachineId, Settings>,
}

impl Machines {
    pub(super) fn new(defaults: &MachineDefaults, entries: &[MachineEntry]) -> Self {
        let own = entries.iter().map(|entry| (entry.id(), entry.over(defaults).settings())).collect();
        Self { default: defaults.settings(), own }
    }

    /// The settings of one machine.
    #[must_use]
    pub fn of(&self, machine: &MachineId) -> &Settings {
        self.own.get(machine).unwrap_or(&self.default)
    }

    /// The machines that the configuration names.
    pub fn named(&self) -> impl Iterator<Item = &MachineId> {
        self.own.keys()
    }
}

impl MachineEntry {
    pub(super) fn id(&self) -> MachineId {
        MachineId { site: self.site.clone(), machine: self.machine.clone() }
    }

    pub(super) fn over(&self, defaults: &MachineDefaults) -> MachineDefaults {
        MachineDefaults {
            lead_mm: self.lead_mm.unwrap_or(defaults.lead_mm),
            neutral_mm: self.neutral_mm.unwrap_or(defaults.neutral_mm),
            stroke_mm: self.stroke_mm.or(defaults.stroke_mm),
            motor: self.motor.unwrap_or(defaults.motor),
            current_noise_a: self.current_noise_a.unwrap_or(defaults.current_noise_a),
            position_noise_mm: self.position_noise_mm.unwrap_or(defaults.position_noise_mm),
            fit_floor_pct: self.fit_floor_pct.unwrap_or(defaults.fit_floor_pct),
            refined: self.refined.unwrap_or(defaults.refined),
        }
    }
}

impl MachineDefaults {
    fn settings(&self) -> Settings {
        Settings {
            lead_mm: self.lead_mm,
            neutral_mm: self.neutral_mm,
            stroke_mm: self.stroke_mm,
            motor: self.motor,
            current_noise_a: self.current_noise_a,
            position_noise_mm: self.position_noise_mm,
            fit_floor_pct: self.fit_floor_pct,
            refined: self.refined,
        }
    }

    /// The keys that are out of range, each with what is wrong.
    pub(super) fn problems(&self) -> impl Iterator<Item = (&'static str, String)> {
        let ranges = [
            ("lead_mm", self.lead_mm, 0.5, 500.0, "mm"),
            ("neutral_mm", self.neutral_mm, -1_000.0, 1_000.0, "mm"),
            ("stroke_mm", self.stroke_mm.unwrap_or(1.0), 1.0, 1_000.0, "mm"),
            ("current_noise_a", self.current_noise_a, 1e-6, 10.0, "A"),
            ("position_noise_mm", self.position_noise_mm, 1e-6, 10.0, "mm"),
            ("fit_floor_pct", self.fit_floor_pct, 0.0, 100.0, "%"),
        ];
        ranges
            .into_iter()
            .filter(|(_, value, low, high, _)| !(low..=high).contains(&value))
            .map(|(key, value, low, high, unit)| (key, format!("is {value}, must be {low} to {high} {unit}")))
    }
}
