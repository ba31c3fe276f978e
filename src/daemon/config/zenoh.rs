//! The `[zenoh]` section: configuration of zenoh, merged into the defaults of this program.

use std::path::Path;

use toml::{Table, Value};

use super::{ConfigError, Document};

/// Keys of the TLS section that name a file, which must exist.
const FILE_KEYS: [&str; 5] =
    ["root_ca_certificate", "listen_certificate", "listen_private_key", "connect_certificate", "connect_private_key"];

/// The session of the daemon: the router of a cabinet, to which loggers and operators connect. By default it listens on
/// loopback only. It drops throws for slow subscribers: otherwise a subscriber that does not read would block the links
/// of the loggers for 5 s.
///
/// No timestamps: throws have their time in the payload.
pub(super) const MONITOR: &str = r#"
mode = "router"
listen.endpoints = ["tcp/127.0.0.1:7447"]
timestamping.enabled = false
qos.network = [{ messages = ["put"], flows = ["egress"], key_exprs = ["points/v1/*/*/throw"], overwrite = { congestion_control = "drop" } }]
"#;

/// The session of a logger or an operator: a client of the router.
pub(super) const CLIENT: &str = r#"
mode = "client"
connect.endpoints = ["tcp/127.0.0.1:7447"]
"#;

/// Settings of every session: endless retries of the connection, no discovery.
const COMMON: &str = "
connect.timeout_ms = -1
connect.exit_on_failure = false
scouting.multicast.enabled = false
scouting.gossip.enabled = false
transport.link.rx.max_message_size = 33554432
";

/// The default settings of a kind of session.
pub(super) fn base(kind: &str) -> Result<Table, toml::de::Error> {
    toml::from_str(&format!("{kind}{COMMON}"))
}

/// The configuration of a kind of session, with `section` merged into it.
pub(super) fn session_config(
    kind: &str,
    section: Option<&Table>,
    document: &Document,
) -> Result<zenoh::Config, ConfigError> {
    let invalid = |problem: String| document.complain("zenoh", problem);
    let mut merged = base(kind).map_err(|error| invalid(error.to_string()))?;
    if let Some(section) = section {
        overlay(&mut merged, section);
        check_files(section, document)?;
    }
    zenoh::Config::from_deserializer(Value::Table(merged)).map_err(|failure| match failure {
        Ok(_) => invalid("zenoh rejects the combination of values in this section".to_owned()),
        Err(error) => invalid(error.to_string()),
    })
}

/// Merges `over` into `base`: nested tables key by key, any other value replaces the one in `base`.
pub(crate) fn overlay(base: &mut Table, over: &Table) {
    for (key, value) in over {
        match (base.get_mut(key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => overlay(below, above),
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

fn check_files(section: &Table, document: &Document) -> Result<(), ConfigError> {
    let tls =
        ["transport", "link", "tls"].iter().try_fold(section, |table, key| table.get(*key).and_then(Value::as_table));
    let Some(tls) = tls else { return Ok(()) };
    for key in FILE_KEYS {
        if let Some(path) = tls.get(key).and_then(Value::as_str).filter(|path| !Path::new(path).is_file()) {
            let problem = format!("there is no file {path:?}");
            return Err(document.complain(&format!("zenoh.transport.link.tls.{key}"), problem));
        }
    }
    Ok(())
}
