//! The zenoh session of an operator's command. With the configuration file of a daemon, it always connects to this
//! daemon.

use toml::{Table, Value};

use super::{
    Config, ConfigError, DAEMON_SECTIONS, Document, section,
    zenoh::{self as sessions, find, set},
};
use crate::throw::MachineId;

/// Sections that only the file of `pointsim` has; its `[zenoh]` section is that of a client.
const LOGGER_SECTIONS: [&str; 2] = ["logger", "fleet"];
/// Keys of a daemon's TLS section that are valid for its clients too.
const SHARED_TLS: [&str; 4] =
    ["root_ca_certificate", "root_ca_certificate_base64", "enable_mtls", "verify_name_on_connect"];
/// Keys for the certificate of a client, each with the key of the daemon's certificate that is used if it is missing.
const CLIENT_TLS: [(&str, &str); 4] = [
    ("connect_certificate", "listen_certificate"),
    ("connect_private_key", "listen_private_key"),
    ("connect_certificate_base64", "listen_certificate_base64"),
    ("connect_private_key_base64", "listen_private_key_base64"),
];

/// The connection of an operator's command to its daemon.
#[derive(Debug, Clone)]
pub struct OperatorSession {
    /// The zenoh session.
    pub zenoh: ::zenoh::Config,
    /// Endpoints to connect to.
    pub endpoints: Vec<String>,
    /// Name of the daemon whose file was given; `None` for the file of a client and without a file.
    pub monitor: Option<MachineId>,
}

/// The session of an operator's command: a client of the endpoint `connect`, or of the daemon or router in the file.
/// The built-in endpoint is used only without both.
///
/// # Errors
/// When the file is invalid, or has no endpoint for a client.
pub fn operator_session(file: Option<&Document>, connect: Option<&str>) -> Result<OperatorSession, ConfigError> {
    let none = Document::read_or_empty(None)?;
    let document = file.unwrap_or(&none);
    let table: Table = document.deserialize()?;
    let zenoh = section(document)?.unwrap_or_default();
    let monitor = match file {
        Some(document) if describes_daemon(&table, &zenoh) => {
            Some(document.deserialize::<Config>()?.monitor.as_machine())
        }
        _ => None,
    };
    let (mut client, endpoints) = match (&monitor, file) {
        (Some(_), _) => (client_of(&zenoh), daemon_endpoints(document, &zenoh)),
        (None, Some(_)) => (zenoh.clone(), client_endpoints(document, &zenoh)),
        (None, None) => (Table::new(), Ok(vec!["tcp/127.0.0.1:7447".to_owned()])),
    };
    let endpoints = connect.map_or(endpoints, |endpoint| Ok(vec![endpoint.to_owned()]))?;
    set(&mut client, &["connect", "endpoints"], endpoints.clone().into());
    Ok(OperatorSession {
        zenoh: sessions::session_config(sessions::CLIENT, Some(&client), document)?,
        endpoints,
        monitor,
    })
}

/// Whether a file is the configuration of a daemon. A file with only a `[zenoh]` section belongs to a client if it has
/// endpoints to connect to and none to listen on.
fn describes_daemon(file: &Table, zenoh: &Table) -> bool {
    if DAEMON_SECTIONS.iter().any(|name| file.contains_key(*name)) {
        return true;
    }
    let is_client = zenoh.get("mode").and_then(Value::as_str) == Some("client")
        || (find(zenoh, &["connect", "endpoints"]).is_some() && find(zenoh, &["listen", "endpoints"]).is_none())
        || LOGGER_SECTIONS.iter().any(|name| file.contains_key(*name));
    !is_client
}

/// The `[zenoh]` section for a client of a daemon, made from the section of the daemon.
fn client_of(zenoh: &Table) -> Table {
    let mut client = Table::new();
    let mut copy = |path: &[&str], from: &[&str]| {
        if let Some(value) = find(zenoh, path).or_else(|| find(zenoh, from)) {
            set(&mut client, path, value.clone());
        }
    };
    for key in ["protocols", "rx"] {
        copy(&["transport", "link", key], &["transport", "link", key]);
    }
    for (key, of_daemon) in SHARED_TLS.map(|key| (key, key)).into_iter().chain(CLIENT_TLS) {
        copy(&["transport", "link", "tls", key], &["transport", "link", "tls", of_daemon]);
    }
    let login = ["user", "password"].map(|key| ["transport", "auth", "usrpwd", key]);
    if login.iter().all(|path| find(zenoh, path).is_some()) {
        for path in &login {
            copy(path, path);
        }
    }
    client
}

