//! The configuration of `pointsd`. Every key has a default; `config/pointsd.toml` shows them all.

mod document;
mod machines;
mod zenoh;

use std::{
    collections::HashSet,
    fs,
    net::SocketAddr,
    path::{Path, PathBuf},
};

use rustix::fs::Access;
use serde::{Deserialize, Serialize};

pub use document::{ConfigError, Document};
pub use machines::{MachineDefaults, MachineEntry, Machines};

use crate::{
    diagnose, store,
    throw::{MachineId, Name},
    wire::Scope,
};

/// The `[monitor]` section: how this daemon is called.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Monitor {
    /// The site under which it shows that it is alive.
    pub site: Name,
    /// Its name: the key of its liveliness token is `points/v1/{site}/monitor/{id}/alive`.
    pub id: Name,
}

impl Monitor {
    /// The name under which its own alarms stand, as if it were a machine of its site.
    #[must_use]
    pub fn as_machine(&self) -> MachineId {
        MachineId { site: self.site.clone(), machine: self.id.clone() }
    }
}

/// The `[subscribe]` section: what it takes in.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Subscribe {
    /// The part of the fleet: `points/v1/**`, `points/v1/{site}/**` or `points/v1/{site}/{machine}/**`.
    pub key: String,
    /// Largest throw message \[bytes\], 1,024 to 33,554,432. Larger ones go to quarantine.
    pub max_payload_bytes: usize,
    /// Most machines, 1 to 100,000. Throws of further ones go to quarantine: a key costs an attacker nothing.
    pub max_machines: usize,
}

/// The `[identify]` section: how much of the computer the estimator may use.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Identify {
    /// Threads, 0 to 64; 0 for as many as there are processors, at most 8.
    pub threads: usize,
}

/// The `[web]` section: the dashboard and the metrics.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Web {
    /// Address and port to listen on; without it there is no dashboard. Whoever reaches it can read.
    pub listen: Option<SocketAddr>,
    /// Names, beside IP addresses and `localhost`, under which browsers may ask for it.
    pub hosts: Vec<String>,
}

/// How log lines are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// The `[log]` section.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Log {
    /// `error`, `warn`, `info`, `debug`, `trace`, or directives by module as `info,zenoh=debug`.
    pub level: String,
    /// How lines are written.
    pub format: LogFormat,
}

impl Default for Monitor {
    fn default() -> Self {
        Self { site: fixed_name("fleet"), id: fixed_name("pointsd") }
    }
}

impl Default for Subscribe {
    fn default() -> Self {
        Self { key: "points/v1/**".to_owned(), max_payload_bytes: 16 << 20, max_machines: 10_000 }
    }
}

impl Default for Log {
    fn default() -> Self {
        Self { level: "info,zenoh=warn".to_owned(), format: LogFormat::Text }
    }
}

#[expect(clippy::expect_used, reason = "called with literals that a test reads")]
fn fixed_name(text: &str) -> Name {
    text.parse().expect("a valid name")
}

/// The file as it is written.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct File {
    monitor: Monitor,
    subscribe: Subscribe,
    identify: Identify,
    store: store::Settings,
    diagnosis: diagnose::Settings,
    machines: MachineDefaults,
    machine: Vec<MachineEntry>,
    web: Web,
    log: Log,
    // Read as zenoh's own type so that its complaints carry the place; used as a table, to be laid over our defaults.
    #[serde(rename = "zenoh")]
    _zenoh: Option<::zenoh::Config>,
}

/// Everything that `pointsd` is told.
#[derive(Debug, Clone)]
pub struct Config {
    /// How this daemon is called.
    pub monitor: Monitor,
    /// What it takes in.
    pub subscribe: Subscribe,
    /// The part of the fleet, from `subscribe.key`.
    pub scope: Scope,
    /// How much of the computer the estimator may use.
    pub identify: Identify,
    /// The database.
    pub store: store::Settings,
    /// Limits of the diagnosis.
    pub diagnosis: diagnose::Settings,
    /// What the estimator has to know of each machine.
    pub machines: Machines,
    /// The dashboard.
    pub web: Web,
    /// Log lines.
    pub log: Log,
    /// The zenoh session.
    pub zenoh: ::zenoh::Config,
}

