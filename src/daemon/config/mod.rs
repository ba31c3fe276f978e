//! The configuration of `pointsd`. Every key has a default; `config/pointsd.toml` shows them all.

mod document;
mod machines;
mod operator;
mod pem;
mod token;
mod webhook;
mod zenoh;

use std::{collections::HashMap, fs, net::SocketAddr, ops::RangeInclusive, path::Path};

use rustix::fs::Access;
use serde::{Deserialize, Serialize};
use tracing_subscriber::filter::{LevelFilter, Targets};

#[cfg(test)]
pub(crate) use document::keys;
pub use document::{ConfigError, Document};
pub use machines::{MachineEntry, Machines};
pub use operator::{OperatorSession, operator_session};
pub use token::Token;
pub use webhook::Webhook;
pub(crate) use zenoh::{check_endpoint, overlay, set};

use crate::{
    bus::intersect,
    diagnose, estimate, store,
    throw::{MachineId, Name, Range::Within, settings},
    wire::{Kind, Scope, machine_key},
};

settings! {
    /// The `[monitor]` section: the name of this daemon.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Monitor {
        /// Site of this daemon, the first part of its name.
        pub site: Name = Name::fixed("fleet");
        /// Identifier of this daemon at the site. Its liveliness token is `points/v1/{site}/monitor/{id}/alive`.
        pub id: Name = Name::fixed("pointsd");
        /// Other daemons that this one watches.
        pub peers: Vec<Peer> = Vec::new();
    }
}

/// The name of another daemon.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Peer {
    /// Its `monitor.site`.
    pub site: Name,
    /// Its `monitor.id`.
    pub id: Name,
}

impl Monitor {
    /// The name of the daemon in the form of a machine's, for the alarms about the daemon itself.
    pub(crate) fn as_machine(&self) -> MachineId {
        MachineId { site: self.site.clone(), machine: self.id.clone() }
    }

    /// The reason why this name is reserved; `None` if a machine may have it.
    pub(crate) fn reserves(&self, machine: &MachineId) -> Option<String> {
        if machine.site == self.site && machine.machine == self.id {
            Some("this is the name of pointsd itself (monitor.site, monitor.id): a machine needs another".to_owned())
        } else if machine.machine.as_str() == store::ALL_MACHINES {
            let name = store::ALL_MACHINES;
            Some(format!("{name} is the name of the common alarms of a site: a machine needs another"))
        } else {
            None
        }
    }

    /// The names of the watched daemons, in the form of machines' names.
    pub(super) fn watched(&self) -> impl Iterator<Item = MachineId> {
        self.peers.iter().map(|peer| MachineId { site: peer.site.clone(), machine: peer.id.clone() })
    }
}

settings! {
    /// The `[subscribe]` section: which throws the daemon receives, and how many.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Subscribe {
        /// The monitored part of the fleet: `points/v1/**`, `points/v1/{site}/**` or `points/v1/{site}/{machine}/**`.
        pub key: Scope = Scope::default();
        /// Largest throw message \[bytes\], 1,024 to 33,554,432. Larger messages go to quarantine.
        pub max_payload_bytes: usize = 16 << 20, Within(1024.0, f64::from(32 << 20), "bytes");
        /// Largest number of machines, 1 to 100,000. Throws of further machines go to quarantine, as an attacker could
        /// publish on any number of keys.
        pub max_machines: usize = 10_000, Within(1.0, 100_000.0, "machines");
        /// Longest time \[s\] that the throws after a gap wait for missing throws from the backlog, 0 to 86,400. The
        /// time starts again with each missing throw that arrives, and at the start of pointsd.
        pub backlog_wait_s: f64 = 60.0, Within(0.0, 86_400.0, "s");
    }
}

impl Subscribe {
    /// Whether the key includes a machine.
    pub(super) fn serves(&self, machine: &MachineId) -> bool {
        intersect(&self.key.key_expression(Kind::Throw), &machine_key(machine, Kind::Throw))
    }
}

settings! {
    /// The `[identify]` section: threads of the estimator.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Identify {
        /// Number of threads, 0 to 64; 0 means the number of processors, at most 8.
        pub threads: usize = 0, Within(0.0, 64.0, "threads");
    }
}