/// Endpoints at which a client reaches the daemon of this file: those on which the daemon listens, or else its
/// router's.
fn daemon_endpoints(document: &Document, zenoh: &Table) -> Result<Vec<String>, ConfigError> {
    // Only the endpoints are needed. The TLS files in `transport` may be readable for the daemon only.
    let mut without_files = zenoh.clone();
    without_files.remove("transport");
    let config = sessions::session_config(sessions::MONITOR, Some(&without_files), document)?;
    let mode = zenoh.get("mode").and_then(Value::as_str).unwrap_or("router");
    let listens = if mode == "client" { Vec::new() } else { endpoints(&config, "listen", mode) };
    let reached: Vec<String> = listens.iter().filter_map(|endpoint| from_here(endpoint)).collect();
    match (reached.is_empty(), listens.is_empty()) {
        (false, _) => Ok(reached),
        (true, false) => Err(document.error_at(
            "zenoh.listen.endpoints",
            "the system chooses the port at each start: give --connect with the endpoint in the daemon's log",
        )),
        (true, true) => match endpoints(&config, "connect", mode) {
            none if none.is_empty() => Err(document
                .error_at("zenoh", "this daemon has no endpoint: give --connect with the endpoint of its router")),
            routers => Ok(routers),
        },
    }
}

fn client_endpoints(document: &Document, zenoh: &Table) -> Result<Vec<String>, ConfigError> {
    let config = sessions::session_config(sessions::CLIENT, Some(zenoh), document)?;
    if find(zenoh, &["connect", "endpoints"]).is_none() {
        let problem = "names no daemon: give --connect tls/HOST:7447, or write connect.endpoints = [\"tls/HOST:7447\"]";
        return Err(document.error_at("zenoh.connect.endpoints", problem));
    }
    sessions::check_endpoints(zenoh, document)?;
    Ok(endpoints(&config, "connect", "client"))
}

/// The endpoints of a session in a mode.
fn endpoints(config: &::zenoh::Config, side: &str, mode: &str) -> Vec<String> {
    serde_json::from_value(sessions::endpoints(config, side, mode)).unwrap_or_default()
}

