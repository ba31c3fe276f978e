//! The `[zenoh]` section: the configuration of zenoh, which is merged into the defaults of this program.

use std::{collections::HashSet, net::SocketAddr, path::Path};

use toml::{Table, Value};

use super::{ConfigError, Document, pem};
use crate::bus::mode;

/// Keys of the TLS section whose values are files, which must exist.
const FILE_KEYS: [&str; 5] =
    ["root_ca_certificate", "listen_certificate", "listen_private_key", "connect_certificate", "connect_private_key"];

/// Default settings of the daemon's session: the router of a cabinet, to which loggers and operators connect. It
/// listens on loopback only. It drops throws for slow subscribers: otherwise a subscriber that does not read would
/// block the links of the loggers for 5 s. Zenoh adds no timestamps, as throws have their time in the payload.
pub(super) const MONITOR: &str = r#"
mode = "router"
listen.endpoints = ["tcp/127.0.0.1:7447"]
timestamping.enabled = false
qos.network = [{ messages = ["put"], flows = ["egress"], key_exprs = ["points/v1/*/*/throw"], overwrite = { congestion_control = "drop" } }]
"#;

/// Default settings of the session of a logger or an operator: a client of the router.
pub(super) const CLIENT: &str = r#"
mode = "client"
connect.endpoints = ["tcp/127.0.0.1:7447"]
"#;

/// Default settings of every session: endless retries of the connection, and no discovery of other sessions.
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

/// The configuration of a kind of session ([`MONITOR`] or [`CLIENT`]), with `section` merged into it.
pub(super) fn session_config(
    kind: &str,
    section: Option<&Table>,
    document: &Document,
) -> Result<zenoh::Config, ConfigError> {
    let invalid = |problem: String| document.error_at("zenoh", problem);
    let mut merged = base(kind).map_err(|error| invalid(error.to_string()))?;
    if let Some(section) = section {
        overlay(&mut merged, section);
        check_each_file(section, document, |_, file| {
            if Path::new(file).is_file() { Ok(()) } else { Err(format!("there is no file {file:?}")) }
        })?;
    }
    zenoh::Config::from_deserializer(Value::Table(merged)).map_err(|failure| match failure {
        Ok(_) => invalid("zenoh rejects the combination of values in this section".to_owned()),
        Err(error) => invalid(error.to_string()),
    })
}

/// Merges `over` into `base`. Nested tables are merged key by key; any other value replaces the value in `base`.
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

/// Sets the value at a path of keys, in tables that are created if needed.
pub(crate) fn set(table: &mut Table, path: &[&str], value: Value) {
    let nested = path.iter().rfold(value, |inner, key| Table::from_iter([((*key).to_owned(), inner)]).into());
    if let Value::Table(nested) = nested {
        overlay(table, &nested);
    }
}

/// The value at a path of keys.
pub(super) fn find<'a>(table: &'a Table, path: &[&str]) -> Option<&'a Value> {
    let (last, above) = path.split_last()?;
    above.iter().try_fold(table, |table, key| table.get(*key)?.as_table())?.get(*last)
}

fn tls(section: &Table) -> Option<&Table> {
    find(section, &["transport", "link", "tls"])?.as_table()
}

/// Checks each file of the TLS section; `check` gets its key and its path.
fn check_each_file(
    section: &Table,
    document: &Document,
    check: impl Fn(&str, &str) -> Result<(), String>,
) -> Result<(), ConfigError> {
    let Some(tls) = tls(section) else { return Ok(()) };
    for key in FILE_KEYS {
        let Some(file) = tls.get(key).and_then(Value::as_str) else { continue };
        check(key, file).map_err(|problem| document.error_at(&format!("zenoh.transport.link.tls.{key}"), problem))?;
    }
    Ok(())
}

/// Reads the certificates and private keys. Zenoh would fail with a damaged one only at the start of the session.
pub(super) fn check_certificates(section: &Table, document: &Document) -> Result<(), ConfigError> {
    check_each_file(section, document, |key, file| {
        let file = Path::new(file);
        if key.ends_with("private_key") { pem::check_private_key(file) } else { pem::certificates(file).map(drop) }
    })
}