settings! {
    /// The `[web]` section: the dashboard and the metrics.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Web {
        /// Address and port; without them there is no dashboard. Every client that reaches the port can read the pages.
        pub listen: Option<SocketAddr> = None;
        /// Host names under which browsers may open the pages, in addition to IP addresses and `localhost`.
        pub hosts: Vec<String> = Vec::new();
        /// Largest fleet \[machines\] with series for each machine in `/metrics`, 0 to 20,000; a larger fleet has only
        /// totals.
        pub machine_metrics: u32 = 1_000, Within(0.0, f64::from(MOST_SERIES), "");
        /// Secret for operators' commands from pages, 16 to 256 characters; without it the pages are read-only.
        pub token: Option<Token> = None;
    }
}

/// Format of log lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LogFormat {
    /// Text for people.
    Text,
    /// One JSON object per line.
    Json,
}

settings! {
    /// The `[log]` section.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Log {
        /// `error`, `warn`, `info`, `debug`, `trace`, or directives by module as `info,zenoh=debug`.
        pub level: String = "info,zenoh=warn".to_owned();
        /// Format of the lines.
        pub format: LogFormat = LogFormat::Text;
    }
}

/// The configuration of `pointsd`, with the sections of its file. `Default` only fills missing sections: its zenoh
/// session is not that of a daemon.
#[derive(Debug, Clone, Default, Deserialize)]
#[cfg_attr(test, derive(Serialize))]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Name of this daemon.
    pub monitor: Monitor,
    /// Received throws.
    pub subscribe: Subscribe,
    /// Threads of the estimator.
    pub identify: Identify,
    /// The database.
    pub store: store::Settings,
    /// Limits of the diagnosis.
    pub diagnosis: diagnose::Settings,
    /// The section `[machines]`.
    #[serde(rename = "machines")]
    pub(super) machine_defaults: estimate::Settings,
    /// The sections `[[machine]]`.
    #[serde(rename = "machine", skip_serializing)]
    pub(super) machine_entries: Vec<MachineEntry>,
    /// Settings of the estimator for each machine, from the two fields above.
    #[serde(skip)]
    pub machines: Machines,
    /// The dashboard.
    pub web: Web,
    /// The HTTP server of the operator to which alarm events are posted, and which events these are.
    pub webhook: Webhook,
    /// Log lines.
    pub log: Log,
    /// The zenoh session. The section is first parsed as zenoh's own type, for errors with a position. Then it is
    /// merged into the defaults of a daemon.
    #[serde(skip_serializing)]
    pub zenoh: ::zenoh::Config,
}

impl Config {
    /// Loads and checks a file, or the built-in defaults without one.
    ///
    /// # Errors
    /// The first error, with file, line and key.
    pub fn load(file: Option<&Path>) -> Result<Self, ConfigError> {
        Self::from_document(&Document::read_or_empty(file)?)
    }

    /// Warnings about settings that are valid and have no effect.
    pub fn warnings(&self) -> Vec<String> {
        let other = self.machine_entries.iter().map(MachineEntry::id).filter(|machine| !self.subscribe.serves(machine));
        let other =
            other.map(|id| format!("[[machine]] {id}: has no effect, as subscribe.key does not include this machine"));
        let web = (self.web.listen.is_none() && self.web != Web::default())
            .then(|| "[web]: has no effect without web.listen".to_owned());
        let webhook = (self.webhook.url.is_none() && self.webhook != Webhook::default())
            .then(|| "[webhook]: has no effect without webhook.url".to_owned());
        other.chain(web).chain(webhook).collect()
    }

    /// Checks a document.
    ///
    /// # Errors
    /// The first error, with file, line and key.
    pub fn from_document(document: &Document) -> Result<Self, ConfigError> {
        // First, as its errors explain more than those of zenoh's own type.
        let section = section(document)?;
        let config = Self::offline(document)?;
        check_web(&config.web, document)?;
        config.webhook.check(document)?;
        check_log(&config.log, document)?;
        check_database_path(&config.store.path, document)?;
        let session = checked_session(zenoh::MONITOR, section.as_ref(), document)?;
        if let Some(address) = config.web.listen.filter(|address| zenoh::listens_on(&session, address)) {
            let problem = format!("{address} is an address of zenoh.listen.endpoints: choose another port");
            return Err(document.error_at("web.listen", problem));
        }
        Ok(Self { zenoh: session, ..config })
    }