/// Converts an endpoint on which a daemon listens into one for a client on this computer; `None` if the system chooses
/// the port.
fn from_here(endpoint: &str) -> Option<String> {
    let bare = sessions::address_of(endpoint);
    let (protocol, address) = bare.split_once('/')?;
    let Some((host, port)) = address.rsplit_once(':') else { return Some(bare.to_owned()) };
    let host = match host {
        "0.0.0.0" => "127.0.0.1",
        "[::]" | "*" => "[::1]",
        host => host,
    };
    (port != "0").then(|| format!("{protocol}/{host}:{port}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn session(text: &str) -> Result<OperatorSession, ConfigError> {
        operator_session(Some(&Document::parse("b.toml".as_ref(), text.to_owned())?), None)
    }

    #[test]
    fn a_daemons_file_leads_to_that_daemon() {
        for (text, endpoint) in [
            ("[store]\npath = \"b.db\"\n", "tcp/127.0.0.1:7447"),
            ("[zenoh]\nlisten.endpoints = [\"tcp/127.0.0.1:7647\"]\n", "tcp/127.0.0.1:7647"),
            (
                "[monitor]\nid = \"b\"\n[zenoh]\nlisten.endpoints = [\"tcp/0.0.0.0:7647#iface=lo\"]\n",
                "tcp/127.0.0.1:7647",
            ),
            ("[zenoh]\nlisten.endpoints = { router = [\"tcp/[::]:7647\"], peer = [] }\n", "tcp/[::1]:7647"),
            ("[store]\n[zenoh]\nmode = \"client\"\nconnect.endpoints = [\"tcp/r:1\"]\n", "tcp/r:1"),
            ("[store]\n[zenoh]\nlisten.endpoints = []\nconnect.endpoints = [\"tcp/r:1\"]\n", "tcp/r:1"),
            // A daemon that listens, and also connects to a router: a client connects to the daemon.
            (
                "[store]\n[zenoh]\nlisten.endpoints = [\"tcp/10.0.0.1:2\"]\nconnect.endpoints = [\"tcp/r:1\"]\n",
                "tcp/10.0.0.1:2",
            ),
        ] {
            let found = session(text).unwrap();
            assert_eq!(found.endpoints, [endpoint], "{text}");
            assert!(found.monitor.is_some(), "{text}");
            assert_eq!(endpoints(&found.zenoh, "connect", "client"), [endpoint], "{text}");
            assert_eq!(found.zenoh.get_json("mode").unwrap(), "\"client\"", "{text}");
        }
        let named = session("[monitor]\nsite = \"north\"\nid = \"b\"\n").unwrap();
        assert_eq!(named.monitor.unwrap().to_string(), "north/b");
    }

    #[test]
    fn a_clients_file_is_used_as_it_is() {
        let client = session("[zenoh]\nmode = \"client\"\nconnect.endpoints = [\"tcp/h:1\"]\n").unwrap();
        assert_eq!((client.endpoints, client.monitor), (vec!["tcp/h:1".to_owned()], None));
        assert!(session("[zenoh]\nconnect.endpoints = [\"tcp/h:1\"]\n").unwrap().monitor.is_none());
        let simulator = session("[fleet]\nmachines = 1\n[zenoh]\nconnect.endpoints = [\"tcp/h:1\"]\n").unwrap();
        assert!(simulator.monitor.is_none());
    }

    #[test]
    fn a_file_that_names_no_endpoint_never_leads_to_the_default_one() {
        for (text, expected) in [
            ("[zenoh]\nmode = \"client\"\n", "zenoh.connect.endpoints: names no daemon: give --connect"),
            ("[store]\n[zenoh]\nlisten.endpoints = [\"tcp/127.0.0.1:0\"]\n", "the system chooses the port"),
            ("[store]\n[zenoh]\nlisten.endpoints = []\n", "has no endpoint"),
            ("[store]\nsise = 1\n", "b.toml:2: store.sise: unknown field"),
            ("[zenoh]\nmode = \"client\"\nconnect.endpoints = [\"tcp/h\"]\n", "\"tcp/h\": the port is missing"),
        ] {
            let error = session(text).unwrap_err().to_string();
            assert!(error.starts_with("b.toml:") && error.contains(expected), "{text}: {error}");
        }
        let connect = |text: &str| {
            let document = Document::parse("b.toml".as_ref(), text.to_owned()).unwrap();
            operator_session(Some(&document), Some("tcp/h:9")).unwrap()
        };
        assert_eq!(connect("[zenoh]\nmode = \"client\"\n").endpoints, ["tcp/h:9"]);
        assert_eq!(connect("[zenoh]\nlisten.endpoints = [\"tcp/127.0.0.1:0\"]\n").endpoints, ["tcp/h:9"]);
    }

    #[test]
    fn certificates_come_from_the_daemons_file_and_must_be_there() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, "").unwrap();
            path.display().to_string()
        };
        let (ca, cert, key) = (file("ca.pem"), file("cert.pem"), file("key.pem"));
        let daemon = |cert: &str| {
            format!(
                "[zenoh]\nlisten.endpoints = [\"tls/[::]:7447\"]\naccess_control.enabled = false\n\
                 transport.link.protocols = [\"tls\"]\n[zenoh.transport.link.tls]\nroot_ca_certificate = {ca:?}\n\
                 listen_certificate = {cert:?}\nlisten_private_key = {key:?}\nenable_mtls = true\n"
            )
        };
        let found = session(&daemon(&cert)).unwrap();
        let tls = |name: &str| found.zenoh.get_json(&format!("transport/link/tls/{name}")).unwrap();
        assert_eq!(found.endpoints, ["tls/[::1]:7447"]);
        assert_eq!([tls("root_ca_certificate"), tls("connect_certificate")], [format!("{ca:?}"), format!("{cert:?}")]);
        assert_eq!([tls("connect_private_key"), tls("listen_certificate")], [format!("{key:?}"), "null".to_owned()]);
        let error = session(&daemon("/run/credentials/pointsd.service/tls_cert.pem")).unwrap_err().to_string();
        assert!(error.contains("connect_certificate: there is no file \"/run/credentials"), "{error}");
    }
}
