//! `pointsim load`: publishes throws of many machines at a given rate, and measures how fast the daemon judges them.

use std::time::Duration;

use serde_json::json;

use super::{Exit, Outcome, ResultExt, operator::Connection, output, simulate_run};
use crate::{
    evaluate::quantile,
    logger::{LoadResult, LoadTest},
    throw::{MachineId, Name, counted},
};

/// Number of machines at a site. Zenoh compares a new key with all sites, and with all machines of its site, so both
/// numbers should be small.
const MACHINES_OF_A_SITE: u32 = 100;
/// Time without a judgement after which the load ends.
const PATIENCE: Duration = Duration::from_secs(10);

/// Publishes the throws of many machines at a given rate, and reports the number and latency of the judgements.
///
/// The throws are simulated before the load, so that the simulation does not limit the rate; new sensor noise makes
/// each trace different. The machines are new to the daemon: use a temporary database.
///
/// Exit codes: 0 all throws were judged; 1 some were not; 64 invalid option; 69 no daemon; 78 the file of --config is
/// invalid.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: the peak load of a national network, for a minute\n  \
                        pointsim load --machines 20000 --rate 500 --seconds 60")]
pub(super) struct Arguments {
    #[command(flatten)]
    connection: Connection,
    /// Number of machines.
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    machines: u32,
    /// Throws per second of all machines together.
    #[arg(long, value_name = "R", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    rate: u32,
    /// Duration of the load in seconds.
    #[arg(long, value_name = "S", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=86_400))]
    seconds: u32,
    /// First part of the names of the sites: `SITE-1`, `SITE-2` and so on, with 100 machines each.
    #[arg(long, default_value = "load")]
    site: Name,
    /// In the first throw of every N-th machine the toe does not move, and the latency of the alarms is reported; 0
    /// means in no throw.
    #[arg(long, value_name = "N", default_value_t = 0)]
    blocked: u32,
    /// Seed of all random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let machines = (0..arguments.machines).map(|number| {
        let site = format!("{}-{}", arguments.site, number / MACHINES_OF_A_SITE + 1);
        MachineId::new(&site, &format!("m-{}", number % MACHINES_OF_A_SITE + 1))
    });
    let load = LoadTest {
        machines: machines.collect::<Result<_, _>>().or_exit(Exit::Usage)?,
        rate: arguments.rate.into(),
        throws: u64::from(arguments.rate) * u64::from(arguments.seconds),
        blocked: arguments.blocked.into(),
        seed: arguments.seed,
    };
    let (throws, rate) = (load.throws, load.rate);
    let loaded = arguments.connection.with(async |client| {
        let session = client.session.clone();
        // Publishing may block on the link, so it has its own thread.
        let task = tokio::task::spawn_blocking(move || load.run(&session, &simulate_run::boot_id(), PATIENCE));
        Ok(task.await.or_exit(Exit::Software)??)
    })?;
    report(throws, rate, &loaded, arguments.json)
}

fn report(throws: u64, rate: f64, loaded: &LoadResult, as_json: bool) -> Outcome {
    let judged = loaded.latencies.len() as u64;
    let published_per_s = throws as f64 / loaded.publishing.as_secs_f64().max(1.0 / rate);
    let [health_ms, alarm_ms] = [&loaded.latencies, &loaded.alarm_latencies]
        .map(|times| [0.5, 0.99, 1.0].map(|share| quantile(times, share).map(|time| 1e3 * time.as_secs_f64())));
    let behind_s = loaded.behind.as_secs_f64();
    if as_json {
        output::json(&json!({
            "published": throws, "published_per_s": published_per_s, "judged": judged,
            "judged_meanwhile": loaded.judged_meanwhile, "behind_s": behind_s,
            "latency_ms": { "p50": health_ms[0], "p99": health_ms[1], "worst": health_ms[2] },
            "alarms": loaded.alarm_latencies.len(),
            "alarm_latency_ms": { "p50": alarm_ms[0], "p99": alarm_ms[1], "worst": alarm_ms[2] },
        }))?;
    } else {
        let latency = |to: &str, times: [Option<f64>; 3]| match times {
            [Some(p50), Some(p99), Some(worst)] => {
                format!(
                    "\nfrom publication to {to}: median {p50:.1} ms, 99 % within {p99:.1} ms, all within {worst:.1} ms"
                )
            }
            _ => String::new(),
        };
        let alarms = loaded.alarm_latencies.len();
        let latency =
            latency("health", health_ms) + &latency(&format!("alarm ({})", counted(alarms, "alarm")), alarm_ms);
        output::line(format!(
            "published {}, {published_per_s:.0} a second\njudged {judged}, {} of them before the last was published, \
             the last {behind_s:.1} s after it{latency}",
            counted(throws, "throw"),
            loaded.judged_meanwhile
        ))?;
    }
    Ok(if judged == throws { Exit::Ok } else { Exit::Negative })
}