    /// Checks the settings that change judgements, for a command without a daemon: its user may have no right to the
    /// files and folders that the other settings name.
    ///
    /// # Errors
    /// The first error of these settings, with file, line and key.
    pub fn offline(document: &Document) -> Result<Self, ConfigError> {
        let config: Self = document.deserialize()?;
        check_ranges(&config, document)?;
        check_names(&config.monitor, document)?;
        let machines = machines(&config, document)?;
        Ok(Self { machines, ..config })
    }
}

fn check_ranges(config: &Config, document: &Document) -> Result<(), ConfigError> {
    document.in_section("identify", config.identify.check_ranges())?;
    document.in_section("subscribe", config.subscribe.check_ranges())?;
    document.in_section("store", config.store.check_ranges())?;
    document.in_section("diagnosis", config.diagnosis.validate())?;
    document.in_section("machines", config.machine_defaults.check_ranges())
}

fn check_names(monitor: &Monitor, document: &Document) -> Result<(), ConfigError> {
    if monitor.id.as_str() == store::ALL_MACHINES {
        return Err(document.error_at("monitor.id", "is the name of the common alarms of a site: choose another"));
    }
    match monitor.watched().position(|peer| peer == monitor.as_machine()) {
        Some(index) => Err(document.error_at(&format!("monitor.peers[{index}]"), "is this daemon itself")),
        None => Ok(()),
    }
}

fn machines(config: &Config, document: &Document) -> Result<Machines, ConfigError> {
    let mut overrides = HashMap::new();
    for (index, entry) in config.machine_entries.iter().enumerate() {
        let settings = entry
            .over(&config.machine_defaults)
            .map_err(|(key, problem)| document.error_at(&format!("machine[{index}].{key}"), problem))?;
        if overrides.insert(entry.id(), settings).is_some() {
            let problem = format!("{} is described a second time", entry.id());
            return Err(document.error_at(&format!("machine[{index}].machine"), problem));
        }
    }
    Ok(Machines { default: config.machine_defaults.clone(), overrides })
}

/// Sections that only the configuration file of a daemon has.
const DAEMON_SECTIONS: [&str; 9] =
    ["monitor", "subscribe", "identify", "store", "diagnosis", "machines", "machine", "web", "webhook"];

/// Checks the names of the sections, for a command that reads only some of them.
///
/// # Errors
/// The first section that the configuration of a daemon does not have.
pub(crate) fn check_sections(document: &Document) -> Result<(), ConfigError> {
    let file: toml::Table = document.deserialize()?;
    let known = || DAEMON_SECTIONS.into_iter().chain(["log", "zenoh"]);
    file.keys().find(|name| known().all(|known| known != name.as_str())).map_or(Ok(()), |name| {
        let known = known().collect::<Vec<_>>().join(", ");
        Err(document.error_at(name, format!("unknown section, expected one of {known}")))
    })
}

/// The `[diagnosis]` section alone, for a command that only reads the database: its user may have no right to the files
/// that the other sections name.
///
/// # Errors
/// The first error of this section.
pub fn diagnosis(document: &Document) -> Result<diagnose::Settings, ConfigError> {
    #[derive(Deserialize)]
    struct Section {
        #[serde(default)]
        diagnosis: diagnose::Settings,
    }
    let Section { diagnosis } = document.deserialize()?;
    document.in_section("diagnosis", diagnosis.validate())?;
    Ok(diagnosis)
}

/// Longest host name \[characters\].
const HOST_LENGTH: usize = 253;

/// Bound of `machine_metrics`. A machine has two series, and up to two more for each drift, of 70 bytes each, or 170 with
/// the longest names: a scrape is 3 to 18 MB, and a fortieth of that compressed.
const MOST_SERIES: u32 = 20_000;
/// Length of a token \[characters\]: a shorter one could be guessed.
const TOKEN_LENGTH: RangeInclusive<usize> = 16..=256;

