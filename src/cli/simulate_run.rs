//! `pointsim run`: publishes the throws of a simulated fleet.

use std::{future, path::PathBuf, time::Duration};

use anyhow::anyhow;
use serde::Deserialize;

use super::{
    Exit, Failure, Outcome, ResultExt, argument,
    runtime::{self, Signals},
};
use crate::{
    bus,
    daemon::{
        clock,
        config::{ConfigError, Document, Log, check_log, client_session},
    },
    logger::{Logger, LoggerError, LoggerSettings},
    simulate::{Fault, FleetFault, FleetSettings, Shape},
    throw::{MachineId, counted},
};

/// Time after the start of the logger at which a daemon must serve the fleet. Zenoh connects both in less than a
/// second.
const SERVED_WITHIN: Duration = Duration::from_secs(5);

/// Publishes the throws of a simulated fleet, in real or accelerated time, until it is stopped or done.
///
/// Exit codes: 0 stopped, or all throws published and judged; 1 published, but no daemon judged all of them; 64 an
/// option is wrong; 69 zenoh cannot be used; 78 the configuration is invalid.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: five machines; from throw 120 on the motor of the first loses 20 %\n  \
                  pointsim run --config config/pointsim.toml --time-scale 3000 --throws 200 --fault 1:kt:-20:120")]
pub(super) struct Arguments {
    /// Configuration file [default: built-in values].
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Stop after N throws of each machine, when a daemon has judged them.
    #[arg(long, value_name = "N")]
    throws: Option<u64>,
    /// Number of machines.
    #[arg(long, value_name = "N")]
    machines: Option<usize>,
    /// Seed of all random numbers; without it the same machines make other throws at each start.
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Ratio of simulated to real time.
    #[arg(long, value_name = "FACTOR")]
    time_scale: Option<f64>,
    /// A fault: machine (from 1), part (`kt`, `friction`, `stiffness`, `rail_stiffness`, `inertia`), size in %, first
    /// throw (from 0), and for a ramp the number of throws until the full size. Repeatable.
    #[arg(long, value_name = "MACHINE:PART:SIZE:FROM[:RAMP]", value_parser = fault)]
    fault: Vec<FleetFault>,
    /// Zenoh endpoint, instead of the configured ones.
    #[arg(long, value_name = "ENDPOINT", value_parser = argument::endpoint)]
    connect: Option<String>,
}

/// A fault as `MACHINE:PART:SIZE:FROM[:RAMP]`.
fn fault(text: &str) -> Result<FleetFault, String> {
    let parts: Vec<&str> = text.split(':').collect();
    let ([machine, part, size, from] | [machine, part, size, from, _]) = parts[..] else {
        return Err("write MACHINE:PART:SIZE:FROM or MACHINE:PART:SIZE:FROM:RAMP".to_owned());
    };
    let number = |name: &str, text: &str| text.parse::<u64>().map_err(|_| format!("{name}: {text:?} is not a number"));
    let machine = usize::try_from(number("machine", machine)?).ok().and_then(|machine| machine.checked_sub(1));
    let machine = machine.ok_or("machines are counted from 1")?;
    let part = argument::part(part)?;
    let size_pct = size.parse().map_err(|_| format!("size: {size:?} is not a number"))?;
    let from_throw = number("first throw", from)?;
    let shape = match parts.get(4) {
        Some(ramp) => Shape::Ramp { throws: number("ramp", ramp)? },
        None => Shape::Step,
    };
    Ok(FleetFault { machine, fault: Fault { part, shape, size_pct, from_throw } })
}

/// The configuration of `pointsim run`.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Plan {
    logger: LoggerSettings,
    fleet: FleetSettings,
    log: Log,
    zenoh: zenoh::Config,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let document = Document::read_or_empty(arguments.config.as_deref()).or_exit(Exit::Config)?;
    let mut plan = read(&document).or_exit(Exit::Config)?;
    apply(arguments, &mut plan)?;
    runtime::log(&plan.log)?;
    runtime::block_on(run(plan))
}

fn read(document: &Document) -> Result<Plan, ConfigError> {
    let plan: Plan = document.deserialize()?;
    document.in_section("logger", plan.logger.validate())?;
    document.in_section("fleet", plan.fleet.check())?;
    check_log(&plan.log, document)?;
    Ok(Plan { zenoh: client_session(document)?, ..plan })
}