/// Rejects a list of endpoints in place of the table `listen` or `connect`. Zenoh's own error is only that it expected
/// an integer.
pub(super) fn check_sides(section: &Table, document: &Document) -> Result<(), ConfigError> {
    let is_wrong = |side: &&str| section.get(*side).is_some_and(|value| !value.is_table());
    ["listen", "connect"].into_iter().find(is_wrong).map_or(Ok(()), |side| {
        let problem = format!("is a table: write {side}.endpoints = [\"tcp/HOST:7447\"]");
        Err(document.error_at(&format!("zenoh.{side}"), problem))
    })
}

/// Checks the endpoints. Zenoh would fail with a wrong one only at the start of the session.
pub(super) fn check_endpoints(section: &Table, document: &Document) -> Result<(), ConfigError> {
    let has =
        |key: &str| tls(section).is_some_and(|tls| tls.contains_key(key) || tls.contains_key(&format!("{key}_base64")));
    let has_certificate = has("listen_certificate") && has("listen_private_key");
    for side in ["listen", "connect"] {
        let Some(endpoints) = section.get(side).and_then(|table| table.get("endpoints")) else { continue };
        for (key, endpoint) in texts(&format!("zenoh.{side}.endpoints"), endpoints) {
            check_endpoint(endpoint, side == "listen" && !has_certificate)
                .map_err(|problem| document.error_at(&key, format!("{endpoint:?}: {problem}")))?;
        }
    }
    Ok(())
}

/// Least values of whole numbers with which a session has links, and receives throws of some thousand samples. Zenoh
/// drops a larger message, and neither zenoh nor this program reports it.
const LEAST: [(&str, u64); 2] = [("transport.unicast.max_sessions", 1), ("transport.link.rx.max_message_size", 65_536)];

/// The value at a path in the configuration of a session.
fn value(session: &zenoh::Config, path: &str) -> serde_json::Value {
    session.get_json(path).ok().and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default()
}

/// The value of the endpoints of one side in a mode. Zenoh accepts one list, or a list for each mode.
pub(super) fn endpoints(session: &zenoh::Config, side: &str, mode: &str) -> serde_json::Value {
    let endpoints = value(session, &format!("{side}/endpoints"));
    endpoints.get(mode).cloned().unwrap_or(endpoints)
}

/// Checks that a session can have links, and that they carry throws.
pub(super) fn check_links(session: &zenoh::Config, document: &Document) -> Result<(), ConfigError> {
    for (key, least) in LEAST {
        if let Some(number) = value(session, &key.replace('.', "/")).as_u64().filter(|number| *number < least) {
            return Err(document.error_at(&format!("zenoh.{key}"), format!("is {number}, must be at least {least}")));
        }
    }
    let mode = mode(session);
    let none = [serde_json::json!([]), serde_json::Value::Null];
    let has = |side: &str| !none.contains(&endpoints(session, side, &mode));
    let is_client = mode == "client";
    if has("connect") || !is_client && has("listen") || value(session, "scouting/multicast/enabled") == true {
        return Ok(());
    }
    let problem = if is_client {
        "mode = \"client\" needs the endpoint of a router: connect.endpoints = [\"tcp/HOST:7447\"]"
    } else {
        "without listen.endpoints and connect.endpoints there are no links"
    };
    Err(document.error_at(if is_client { "zenoh.mode" } else { "zenoh.listen.endpoints" }, problem))
}

/// Whether the session listens on an address.
pub(super) fn listens_on(session: &zenoh::Config, address: &SocketAddr) -> bool {
    let covers = |one: &SocketAddr, other: &SocketAddr| {
        one.ip() == other.ip() || one.ip().is_unspecified() && (one.is_ipv6() || other.is_ipv4())
    };
    let mode = mode(session);
    let listed = endpoints(session, "listen", &mode);
    let addresses = listed.as_array().into_iter().flatten().filter_map(|endpoint| {
        let (protocol, address) = address_of(endpoint.as_str()?).split_once('/')?;
        matches!(protocol, "tcp" | "tls" | "ws").then_some(address)?.parse::<SocketAddr>().ok()
    });
    let is_same = |other: SocketAddr| {
        other.port() == address.port() && other.port() != 0 && (covers(&other, address) || covers(address, &other))
    };
    mode != "client" && addresses.into_iter().any(is_same)
}

