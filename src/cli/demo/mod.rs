//! `pointsd demo`: daemon, simulated fleet, database and dashboard in one process.

mod outcome;
mod screen;

use std::{
    env, fs,
    net::Ipv4Addr,
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::anyhow;
use tempfile::TempDir;
use tokio::time;

use super::{
    Exit, Failure, Outcome, ResultExt, output,
    runtime::{self, Signals},
    simulate_run::boot_id,
};
use crate::{
    bus,
    daemon::{
        Daemon, clock,
        config::{Config, Document, client_session},
    },
    logger::{Logger, LoggerSettings},
    simulate::{FleetFault, FleetSettings},
    web::{self, Listening},
};
use outcome::MACHINES;
use screen::Screen;

/// Throws of each machine: 50 in each direction for the baseline, and 50 in each direction with the faults.
const THROWS: u64 = 200;
/// Throws of one machine per second.
const RATE: f64 = 6.5;
/// Longest time without a judged throw after the last throw was published: the usual time is below a second.
const JUDGE_LIMIT: Duration = Duration::from_mins(1);
/// Simulated time between two throws of a machine \[s\], as at a busy junction.
const INTERVAL_S: f64 = 1200.0;

/// Shows pointsd at work, in about a minute: five simulated machines, four of which wear out.
///
/// Daemon, machines, database and dashboard run in this process, connected over loopback. The database is removed at
/// the end, unless --keep or --folder is given.
///
/// Exit codes: 0 all four faults named right, no alarm on the healthy machine; 1 otherwise; 69 zenoh or the dashboard
/// cannot be used; 70 a task of the daemon ended; 73 the database cannot be created; 74 the database cannot be used.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd demo --seed 7")]
pub(super) struct Arguments {
    /// Seed of all random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Keep the daemon and its dashboard running until Ctrl-C, and the database after it.
    #[arg(long)]
    keep: bool,
    /// Folder for the database [default: a new temporary folder].
    #[arg(long, value_name = "FOLDER")]
    folder: Option<PathBuf>,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    runtime::block_on(demo(arguments))
}

async fn demo(arguments: &Arguments) -> Outcome {
    let began = clock::monotonic();
    let mut signals = Signals::listen()?;
    let (database, temporary) = database(arguments)?;
    let listening = Listening::bind((Ipv4Addr::LOCALHOST, 0).into()).await.or_exit(Exit::Unavailable)?;
    let url = listening.url();
    let mut daemon = Daemon::start(config(&database)?).await?;
    daemon.adopt("the dashboard", web::serve(listening, daemon.view()));
    let endpoint = daemon.locators().await.into_iter().next().unwrap_or_default();
    output::line(format_args!(
        "The daemon listens on {endpoint}; {} simulated point machines publish.\n\
         Each throws {THROWS} times. The first 50 throws in each direction are its\n\
         baseline; then four machines wear out.\n\
         In a browser: {url}\n",
        MACHINES.len()
    ))?;

    let mut screen = Screen::new(MACHINES.len(), THROWS);
    let mut judged = daemon.watch();
    let session = bus::open(client(&endpoint)?).await.or_exit(Exit::Unavailable)?;
    let mut logger = Logger::start(session.clone(), &logger_settings(arguments.seed), &fleet(), boot_id())
        .await
        .or_exit(Exit::Software)?;
    let machines = logger.machines().to_vec();
    let expected = THROWS * MACHINES.len() as u64;
    let (mut seen, mut published) = (0, false);
    while seen < expected {
        tokio::select! {
            batch = judged.recv() => {
                // The channel has place for all throws of the demo.
                let Ok(batch) = batch else { break };
                seen += batch.len() as u64;
                batch.iter().for_each(|judgement| screen.throw(&machines, judgement));
            }
            finished = logger.finished(), if !published => {
                finished.or_exit(Exit::Software)?;
                published = true;
            }
            () = time::sleep(JUDGE_LIMIT), if published => {
                let problem = anyhow!("the daemon judged {seen} of {expected} throws, and no other for a minute");
                return Err(Failure::new(Exit::Software, problem));
            }
            ended = daemon.ended() => return Err(died(ended)),
            () = signals.stop() => {
                output::line("stopped")?;
                return Ok(Exit::Negative);
            }
        }
    }
    if !published {
        logger.finished().await.or_exit(Exit::Software)?;
    }
    screen.finish();
    let rows = outcome::rows(daemon.store().reader(), &machines).await.or_exit(Exit::Io)?;
    output::line(outcome::table(&rows))?;
    let right = rows.iter().all(outcome::Row::is_right);
    output::line(outcome::sentence(&rows, began.elapsed()))?;
    if temporary.is_none() {
        output::line(outcome::queries(&database))?;
    }
    if arguments.keep {
        output::line(format_args!("\nThe daemon stays at {endpoint}, the dashboard at {url}, until Ctrl-C."))?;
        tokio::select! {
            () = signals.stop() => {}
            ended = daemon.ended() => return Err(died(ended)),
        }
    } else {
        let stays =
            if temporary.is_none() { "daemon and the dashboard" } else { "daemon, the dashboard and the database" };
        output::line(format_args!("With --keep the {stays} stay."))?;
    }
    drop(logger);
    session.close().await.map_err(|error| Failure::new(Exit::Unavailable, anyhow!(error)))?;
    daemon.stop().await.or_exit(Exit::Io)?;
    Ok(if right { Exit::Ok } else { Exit::Negative })
}

fn died(task: &str) -> Failure {
    Failure::new(Exit::Software, anyhow!("{task} ended unexpectedly"))
}

/// The path of the database, and its folder if this is removed at the end. An existing database is an error.
fn database(arguments: &Arguments) -> Result<(PathBuf, Option<TempDir>), Failure> {
    let (folder, temporary) = if let Some(folder) = &arguments.folder {
        output::writable(folder, fs::create_dir_all(folder))?;
        (folder.clone(), None)
    } else {
        let made = tempfile::Builder::new().prefix("pointsd-demo-").tempdir();
        let made = output::writable(&env::temp_dir(), made)?;
        if arguments.keep { (made.keep(), None) } else { (made.path().to_owned(), Some(made)) }
    };
    let database = folder.join("points.db");
    if database.exists() {
        let problem = anyhow!("{} exists already: name another folder", database.display());
        return Err(problem).or_exit(Exit::CannotCreate);
    }
    Ok((database, temporary))
}

fn config(database: &Path) -> Result<Config, Failure> {
    let text = format!(
        "store.path = {:?}\nmonitor.site = \"demo\"\nzenoh.listen.endpoints = [\"tcp/127.0.0.1:0\"]\n",
        database.display().to_string()
    );
    let document = Document::parse("demo".as_ref(), text).or_exit(Exit::Config)?;
    // Only the path of the database can be invalid. The user has no file whose line the error could name.
    Config::from_document(&document).map_err(|error| anyhow!(error.problem)).or_exit(Exit::CannotCreate)
}

fn client(endpoint: &str) -> Result<zenoh::Config, Failure> {
    let text = format!("zenoh.connect.endpoints = [{endpoint:?}]\n");
    let document = Document::parse("demo".as_ref(), text).or_exit(Exit::Config)?;
    client_session(&document).or_exit(Exit::Config)
}

fn logger_settings(seed: u64) -> LoggerSettings {
    LoggerSettings {
        seed: Some(seed),
        throws: Some(THROWS),
        interval_s: INTERVAL_S,
        time_scale: INTERVAL_S * RATE,
        ..LoggerSettings::default()
    }
}

fn fleet() -> FleetSettings {
    let faults = (0..).zip(MACHINES).filter_map(|(machine, fault)| Some(FleetFault { machine, fault: fault? }));
    FleetSettings { machines: MACHINES.len(), faults: faults.collect(), ..FleetSettings::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_without_a_database_is_an_output_that_cannot_be_created() {
        let Err(Failure::Error { exit, error }) = config(Path::new("/no/such/folder/points.db")) else { panic!() };
        assert_eq!(exit, Exit::CannotCreate);
        assert!(error.to_string().starts_with("the folder /no/such/folder of the database: "), "{error}");
    }
}
