//! `pointsd demo`: daemon, simulated fleet, database and dashboard in one process, over loopback.

mod outcome;
mod screen;

use std::{fs, net::Ipv4Addr, path::PathBuf};

use anyhow::Context;
use jiff::SignedDuration;
use tokio::sync::broadcast::error::RecvError;

use super::{
    Exit, Failure, Outcome, ResultExt,
    run::start_failure,
    runtime::{self, Signals},
    simulate_run::boot_id,
};
use crate::{
    bus,
    daemon::{
        Daemon, Ended, clock,
        config::{Config, Document, client_session},
    },
    logger::{Logger, LoggerSettings},
    simulate::{Fault, FleetFault, FleetSettings, Part, Shape},
    web::{self, Place},
};
use screen::Screen;

/// Throws of each machine: 50 a direction for the baseline, and as many again while parts wear out.
const THROWS: u64 = 200;
/// Throws of one machine a second.
const RATE: f64 = 6.5;
/// Time from one throw of a machine to its next \[s\]: a busy junction.
const INTERVAL_S: f64 = 1200.0;

/// Shows what pointsd does, in about half a minute: five simulated machines, four of which wear out.
///
/// Daemon, machines, database and dashboard run in this process and talk over loopback. The database is kept for a look
/// afterwards.
///
/// Exit codes: 0 all four faults were named right and the healthy machine raised no alarm; 1 not so; 69 zenoh or the
/// dashboard cannot be used; 73 the database cannot be created.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd demo --seed 7")]
pub(super) struct Arguments {
    /// Seed of everything random.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Leave the daemon and its dashboard running at the end, until Ctrl-C.
    #[arg(long)]
    keep: bool,
    /// Folder for the database; without it, a new one among the temporary files.
    #[arg(long, value_name = "FOLDER")]
    folder: Option<PathBuf>,
}

/// What is wrong with a machine of the demo.
#[derive(Debug, Clone, Copy)]
struct Injected {
    part: Part,
    size_pct: f64,
    from_throw: u64,
    ramp_throws: Option<u64>,
}

/// One machine for each cause, and one that stays healthy.
const MACHINES: [Option<Injected>; 5] = [
    Some(Injected { part: Part::Kt, size_pct: -20.0, from_throw: 120, ramp_throws: None }),
    Some(Injected { part: Part::Friction, size_pct: 45.0, from_throw: 110, ramp_throws: Some(40) }),
    Some(Injected { part: Part::Stiffness, size_pct: 30.0, from_throw: 130, ramp_throws: None }),
    Some(Injected { part: Part::Inertia, size_pct: 20.0, from_throw: 115, ramp_throws: Some(30) }),
    None,
];

pub(super) fn main(arguments: &Arguments) -> Outcome {
    runtime::block_on(demo(arguments))
}

