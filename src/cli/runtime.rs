//! The tokio runtime of a command, its log lines, and its signals.

use std::io::IsTerminal;

use tokio::signal::unix::{Signal, SignalKind, signal};
use tracing_subscriber::{
    Layer,
    filter::{LevelFilter, Targets},
    layer::SubscriberExt,
    util::SubscriberInitExt,
};

use super::{Exit, Failure, ResultExt};
use crate::daemon::config::{Log, LogFormat};

/// Module of zenoh that warns about each reply to a client that has left: up to 10,000 lines for one history query.
/// Only its errors are logged.
const QUERY_DISPATCHER: &str = "zenoh::net::routing::dispatcher::queries";

/// Runs the work of a command on a runtime with several threads, which zenoh needs.
pub(super) fn block_on<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().or_exit(Exit::Software)?;
    let outcome = runtime.block_on(work);
    // A thread that is blocked in a zenoh `put` must not delay the exit.
    runtime.shutdown_timeout(std::time::Duration::from_millis(500));
    outcome
}

/// Writes log lines to stderr as configured.
pub(super) fn log(settings: &Log) -> Result<(), Failure> {
    let targets: Targets = settings.level.parse().or_exit(Exit::Config)?;
    let targets = targets.with_target(QUERY_DISPATCHER, LevelFilter::ERROR);
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr);
    let lines = match settings.format {
        LogFormat::Json => lines.json().boxed(),
        LogFormat::Text => lines.with_target(false).with_ansi(std::io::stderr().is_terminal()).boxed(),
    };
    // Fails only in tests that run several commands in one process.
    let _ = tracing_subscriber::registry().with(lines.with_filter(targets)).try_init();
    Ok(())
}

/// The signals that stop a command: SIGTERM and SIGINT.
pub(super) struct Signals {
    terminate: Signal,
    interrupt: Signal,
}

impl Signals {
    pub(super) fn listen() -> Result<Self, Failure> {
        Ok(Self { terminate: on(SignalKind::terminate())?, interrupt: on(SignalKind::interrupt())? })
    }

    /// Waits for a signal to stop.
    pub(super) async fn stop(&mut self) {
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
    }
}

/// SIGHUP. A command that does not call this keeps the default action: it ends with its terminal, or continues under
/// `nohup`.
pub(super) fn hangup() -> Result<Signal, Failure> {
    on(SignalKind::hangup())
}

fn on(kind: SignalKind) -> Result<Signal, Failure> {
    signal(kind).or_exit(Exit::Software)
}