/// Applies the options of the command line to the configuration.
fn apply(arguments: &Arguments, plan: &mut Plan) -> Result<(), Failure> {
    let usage = |problem: String| Failure::new(Exit::Usage, anyhow!(problem));
    plan.logger.throws = arguments.throws.or(plan.logger.throws);
    plan.logger.seed = arguments.seed.or(plan.logger.seed);
    plan.logger.time_scale = arguments.time_scale.unwrap_or(plan.logger.time_scale);
    plan.fleet.machines = arguments.machines.unwrap_or(plan.fleet.machines);
    plan.fleet.faults.extend(&arguments.fault);
    if let Some(endpoint) = &arguments.connect {
        let endpoints = serde_json::json!([endpoint]).to_string();
        plan.zenoh
            .insert_json5("connect/endpoints", &endpoints)
            .map_err(|error| usage(format!("--connect {endpoint}: {error}")))?;
    }
    plan.logger.validate().map_err(|error| usage(format!("--{}: {error}", error.key.replace('_', "-"))))?;
    // Checked here, as the error of the fleet's own check counts machines from 0, as the configuration does.
    if let Some(on) = arguments.fault.iter().find(|on| on.machine >= plan.fleet.machines) {
        let machines = counted(plan.fleet.machines as u64, "machine");
        return Err(usage(format!("--fault {}:…: the fleet has {machines}", on.machine + 1)));
    }
    plan.fleet.check().map_err(|error| usage(error.to_string()))
}

async fn run(plan: Plan) -> Outcome {
    let mut signals = Signals::listen()?;
    let session = tokio::select! {
        opened = bus::open(plan.zenoh) => opened.or_exit(Exit::Unavailable)?,
        () = signals.stop() => {
            tracing::info!("stopped before a router answered: nothing is published");
            return Ok(Exit::Ok);
        }
    };
    let mut logger = Logger::start(session.clone(), &plan.logger, &plan.fleet, boot_id()).await?;
    tracing::info!(machines = plan.fleet.machines, site = %plan.logger.site, "publishing throws");
    let machine = logger.machines()[0].clone();
    let outcome = tokio::select! {
        () = signals.stop() => {
            tracing::info!(published = logger.published(), "stopped");
            Exit::Ok
        }
        outcome = complete(&mut logger) => outcome?,
        outcome = async {
            warn_if_unserved(&session, &machine).await;
            future::pending().await
        } => outcome,
    };
    drop(logger);
    session.close().await.map_err(|error| Failure::new(Exit::Unavailable, anyhow!(error)))?;
    Ok(outcome)
}

/// After [`SERVED_WITHIN`], warns if no daemon serves `machine`, which stands for the whole fleet.
async fn warn_if_unserved(session: &zenoh::Session, machine: &MachineId) {
    tokio::time::sleep(SERVED_WITHIN).await;
    let ((serving, None), Ok(daemons)) = (bus::targets(session, machine).await, bus::monitors(session).await) else {
        return;
    };
    if !serving.is_empty() {
        return;
    }
    let found = if daemons.is_empty() {
        "no daemon answers: start pointsd, or correct connect.endpoints".to_owned()
    } else {
        let daemons: Vec<String> = daemons.iter().map(ToString::to_string).collect();
        format!(
            "the daemons that answer serve other machines ({}): correct logger.site, or subscribe.key of a daemon",
            daemons.join(", ")
        )
    };
    tracing::warn!(site = %machine.site, "no daemon serves this site, so its throws are not judged: {found}");
}

/// Waits until all throws are published, and judged by a daemon.
async fn complete(logger: &mut Logger) -> Outcome {
    let throws = logger.finished().await?;
    tracing::info!(published = logger.published(), "all throws are published");
    if logger.judged(throws).await {
        tracing::info!("all throws are judged");
        return Ok(Exit::Ok);
    }
    tracing::warn!("no daemon reported all throws as judged");
    Ok(Exit::Negative)
}

impl From<LoggerError> for Failure {
    fn from(error: LoggerError) -> Self {
        let exit = match &error {
            LoggerError::Simulation(_) | LoggerError::Trace(_) => Exit::Config,
            LoggerError::Bus(_) | LoggerError::NoSubscriber(_) => Exit::Unavailable,
            LoggerError::Spawn { .. } | LoggerError::Thread => Exit::Software,
        };
        Self::new(exit, error)
    }
}