async fn demo(arguments: &Arguments) -> Outcome {
    let began = clock::monotonic();
    let mut signals = Signals::listen()?;
    let database = database(arguments)?;
    let place = Place::bind((Ipv4Addr::LOCALHOST, 0).into()).await.or_exit(Exit::Unavailable)?;
    let url = place.url();
    let mut daemon = Daemon::start(config(&database)?).await.map_err(start_failure)?;
    daemon.adopt("the dashboard", web::serve(place, daemon.view()));
    let endpoint = daemon.locators().await.into_iter().next().unwrap_or_default();
    println!(
        "A daemon that listens on {endpoint}, and {} simulated point machines that connect to it.",
        MACHINES.len()
    );
    println!("Each throws {THROWS} times. The first 50 throws a direction become its baseline; then four wear out.");
    println!("In a browser: {url}\n");

    let mut screen = Screen::new(MACHINES.len(), THROWS);
    let mut judged = daemon.watch();
    let session = bus::open(client(&endpoint)?).await.or_exit(Exit::Unavailable)?;
    let mut logger = Logger::start(session.clone(), &logger_settings(arguments.seed), &fleet(), boot_id())
        .await
        .or_exit(Exit::Software)?;
    let machines = logger.machines().to_vec();
    let expected = THROWS * MACHINES.len() as u64;
    let mut seen = 0;
    while seen < expected {
        tokio::select! {
            throw = judged.recv() => match throw {
                Ok(throw) => {
                    seen += 1;
                    screen.throw(&machines, &throw);
                }
                Err(RecvError::Lagged(missed)) => seen += missed,
                Err(RecvError::Closed) => break,
            },
            ended = daemon.ended() => return Err(died(ended)),
            () = signals.stop() => {
                println!("stopped");
                return Ok(Exit::Negative);
            }
        }
    }
    logger.finished().await.or_exit(Exit::Software)?;
    screen.finish();
    let rows = outcome::rows(daemon.store().reader(), &machines).await.or_exit(Exit::Io)?;
    println!("{}", outcome::table(&rows));
    let right = rows.iter().all(outcome::Row::is_right);
    println!("{}\n", outcome::sentence(&rows, clock::monotonic().duration_since(began)));
    outcome::print_queries(&database);
    if arguments.keep {
        println!("\nThe daemon goes on, at {endpoint}, and its dashboard, at {url}, until Ctrl-C.");
        tokio::select! {
            () = signals.stop() => {}
            ended = daemon.ended() => return Err(died(ended)),
        }
    } else {
        println!("The dashboard at {url} ends now; with --keep it stays.");
    }
    drop(logger);
    session.close().await.map_err(|error| Failure { exit: Exit::Unavailable, error: anyhow::anyhow!(error) })?;
    daemon.stop().await.or_exit(Exit::Io)?;
    Ok(if right { Exit::Ok } else { Exit::Negative })
}

fn died(Ended(task): Ended) -> Failure {
    Failure { exit: Exit::Software, error: anyhow::anyhow!("{task} has ended on its own") }
}

/// The path of a database that does not exist yet.
fn database(arguments: &Arguments) -> Result<PathBuf, Failure> {
    let folder = match &arguments.folder {
        Some(folder) => folder.clone(),
        None => std::env::temp_dir().join(format!("pointsd-demo-{}", boot_id())),
    };
    fs::create_dir_all(&folder)
        .with_context(|| format!("cannot create the folder {}", folder.display()))
        .or_exit(Exit::CannotCreate)?;
    let database = folder.join("points.db");
    if database.exists() {
        let error = anyhow::anyhow!("{} is there already: name a new folder", database.display());
        return Err(Failure { exit: Exit::CannotCreate, error });
    }
    Ok(database)
}

fn config(database: &std::path::Path) -> Result<Config, Failure> {
    let text = format!(
        "store.path = {:?}\nmonitor.site = \"demo\"\nzenoh.listen.endpoints = [\"tcp/127.0.0.1:0\"]\n",
        database.display().to_string()
    );
    let document = Document::parse("demo".as_ref(), text).or_exit(Exit::Config)?;
    Config::from_document(&document).or_exit(Exit::Config)
}

fn client(endpoint: &str) -> Result<zenoh::Config, Failure> {
    let text = format!("zenoh.connect.endpoints = [{endpoint:?}]\n");
    let document = Document::parse("demo".as_ref(), text).or_exit(Exit::Config)?;
    client_session(&document).or_exit(Exit::Config)
}

fn logger_settings(seed: u64) -> LoggerSettings {
    let history = SignedDuration::try_from_secs_f64(THROWS as f64 * INTERVAL_S).unwrap_or_default();
    LoggerSettings {
        seed,
        throws: Some(THROWS),
        interval_s: INTERVAL_S,
        time_scale: INTERVAL_S * RATE,
        // The last throw is made now.
        started_at: clock::now().checked_sub(history).ok(),
        ..LoggerSettings::default()
    }
}

fn fleet() -> FleetSettings {
    let faults = MACHINES.iter().enumerate().filter_map(|(machine, injected)| {
        let Injected { part, size_pct, from_throw, ramp_throws } = (*injected)?;
        let shape = ramp_throws.map_or(Shape::Step, |throws| Shape::Ramp { throws });
        Some(FleetFault { machine, fault: Fault { part, shape, size_pct, from_throw } })
    });
    FleetSettings { machines: MACHINES.len(), faults: faults.collect(), ..FleetSettings::default() }
}