impl Config {
    /// The configuration without a file.
    ///
    /// # Errors
    /// When the built-in defaults cannot be used here, as a working folder that is gone.
    pub fn built_in() -> Result<Self, ConfigError> {
        Self::from_document(&Document::parse(Path::new("built-in defaults"), String::new())?)
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// The first thing that is wrong, with file, line and key.
    pub fn load(file: &Path) -> Result<Self, ConfigError> {
        Self::from_document(&Document::read(file)?)
    }

    /// The zenoh section as text, to see whether it changed.
    #[must_use]
    pub fn zenoh_text(&self) -> String {
        self.zenoh.to_string()
    }

    /// Checks a document.
    ///
    /// # Errors
    /// The first thing that is wrong, with file, line and key.
    pub fn from_document(document: &Document) -> Result<Self, ConfigError> {
        let file: File = document.deserialize()?;
        let scope =
            Scope::parse(&file.subscribe.key).map_err(|error| document.complain("subscribe.key", error.to_string()))?;
        check_ranges(&file, document)?;
        check_machines(&file, document)?;
        check_web(&file.web, document)?;
        check_log(&file.log, document)?;
        check_database_path(&file.store.path, document)?;
        Ok(Self {
            scope,
            machines: Machines::new(&file.machines, &file.machine),
            zenoh: monitor_session(document)?,
            monitor: file.monitor,
            subscribe: file.subscribe,
            identify: file.identify,
            store: file.store,
            diagnosis: file.diagnosis,
            web: file.web,
            log: file.log,
        })
    }
}

fn check_ranges(file: &File, document: &Document) -> Result<(), ConfigError> {
    let ranges = [
        ("subscribe.max_payload_bytes", file.subscribe.max_payload_bytes, 1 << 10, 32 << 20, "bytes"),
        ("subscribe.max_machines", file.subscribe.max_machines, 1, 100_000, "machines"),
        ("identify.threads", file.identify.threads, 0, 64, "threads"),
    ];
    for (key, value, low, high, unit) in ranges {
        if !(low..=high).contains(&value) {
            return Err(document.complain(key, format!("is {value}, must be {low} to {high} {unit}")));
        }
    }
    file.store.validate().map_err(|error| document.complain(&format!("store.{}", error.key), error.to_string()))?;
    file.diagnosis.validate().map_err(|error| document.complain(&format!("diagnosis.{}", error.key), error.to_string()))
}

fn check_machines(file: &File, document: &Document) -> Result<(), ConfigError> {
    if let Some((key, problem)) = file.machines.problems().next() {
        return Err(document.complain(&format!("machines.{key}"), problem));
    }
    let mut seen = HashSet::new();
    for (index, entry) in file.machine.iter().enumerate() {
        if let Some((key, problem)) = entry.over(&file.machines).problems().next() {
            return Err(document.complain(&format!("machine[{index}].{key}"), problem));
        }
        if !seen.insert(entry.id()) {
            let problem = format!("{} is described a second time", entry.id());
            return Err(document.complain(&format!("machine[{index}].machine"), problem));
        }
    }
    Ok(())
}

/// Longest name of a host.
const HOST_LENGTH: usize = 253;

fn check_web(web: &Web, document: &Document) -> Result<(), ConfigError> {
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '.';
    for (index, host) in web.hosts.iter().enumerate() {
        if host.is_empty() || host.len() > HOST_LENGTH || !host.chars().all(fits) {
            let problem = format!("{host:?} is no name of a host: letters, digits, - and . without port");
            return Err(document.complain(&format!("web.hosts[{index}]"), problem));
        }
    }
    Ok(())
}

/// Checks the `[log]` section.
///
/// # Errors
/// When the level cannot be understood.
pub fn check_log(log: &Log, document: &Document) -> Result<(), ConfigError> {
    log.level
        .parse::<tracing_subscriber::filter::Targets>()
        .map(drop)
        .map_err(|error| document.complain("log.level", format!("{:?}: {error}", log.level)))
}

/// The folder of the database must be there and must be one that can be written to.
fn check_database_path(path: &Path, document: &Document) -> Result<(), ConfigError> {
    let complain = |problem: String| Err(document.complain("store.path", problem));
    if path.is_dir() {
        return complain(format!("{} is a folder, must be a file", path.display()));
    }
    let parent = match path.parent() {
        Some(parent) if parent.as_os_str().is_empty() => PathBuf::from("."),
        Some(parent) => parent.to_owned(),
        None => return complain(format!("{} names no file", path.display())),
    };
    match fs::metadata(&parent) {
        Ok(folder) if !folder.is_dir() => complain(format!("{} is no folder", parent.display())),
        Ok(_) if rustix::fs::access(&parent, Access::WRITE_OK | Access::EXEC_OK).is_err() => {
            complain(format!("this user cannot write to the folder {}", parent.display()))
        }
        Ok(_) => Ok(()),
        Err(error) => complain(format!("the folder {} of the database: {error}", parent.display())),
    }
}

#[derive(Deserialize)]
struct ZenohSection {
    zenoh: Option<toml::Table>,
}

fn section(document: &Document) -> Result<Option<toml::Table>, ConfigError> {
    Ok(document.deserialize::<ZenohSection>()?.zenoh)
}

/// The daemon's session: the file's `[zenoh]` over a hub that listens on loopback.
fn monitor_session(document: &Document) -> Result<::zenoh::Config, ConfigError> {
    zenoh::session_config(zenoh::MONITOR, section(document)?.as_ref(), document)
}

/// The session of a logger or an operator: the file's `[zenoh]` over a client of the hub on loopback.
///
/// # Errors
/// When zenoh cannot use the section.
pub fn client_session(document: &Document) -> Result<::zenoh::Config, ConfigError> {
    zenoh::session_config(zenoh::CLIENT, section(document)?.as_ref(), document)
}

#[cfg(test)]
mod tests;