fn check_web(web: &Web, document: &Document) -> Result<(), ConfigError> {
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '.';
    for (index, host) in web.hosts.iter().enumerate() {
        if host.is_empty() || host.len() > HOST_LENGTH || !host.chars().all(fits) {
            let problem = format!("{host:?} is not a host name: letters, digits, - and . without port");
            return Err(document.error_at(&format!("web.hosts[{index}]"), problem));
        }
    }
    document.in_section("web", web.check_ranges())?;
    let token = web.token.as_ref().map(|token| token.secret().chars().count());
    if token.is_some_and(|length| !TOKEN_LENGTH.contains(&length)) {
        let (least, most) = TOKEN_LENGTH.into_inner();
        let problem = format!("must have {least} to {most} characters: a short secret can be guessed");
        return Err(document.error_at("web.token", problem));
    }
    Ok(())
}

/// Checks the `[log]` section.
pub(crate) fn check_log(log: &Log, document: &Document) -> Result<(), ConfigError> {
    // The filter accepts any other word as the name of a module: it would log all lines of this module and nothing
    // else.
    // An empty level would stop all lines.
    let is_wrong = |part: &&str| {
        log.level.is_empty()
            || part.contains(char::is_whitespace)
            || !part.contains('=') && part.parse::<LevelFilter>().is_err()
    };
    if let Some(part) = log.level.split(',').find(is_wrong) {
        let problem = format!(
            "{part:?} is not a level: write error, warn, info, debug or trace, for a module zenoh=debug, and no spaces"
        );
        return Err(document.error_at("log.level", problem));
    }
    log.level
        .parse::<Targets>()
        .map(drop)
        .map_err(|error| document.error_at("log.level", format!("{:?}: {error}", log.level)))
}

/// Checks that the folder of the database exists and is writable.
fn check_database_path(path: &Path, document: &Document) -> Result<(), ConfigError> {
    let invalid = |problem: String| Err(document.error_at("store.path", problem));
    if fs::metadata(path).is_ok_and(|at| !at.is_file()) {
        return invalid(format!("{} is a folder or a device, must be a file", path.display()));
    }
    if path.file_name().is_none() {
        return invalid(format!("{} is not a file name", path.display()));
    }
    // Behind an administrator's link, the files are in another folder. The lock file is beside the link.
    for path in [path, &store::database_path(path)] {
        let parent = store::folder_of(path);
        match fs::metadata(parent) {
            Ok(folder) if !folder.is_dir() => return invalid(format!("{} is not a folder", parent.display())),
            Ok(_) if rustix::fs::access(parent, Access::WRITE_OK | Access::EXEC_OK).is_err() => {
                return invalid(format!("this user cannot write to the folder {}", parent.display()));
            }
            Ok(_) => {}
            Err(error) => return invalid(format!("the folder {} of the database: {error}", parent.display())),
        }
    }
    Ok(())
}

/// The `[zenoh]` section as written in the file.
fn section(document: &Document) -> Result<Option<toml::Table>, ConfigError> {
    #[derive(Deserialize)]
    struct Section {
        zenoh: Option<toml::Table>,
    }
    let Section { zenoh } = document.deserialize()?;
    zenoh.iter().try_for_each(|section| zenoh::check_sides(section, document))?;
    Ok(zenoh)
}

fn checked_session(
    kind: &str,
    section: Option<&toml::Table>,
    document: &Document,
) -> Result<::zenoh::Config, ConfigError> {
    let session = zenoh::session_config(kind, section, document)?;
    zenoh::check_links(&session, document)?;
    if let Some(section) = section {
        // Errors that zenoh would report only at the start of a session that listens.
        zenoh::check_endpoints(section, document)?;
        zenoh::check_access(section, document)?;
        zenoh::check_certificates(section, document)?;
    }
    Ok(session)
}

/// The session of a logger or an operator: a client of the router on loopback, with the `[zenoh]` of the file.
///
/// # Errors
/// When zenoh rejects the section.
pub fn client_session(document: &Document) -> Result<::zenoh::Config, ConfigError> {
    checked_session(zenoh::CLIENT, section(document)?.as_ref(), document)
}

#[cfg(test)]
mod tests;
