//! Settings of the estimator: defaults for all machines, and overrides for single machines.

use std::collections::HashMap;

use serde::Deserialize;
use toml::{Table, Value};

use crate::{
    estimate::Settings,
    throw::{MachineId, Name},
};

/// A section `[[machine]]`: a machine, and its values for keys of `[machines]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct MachineEntry {
    site: Name,
    machine: Name,
    #[serde(flatten)]
    overrides: Table,
}

/// Settings of the estimator for all machines.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Machines {
    pub(super) default: Settings,
    pub(super) overrides: HashMap<MachineId, Settings>,
}

impl Machines {
    /// The settings of one machine.
    pub fn of(&self, machine: &MachineId) -> &Settings {
        self.overrides.get(machine).unwrap_or(&self.default)
    }

    /// The machines with a section `[[machine]]`.
    pub fn named(&self) -> impl Iterator<Item = &MachineId> {
        self.overrides.keys()
    }
}

impl MachineEntry {
    pub(super) fn id(&self) -> MachineId {
        MachineId { site: self.site.clone(), machine: self.machine.clone() }
    }

    /// The `defaults`, changed by the keys of this entry; or the first invalid key and its problem.
    pub(super) fn over(&self, defaults: &Settings) -> Result<Settings, (String, String)> {
        let mut settings = defaults.clone();
        for (key, value) in &self.overrides {
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
