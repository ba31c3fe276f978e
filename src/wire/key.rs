//! Key expressions: `points/v1/{site}/{machine}/{kind}`. A message belongs to the machine in its key.

use serde::{Deserialize, Serialize};

use super::Invalid;
use crate::throw::{MachineId, Name};

/// The first chunks of every key.
const PREFIX: &str = "points/v1/";

/// The last chunk of a key: the kind of its messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, strum::AsRefStr, strum::EnumString, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum Kind {
    /// Throws, from the logger.
    Throw,
    /// The health of throws, from the daemon.
    Health,
    /// Alarm events, from the daemon.
    Alarm,
    /// Operators' commands.
    Command,
    /// The logger's liveliness token.
    Alive,
}

/// The key of a machine for messages of `kind`.
pub fn machine_key(machine: &MachineId, kind: Kind) -> String {
    format!("{PREFIX}{}/{}/{}", machine.site, machine.machine, kind.as_ref())
}

/// The key of a daemon's liveliness token: `points/v1/{site}/monitor/{id}/alive`. The name of a daemon (`site` and `id`
/// of its section `[monitor]`) has the form of a machine's name.
pub fn monitor_alive_key(monitor: &MachineId) -> String {
    monitor_key(monitor, "alive")
}

/// Key expression of the liveliness tokens of all daemons.
pub const EVERY_MONITOR_ALIVE: &str = "points/v1/*/monitor/*/alive";

/// The name of the daemon in the key of a liveliness token or of a status; `None` for another key.
pub fn parse_monitor_key(key: &str) -> Option<MachineId> {
    let chunks: Vec<&str> = key.strip_prefix(PREFIX)?.split('/').collect();
    let [site, "monitor", id, "alive" | "status"] = chunks[..] else { return None };
    MachineId::new(site, id).ok()
}

/// Key expression of the status of every daemon.
pub const EVERY_MONITOR_STATUS: &str = "points/v1/*/monitor/*/status";

/// The key of a daemon's status: `points/v1/{site}/monitor/{id}/status`.
pub fn monitor_status_key(monitor: &MachineId) -> String {
    monitor_key(monitor, "status")
}

fn monitor_key(MachineId { site, machine }: &MachineId, kind: &str) -> String {
    format!("{PREFIX}{site}/monitor/{machine}/{kind}")
}

/// Parses a key into machine and kind.
///
/// # Errors
/// When the key has another form or an invalid name.
pub fn parse_key(key: &str) -> Result<(MachineId, Kind), Invalid> {
    let shape = || Invalid("the key is not points/v1/{site}/{machine}/{throw|health|alarm|command|alive}".to_owned());
    let chunks: Vec<&str> = key.strip_prefix(PREFIX).ok_or_else(shape)?.splitn(4, '/').collect();
    let [site, machine, kind] = chunks[..] else { return Err(shape()) };
    let kind = kind.parse().map_err(|_| shape())?;
    Ok((MachineId::new(site, machine).map_err(|error| Invalid(error.to_string()))?, kind))
}

/// The sites and machines whose keys a key expression includes, as `GLOB` patterns of SQLite. `None` if it includes no
/// key of a machine, or has `**` twice, so that the position of the names is unknown.
pub fn machine_patterns(key_expression: &str) -> Option<[String; 2]> {
    /// Number of chunks in the key of a machine.
    const CHUNKS: usize = 5;
    let chunks: Vec<&str> = key_expression.split('/').collect();
    if chunks.iter().filter(|chunk| **chunk == "**").count() > 1 {
        return None;
    }
    let mut all = Vec::with_capacity(CHUNKS);
    for chunk in &chunks {
        match *chunk {
            "**" => all.extend(std::iter::repeat_n("*", (CHUNKS + 1).checked_sub(chunks.len())?)),
            chunk => all.push(chunk),
        }
    }
    let [_, _, site, machine, _] = all[..] else { return None };
    Some([site, machine].map(|chunk| chunk.replace("$*", "*")))
}

/// The part of the fleet that one daemon serves: `points/v1/**`, `points/v1/{site}/**` or
/// `points/v1/{site}/{machine}/**`, where a name may be `*` or contain `$*`. The default is the whole fleet.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Scope {
    site: String,
    machine: String,
}

impl Default for Scope {
    fn default() -> Self {
        Self { site: "*".to_owned(), machine: "*".to_owned() }
    }
}

impl From<Scope> for String {
    fn from(Scope { site, machine }: Scope) -> Self {
        format!("{PREFIX}{site}/{machine}/**")
    }
}

impl TryFrom<String> for Scope {
    type Error = Invalid;

