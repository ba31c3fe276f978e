//! Settings of the estimator: defaults for all machines, and overrides for single machines.

use std::collections::HashMap;

use serde::Deserialize;
use toml::{Table, Value};

use crate::{
    estimate::Settings,
    throw::{MachineId, Name},
};

/// A section `[[machine]]`: the keys of `[machines]` that differ.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct MachineEntry {
    site: Name,
    machine: Name,
    #[serde(flatten)]
    differing: Table,
}

/// Settings of the estimator for all machines.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Machines {
    pub(super) default: Settings,
    pub(super) own: HashMap<MachineId, Settings>,
}

impl Machines {
    /// The settings of one machine.
    pub fn of(&self, machine: &MachineId) -> &Settings {
        self.own.get(machine).unwrap_or(&self.default)
    }

    /// The machines with a section `[[machine]]`.
    pub fn named(&self) -> impl Iterator<Item = &MachineId> {
        self.own.keys()
    }
}

impl MachineEntry {
    pub(super) fn id(&self) -> MachineId {
        MachineId { site: self.site.clone(), machine: self.machine.clone() }
    }

    /// The `defaults` with the keys of this entry, or the first invalid key with its problem.
    pub(super) fn over(&self, defaults: &Settings) -> Result<Settings, (String, String)> {
        let mut settings = defaults.clone();
        for (key, value) in &self.differing {
            let mut table = match Value::try_from(&settings) {
                Ok(Value::Table(table)) => table,
                other => return Err((key.clone(), format!("cannot replace a default: {other:?}"))),
            };
            table.insert(key.clone(), value.clone());
            settings =
                Settings::deserialize(table).map_err(|error| (key.clone(), error.message().replace('\n', ", ")))?;
        }
        settings.check_ranges().map_err(|error| (error.key.clone(), error.problem()))?;
        Ok(settings)
    }
}