/// The texts in a value, each with its key. A value of endpoints is a list, a table of lists for each mode, or of
/// groups of locators.
fn texts<'a>(key: &str, value: &'a Value) -> Vec<(String, &'a str)> {
    match value {
        Value::String(text) => vec![(key.to_owned(), text)],
        Value::Array(values) => {
            values.iter().enumerate().flat_map(|(at, value)| texts(&format!("{key}[{at}]"), value)).collect()
        }
        Value::Table(table) => {
            let lists = table.iter().filter(|(name, _)| *name != "strategy");
            lists.flat_map(|(name, value)| texts(&format!("{key}.{name}"), value)).collect()
        }
        _ => Vec::new(),
    }
}

/// An endpoint without the parameters after `?` or `#`.
pub(super) fn address_of(endpoint: &str) -> &str {
    endpoint.split(['?', '#']).next().unwrap_or(endpoint)
}

/// Checks an endpoint of the form `tcp/HOST:PORT`, with parameters after `?` or `#`.
pub(crate) fn check_endpoint(endpoint: &str, lacks_certificate: bool) -> Result<(), &'static str> {
    let (protocol, rest) = endpoint.split_once('/').ok_or("write tcp/HOST:PORT or tls/HOST:PORT")?;
    if !matches!(protocol, "tcp" | "tls") {
        return Err("this program has the protocols tcp and tls only");
    }
    let (host, port) = address_of(rest).rsplit_once(':').ok_or("the port is missing: write HOST:7447")?;
    if host.is_empty() {
        return Err("the host is missing: write HOST:7447, with 0.0.0.0 or [::] for every address of this computer");
    }
    port.parse::<u16>().map_err(|_| "the port must be 0 to 65535")?;
    if protocol == "tls" && lacks_certificate && !rest.contains('#') {
        return Err("needs zenoh.transport.link.tls.listen_certificate and listen_private_key");
    }
    Ok(())
}

/// Checks that the policies of the access control name existing rules and subjects, and that no `id` is used twice.
pub(super) fn check_access(section: &Table, document: &Document) -> Result<(), ConfigError> {
    let Some(access) = section.get("access_control").and_then(Value::as_table) else { return Ok(()) };
    if access.get("enabled").and_then(Value::as_bool) != Some(true) {
        return Ok(());
    }
    let list = |key: &str| access.get(key).and_then(Value::as_array).map(Vec::as_slice);
    let (Some(rules), Some(subjects), Some(policies)) = (list("rules"), list("subjects"), list("policies")) else {
        let problem = "with enabled = true, rules, subjects and policies must be given";
        return Err(document.error_at("zenoh.access_control", problem));
    };
    let mut names = [("rules", rules), ("subjects", subjects)].map(|(kind, list)| (kind, list, HashSet::new()));
    for (kind, list, known) in &mut names {
        for (at, id) in list.iter().enumerate().filter_map(|(at, entry)| Some((at, entry.get("id")?.as_str()?))) {
            if !known.insert(id) {
                let problem = format!("{id:?} is described a second time");
                return Err(document.error_at(&format!("zenoh.access_control.{kind}[{at}].id"), problem));
            }
        }
    }
    for (at, policy) in policies.iter().enumerate() {
        for (kind, _, known) in &names {
            let key = format!("zenoh.access_control.policies[{at}].{kind}");
            let named = policy.get(kind).map(|value| texts(&key, value)).unwrap_or_default();
            if named.is_empty() {
                return Err(document.error_at(&key, "must name at least one"));
            }
            if let Some((key, name)) = named.into_iter().find(|(_, name)| !known.contains(name)) {
                return Err(document.error_at(&key, format!("{name:?} is not in zenoh.access_control.{kind}")));
            }
        }
    }
    Ok(())
}
