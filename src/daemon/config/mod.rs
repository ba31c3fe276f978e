//! The configuration of `pointsd`. Every key has a default; `config/pointsd.toml` shows them all.

mod document;
mod machines;
mod operator;
mod zenoh;

use std::{
    collections::HashMap,
    fs,
    net::SocketAddr,
    ops::RangeInclusive,
    path::{Path, PathBuf},
};

use rustix::fs::Access;
use serde::{Deserialize, Serialize};
use subtle::ConstantTimeEq as _;

pub use document::{ConfigError, Document};
pub use machines::{MachineEntry, Machines};
pub use operator::{OperatorSession, operator_session};

use crate::{
    diagnose, estimate, store,
    throw::{MachineId, Name, OutOfRange},
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
    /// How long later throws of a machine wait to be judged for missing ones that its logger may still have, counted from
    /// when the last of them came \[s\], 0 to 86,400.
    pub backlog_wait_s: f64,
}

/// The `[identify]` section: how much of the computer the estimator may use.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Identify {
    /// Threads, 0 to 64; 0 for as many as there are processors, at most 8.
    pub threads: usize,
}

/// The `[web]` section: the dashboard and the metrics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Web {
    /// Address and port to listen on; without it there is no dashboard. Whoever reaches it can read.
    pub listen: Option<SocketAddr>,
    /// Names, beside IP addresses and `localhost`, under which browsers may ask for it.
    pub hosts: Vec<String>,
    /// Most machines for which `/metrics` has series of their own, 0 to 20,000; a larger fleet has totals alone.
    pub machine_metrics: u32,
    /// Secret that a page must give with an operator's command, 16 to 256 characters; without it the pages only show.
    pub token: Option<Token>,
}

/// A secret, which no log line and no error text shows.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Token(String);

impl Token {
    /// Whether `text` is the secret; takes the same time for every text of the same length.
    #[must_use]
    pub fn is(&self, text: &str) -> bool {
        self.0.as_bytes().ct_eq(text.as_bytes()).into()
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token")
    }
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
        Self { key: "points/v1/**".to_owned(), max_payload_bytes: 16 << 20, max_machines: 10_000, backlog_wait_s: 60.0 }
    }
}

impl Default for Web {
    fn default() -> Self {
        Self { listen: None, hosts: Vec::new(), machine_metrics: 1_000, token: None }
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
    machines: estimate::Settings,
    machine: Vec<MachineEntry>,
    web: Web,
    log: Log,
    // Read as zenoh's own type so that its complaints carry the place; used as a table, to be laid over our defaults.
    #[serde(rename = "zenoh")]
    _zenoh: Option<::zenoh::Config>,
}

/// The configuration of `pointsd`.
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
        let machines = machines(&file, document)?;
        check_web(&file.web, document)?;
        check_log(&file.log, document)?;
        check_database_path(&file.store.path, document)?;
        Ok(Self {
            scope,
            machines,
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
    let Subscribe { max_payload_bytes, max_machines, backlog_wait_s, .. } = file.subscribe;
    OutOfRange::check([
        ("subscribe.max_payload_bytes", max_payload_bytes as f64, 1024.0, f64::from(32 << 20), "bytes"),
        ("subscribe.max_machines", max_machines as f64, 1.0, 100_000.0, "machines"),
        ("subscribe.backlog_wait_s", backlog_wait_s, 0.0, 86_400.0, "s"),
        ("identify.threads", file.identify.threads as f64, 0.0, 64.0, "threads"),
    ])
    .and_then(|()| file.store.validate().map_err(|error| error.within("store")))
    .and_then(|()| file.diagnosis.validate().map_err(|error| error.within("diagnosis")))
    .and_then(|()| file.machines.check().map_err(|error| error.within("machines")))
    .map_err(|error| document.complain(&error.key, error.problem()))
}

fn machines(file: &File, document: &Document) -> Result<Machines, ConfigError> {
    let mut own = HashMap::new();
    for (index, entry) in file.machine.iter().enumerate() {
        let settings = entry
            .over(&file.machines)
            .map_err(|(key, problem)| document.complain(&format!("machine[{index}].{key}"), problem))?;
        if own.insert(entry.id(), settings).is_some() {
            let problem = format!("{} is described a second time", entry.id());
            return Err(document.complain(&format!("machine[{index}].machine"), problem));
        }
    }
    Ok(Machines::new(file.machines.clone(), own))
}

/// Longest name of a host.
const HOST_LENGTH: usize = 253;

/// Most machines with series of their own: four series each, and Prometheus is asked to take 1 MB a scrape at the most.
const MOST_SERIES: u32 = 20_000;
/// Characters of a token: a shorter one can be guessed, a longer one no form needs.
const TOKEN_LENGTH: RangeInclusive<usize> = 16..=256;

fn check_web(web: &Web, document: &Document) -> Result<(), ConfigError> {
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '.';
    for (index, host) in web.hosts.iter().enumerate() {
        if host.is_empty() || host.len() > HOST_LENGTH || !host.chars().all(fits) {
            let problem = format!("{host:?} is no name of a host: letters, digits, - and . without port");
            return Err(document.complain(&format!("web.hosts[{index}]"), problem));
        }
    }
    if web.machine_metrics > MOST_SERIES {
        return Err(
            document.complain("web.machine_metrics", format!("is {}, must be 0 to {MOST_SERIES}", web.machine_metrics))
        );
    }
    let token = web.token.as_ref().map(|Token(token)| token.chars().count());
    if token.is_some_and(|length| !TOKEN_LENGTH.contains(&length)) {
        return Err(document.complain("web.token", "must have 16 to 256 characters: a short secret can be guessed"));
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