/// A new boot identifier: start time and process number.
pub(super) fn boot_id() -> String {
    format!("{}-{}", clock::now().as_microsecond(), std::process::id())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::daemon::config::keys;
    use crate::simulate::{Sensor, Stuck};
    use crate::throw::Channel;

    fn shipped() -> String {
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("config/pointsim.toml")).unwrap()
    }

    fn plan(text: &str) -> Result<Plan, ConfigError> {
        read(&Document::parse(Path::new("pointsim.toml"), text.to_owned())?)
    }

    #[test]
    fn the_shipped_file_is_the_built_in_defaults() {
        let (shipped, built_in) = (plan(&shipped()).unwrap(), plan("").unwrap());
        assert_eq!(shipped.logger, LoggerSettings::default());
        assert_eq!(shipped.fleet, FleetSettings::default());
        assert_eq!(shipped.log, built_in.log);
        assert_eq!(shipped.zenoh.to_string(), built_in.zenoh.to_string());
    }

    #[test]
    fn the_shipped_file_shows_every_key() {
        #[derive(serde::Serialize)]
        struct Sections {
            logger: LoggerSettings,
            fleet: FleetSettings,
        }
        // Keys without a default are comments in the file. Its last part has the examples of faults and incidents.
        let shipped = shipped();
        let settings = shipped.split("# Faults and incidents").next().unwrap();
        let uncommented =
            |line: &str| line.strip_prefix("# ").filter(|key| key.contains(" = ")).unwrap_or(line).to_owned();
        let shown = settings.lines().map(uncommented).collect::<Vec<_>>().join("\n");
        let shown = keys(&shown);
        let channel = Sensor { full_scale: Some(1.0), bits: Some(12), ..Sensor::default() };
        let mut sections = Sections {
            logger: LoggerSettings {
                throws: Some(1),
                seed: Some(1),
                started_at: Some(jiff::Timestamp::UNIX_EPOCH),
                ..LoggerSettings::default()
            },
            fleet: FleetSettings::default(),
        };
        sections.fleet.sensors.current = channel;
        sections.fleet.sensors.position = channel;
        sections.fleet.sensors.anti_alias_hz = Some(1.0);
        sections.fleet.sensors.stuck = Some(Stuck { channel: Channel::Position, from_s: 1.0 });
        let all = keys(&toml::Table::try_from(sections).unwrap().to_string());
        assert!(all.len() > 70, "{all:?}");
        for key in all.iter().filter(|key| !matches!(key.as_str(), "fleet.faults" | "fleet.incidents")) {
            assert!(shown.contains(key), "config/pointsim.toml does not show {key}");
        }
    }

    #[test]
    fn the_shipped_examples_of_faults_and_incidents_are_read() {
        let text = shipped();
        let examples = text.split("# [[fleet.faults]]").skip(1).collect::<Vec<_>>().join("# [[fleet.faults]]");
        let examples: String = format!("# [[fleet.faults]]{examples}")
            .lines()
            .take_while(|line| line.starts_with("# "))
            .map(|line| line.trim_start_matches("# ").to_owned() + "\n")
            .collect();
        let plan = plan(&examples).unwrap();
        assert_eq!((plan.fleet.faults.len(), plan.fleet.incidents.len()), (2, 1));
    }

    #[test]
    fn a_wrong_file_is_refused_with_file_line_and_key() {
        for (text, expected) in [
            ("[fleet]\nmachines = 0", "pointsim.toml:2: fleet.machines: is 0, must be 1 to 10000"),
            ("[fleet.machine]\n\nsupply_v = -1.0", "pointsim.toml:3: fleet.machine.supply_v: is -1, must be above 0"),
            ("[fleet.machine]\nlead = 1.0", "pointsim.toml:2: fleet.machine.lead: unknown field"),
            ("[fleet.machine.rails]\nmodes = 9", "pointsim.toml:2: fleet.machine.rails.modes: is 9, must be 1 to 6"),
            (
                "[fleet.machine]\nsupply = { rectified_mains = { mains_hz = 1.0 } }",
                "pointsim.toml:2: fleet.machine.supply.rectified_mains.mains_hz: is 1, must be 10 to 100",
            ),
            ("[fleet.sensors]\nsample_rate_hz = 5.0", "pointsim.toml:2: fleet.sensors.sample_rate_hz: is 5, must be"),
            (
                "[fleet.sensors.current]\nbits = 12",
                "pointsim.toml:1: fleet.sensors.current.full_scale: is NaN, must be given",
            ),
            (
                "[fleet.scatter]\ncorrelation = 1.0",
                "pointsim.toml:2: fleet.scatter.correlation: is 1, must be 0 to 0.99",
            ),
            ("[logger]\ninterval_s = 0", "pointsim.toml:2: logger.interval_s: "),
            (
                "[[fleet.faults]]\nmachine = 0\nfault = { part = \"magnet\", shape = \"step\", size_pct = 1.0, from_throw = 0 }",
                "unknown variant `magnet`",
            ),
            (
                "[[fleet.incidents]]\nmachine = 0\nkind = { obstruction = { at_mm = 200.0 } }\nfrom_throw = 0\nthrows = 1",
                "must be 0 to 115 mm",
            ),
        ] {
            let error = plan(text).err().map(|error| error.to_string()).unwrap_or_default();
            assert!(error.contains(expected), "{text}: {error:?}");
            assert!(!error.contains('\n') && error.starts_with("pointsim.toml:"), "{text}: {error:?}");
        }
    }

    #[test]
    fn a_wrong_fault_on_the_command_line_is_refused_in_one_sentence() {
        for (text, expected) in [
            ("1:kt:-20", "write MACHINE:PART:SIZE:FROM"),
            ("0:kt:-20:5", "counted from 1"),
            ("1:magnet:-20:5", "\"magnet\" is not kt, friction"),
            ("1:kt:much:5", "size: \"much\" is not a number"),
            ("1:kt:-20:-5", "first throw: \"-5\" is not a number"),
            ("1:kt:-20:5:slow", "ramp: \"slow\" is not a number"),
        ] {
            let error = fault(text).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
