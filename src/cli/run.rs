//! `pointsd run`: runs the daemon.

use std::path::{Path, PathBuf};

use super::{
    Exit, Failure, Outcome, ResultExt,
    runtime::{self, Signals},
};
use crate::{
    daemon::{
        DATABASE, Daemon, StartError,
        config::{Config, Document},
    },
    store::{self, StoreError},
    web::{self, Listening},
};

/// Runs the daemon until SIGTERM or SIGINT; SIGHUP reloads the configuration.
///
/// Exit codes: 0 stopped cleanly; 69 zenoh or the dashboard cannot be used (is the port in use?), or another pointsd
/// uses the database; 70 a task of the daemon ended; 74 the database cannot be used, or received messages could not be
/// stored before the stop; 78 the configuration is invalid.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd run --config config/pointsd.toml")]
pub(super) struct Arguments {
    /// Configuration file [default: built-in values].
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let config = Config::load(arguments.config.as_deref()).or_exit(Exit::Config)?;
    runtime::log(&config.log)?;
    for warning in config.warnings() {
        tracing::warn!("{warning}");
    }
    runtime::block_on(run(arguments, config))
}

impl From<StartError> for Failure {
    fn from(error: StartError) -> Self {
        let exit = match &error {
            StartError::Store(StoreError::Foreign(_)) | StartError::Webhook(_) => Exit::Config,
            StartError::Store(_) | StartError::LockFile { .. } => Exit::Io,
            StartError::Bus(error) if !error.is_temporary() => Exit::Config,
            StartError::Bus(_) | StartError::Locked { .. } => Exit::Unavailable,
        };
        Self::new(exit, error)
    }
}

/// The failure of a start. If the database belongs to another program, the text also names file, line and key of the
/// configuration.
pub(super) fn located(error: StartError, file: Option<&Path>) -> Failure {
    if let (StartError::Store(foreign @ StoreError::Foreign(_)), Some(file)) = (&error, file)
        && let Ok(document) = Document::read(file)
    {
        return Failure::new(Exit::Config, document.error_at("store.path", foreign.to_string()));
    }
    error.into()
}

async fn run(arguments: &Arguments, config: Config) -> Outcome {
    let mut signals = Signals::listen()?;
    // A SIGHUP during the start has its effect after it.
    let mut hangup = runtime::hangup()?;
    let listening = match config.web.listen {
        Some(address) => Some(Listening::bind(address).await.or_exit(Exit::Unavailable)?),
        None => None,
    };
    let mut daemon = tokio::select! {
        started = Daemon::start(config) => started.map_err(|error| located(error, arguments.config.as_deref()))?,
        // A signal ends the start too, which may wait for days for a router, or check a large database for minutes.
        () = signals.stop() => {
            tracing::info!("stopped during the start");
            return Ok(Exit::Ok);
        }
    };
    if let Some(listening) = listening {
        daemon.adopt("the dashboard", web::serve(listening, daemon.view()));
    }
    daemon.announce_ready();
    tracing::info!(database = %daemon.store().path().display(), listens_on = ?daemon.locators().await, "ready");
    let ended = loop {
        tokio::select! {
            () = signals.stop() => break None,
            _ = hangup.recv() => reload(&daemon, arguments.config.as_deref()).await,
            task = daemon.ended() => break Some(task),
        }
    };
    let stopped = daemon.stop().await;
    if let Some(task) = ended {
        let error = anyhow::anyhow!("{task} ended unexpectedly; the daemon cannot run without it");
        let exit = if task == DATABASE { Exit::Io } else { Exit::Software };
        return Err(Failure::new(exit, error));
    }
    stopped.or_exit(Exit::Io)?;
    tracing::info!("stopped");
    Ok(Exit::Ok)
}

/// Reloads the configuration. An invalid one is not applied, nor one with a file at `store.path` that the next start
/// would refuse.
async fn reload(daemon: &Daemon, file: Option<&Path>) {
    let load = async {
        let config = Config::load(file)?;
        store::refuse_foreign(&config.store.path).await?;
        anyhow::Ok(config)
    };
    match load.await {
        Ok(config) => {
            let waiting = daemon.reload(config);
            tracing::info!("configuration reloaded: diagnosis and machines take effect now");
            if !waiting.is_empty() {
                tracing::warn!("changes in {} take effect at the next start", waiting.join(", "));
            }
        }
        Err(error) => tracing::error!("configuration not changed: {error:#}"),
    }
}