    fn try_from(text: String) -> Result<Self, Invalid> {
        let invalid = || {
            let text: String = text.chars().take(200).collect();
            let forms = "points/v1/**, points/v1/{site}/** or points/v1/{site}/{machine}/**";
            Invalid(format!("{text:?} is not a scope: write {forms}, a name may be * or contain $*"))
        };
        let rest = text.strip_prefix(PREFIX).and_then(|rest| rest.strip_suffix("**")).ok_or_else(invalid)?;
        let chunks: Vec<&str> = rest.split_terminator('/').collect();
        let (site, machine) = match chunks.as_slice() {
            [] => ("*", "*"),
            [site] => (*site, "*"),
            [site, machine] => (*site, *machine),
            _ => return Err(invalid()),
        };
        let well_formed = rest.is_empty() || rest.ends_with('/');
        if well_formed && is_name_pattern(site) && is_name_pattern(machine) {
            Ok(Self { site: site.to_owned(), machine: machine.to_owned() })
        } else {
            Err(invalid())
        }
    }
}

impl Scope {
    /// The key expression of all keys of one kind in the scope.
    pub fn key_expression(&self, kind: Kind) -> String {
        format!("{PREFIX}{}/{}/{}", self.site, self.machine, kind.as_ref())
    }
}

/// Whether a chunk is `*`, a name, or a name with `$*` in it (zenoh's wildcards within one chunk).
fn is_name_pattern(chunk: &str) -> bool {
    chunk == "*" || chunk.replace("$*", "x").parse::<Name>().is_ok() && !chunk.contains("$*$*") && chunk != "$*"
}

#[cfg(test)]
mod tests {
    use strum::VariantArray as _;

    use super::*;

    #[test]
    fn keys_are_those_of_the_contract_and_parse_back() {
        let machine = MachineId::new("north", "21B").unwrap();
        assert_eq!(machine_key(&machine, Kind::Throw), "points/v1/north/21B/throw");
        for &kind in Kind::VARIANTS {
            assert_eq!(parse_key(&machine_key(&machine, kind)).unwrap(), (machine.clone(), kind));
        }
        let monitor = MachineId::new("north", "cabinet-7").unwrap();
        assert_eq!(monitor_alive_key(&monitor), "points/v1/north/monitor/cabinet-7/alive");
        for key in [monitor_alive_key(&monitor), monitor_status_key(&monitor)] {
            assert_eq!(parse_monitor_key(&key), Some(monitor.clone()));
        }
        assert_eq!(parse_monitor_key("points/v1/north/cabinet-7/alive"), None);
    }

    #[test]
    fn keys_of_another_shape_are_refused() {
        for key in [
            "",
            "points/v1/north/21B",
            "points/v2/north/21B/throw",
            "points/v1/north/21B/throw/x",
            "points/v1/north/21B/voltage",
            "points/v1//21B/throw",
            "points/v1/no rth/21B/throw",
            "points/v1/north/monitor/cabinet-7/alive",
        ] {
            assert!(parse_key(key).is_err(), "{key:?} was taken");
        }
    }

    #[test]
    fn key_expressions_become_patterns_of_names() {
        let patterns = |key: &str| machine_patterns(key).map(|[site, machine]| format!("{site} {machine}"));
        for (key, expected) in [
            ("points/v1/north/21B/health", Some("north 21B")),
            ("points/v1/*/21B/health", Some("* 21B")),
            ("points/v1/n$*h/2$*/health", Some("n*h 2*")),
            ("points/v1/north/**", Some("north *")),
            ("points/v1/**/health", Some("* *")),
            ("points/v1/**/21B/health", Some("* 21B")),
            ("points/v1/north/21B/**/health", Some("north 21B")),
            ("**", Some("* *")),
            ("points/v1/north/21B", None),
            ("points/v1/north/21B/health/more/**", None),
            ("points/**/21B/**", None),
        ] {
            assert_eq!(patterns(key).as_deref(), expected, "{key}");
        }
    }

    #[test]
    fn scopes_become_key_expressions() {
        for (scope, throws) in [
            ("points/v1/**", "points/v1/*/*/throw"),
            ("points/v1/north/**", "points/v1/north/*/throw"),
            ("points/v1/north/21B/**", "points/v1/north/21B/throw"),
            ("points/v1/north-$*/**", "points/v1/north-$*/*/throw"),
            ("points/v1/*/21B/**", "points/v1/*/21B/throw"),
        ] {
            let parsed = Scope::try_from(scope.to_owned()).unwrap();
            assert_eq!(parsed.key_expression(Kind::Throw), throws);
        }
        for bad in
            ["", "**", "points/v1/", "points/v1/north", "points/v1/north**", "points/v1/a/b/c/**", "points/v1/a b/**"]
        {
            assert!(Scope::try_from(bad.to_owned()).is_err(), "{bad:?} was taken");
        }
    }
}
