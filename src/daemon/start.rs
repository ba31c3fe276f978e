//! The running daemon: its start, and its interface for other parts of the process.

use std::sync::Arc;

use sd_notify::NotifyState;
use tokio::{
    sync::{broadcast, mpsc, watch},
    task::JoinHandle,
};
use zenoh::{Session, liveliness::LivelinessToken};

use super::{
    answer::Responder,
    clock,
    config::Config,
    error::StartError,
    judge::{
        Judge,
        commands::{CommandSender, PendingCommand},
        judge_loop::{JudgeLoop, Links},
    },
    publish::Publisher,
    receive::{Intake, ReceiveLoop, backlog::Backlog},
    retention,
    shared::Shared,
    supervision::{
        lock::DatabaseLock,
        peers::Peers,
        presence::{self, Tokens},
        status::{NAMED, Status, StatusReport},
        tasks::Tasks,
        watchdog,
    },
    webhook::Notifier,
};
use crate::{
    bus::{self, BusError, Inbox, Outlet, QueryQueue},
    store::{self, Found, Judgement, Opened, Store, seldom},
    throw::MachineId,
    wire::{self, CommandTarget, Kind, machine_key, monitor_alive_key, monitor_status_key},
};

/// Capacity of the channel of judged throws to observers \[batches\]: more than the throws of a demo. A slow observer
/// misses the oldest batches.
const JUDGED_CAPACITY: usize = 4_096;

/// Name that [`Daemon::ended`] returns for the writer of the database.
pub const DATABASE: &str = "the database";
/// Names of the tasks for whose end [`Daemon::stop`] waits.
pub(super) const RECEIVE: &str = "receive";
pub(super) const JUDGE: &str = "judge";
pub(super) const PUBLISH: &str = "publish";

/// The running daemon.
pub struct Daemon {
    pub(super) shared: Arc<Shared>,
    config: watch::Sender<Arc<Config>>,
    watchers: broadcast::Sender<Arc<[Judgement]>>,
    commands: CommandSender,
    pub(super) tasks: Tasks,
    pub(super) publishing: [JoinHandle<()>; 2],
    pub(super) alive: LivelinessToken,
    pub(super) lock: DatabaseLock,
}

/// The interface of a running daemon for the dashboard: status, reader of the database, configuration, operators'
/// commands. Cheap to clone.
#[derive(Clone)]
pub struct View {
    pub(crate) status: Arc<Status>,
    pub(crate) store: Store,
    config: watch::Receiver<Arc<Config>>,
    pub(crate) commands: CommandSender,
}

impl View {
    /// The present configuration.
    pub fn config(&self) -> Arc<Config> {
        Arc::clone(&self.config.borrow())
    }

    pub(crate) fn report(&self) -> StatusReport {
        self.status.report(&self.store)
    }
}

/// A start of the daemon: the shared state, and the tasks started so far.
struct Starting {
    shared: Arc<Shared>,
    tasks: Tasks,
}

impl Daemon {
    /// Opens the database and zenoh, and starts every loop. Returns when all loops run.
    ///
    /// # Errors
    /// When the database or zenoh cannot be used.
    pub async fn start(config: Config) -> Result<Self, StartError> {
        let lock = DatabaseLock::take(&config.store.path)?;
        // Before the database, which stays closed if there is no session and the start fails.
        let opening = bus::open(config.zenoh.clone());
        let session = watchdog::with_start_extension("opening zenoh; a client waits for its router", opening).await?;
        let opening = Store::open(&config.store, clock::now());
        let opened = watchdog::with_start_extension("opening the database", opening).await?;
        report_database(&opened.report, &config.store);
        let store = opened.store.clone();
        let started = Self::start_loops(config, session, opened, lock).await;
        if started.is_err()
            && let Err(error) = store.close().await
        {
            tracing::warn!(%error, "closing the database failed, after a failed start");
        }
        started
    }

    async fn start_loops(
        config: Config,
        session: Session,
        opened: Opened,
        lock: DatabaseLock,
    ) -> Result<Self, StartError> {
        let (config, current) = watch::channel(Arc::new(config));
        let (connections, loggers) = watch::channel(Tokens::default());
        let shared = Arc::new(Shared::new(Arc::clone(&current.borrow()), session, opened.store, loggers));
        let Shared { session, store, status, config: at_start, .. } = &*shared;
        let mut start = Starting { shared: Arc::clone(&shared), tasks: Tasks::default() };
        let (watchers, _) = broadcast::channel(JUDGED_CAPACITY);
        let (sender, commands) = CommandSender::new();
        let (outlet, publishing) = Outlet::start(session, Arc::clone(&status.outlet));

        if let Some(notifier) = Notifier::new(Arc::clone(&shared)).await? {
            start.tasks.spawn("webhook", notifier.run());
        }
        if let Err(error) = store.renew_backlogs(clock::now()).await {
            tracing::warn!(%error, "the wait for backlogs does not begin anew: later throws may be judged before them");
        }
        // In reverse order of the pipeline: each loop runs before the loop that feeds it.
        start.start_publisher(outlet.clone(), opened.report.found == Found::Fresh).await?;
        start.start_judge(outlet.clone(), current, watchers.clone(), commands).await?;
        start.start_receiver().await?;

        let name_of =
            |key: &str| wire::parse_key(key).ok().filter(|(_, kind)| *kind == Kind::Alive).map(|(name, _)| name);
        let counting = Arc::clone(status);
        let on_change = move |machine: &MachineId, is_alive, count| {
            counting.edit().loggers = count;
            if is_alive {
                seldom!(info, %machine, "logger connected");
            } else {
                seldom!(warn, %machine, "logger disconnected");
            }
        };
        presence::watch(session, &start.scope(Kind::Alive), name_of, on_change, connections).await?;
        start.start_answers(&sender).await?;
        let last_received = store.reader().last_received().await?;
        start.tasks.spawn("retention", retention::run(store.clone(), last_received));
        start.tasks.spawn("watchdog", watchdog::watch(Arc::clone(&shared)));
        let own = at_start.monitor.as_machine();
        match bus::monitors(session).await {
            Ok(running) if running.contains(&own) => tracing::warn!(
                "another daemon with the name {own} is connected: give each its own monitor.site and monitor.id, or stop one"
            ),
            Ok(_) => {}
            Err(error) => tracing::debug!(%error, "looking for a daemon of the same name failed"),
        }
        let alive = bus::declare_alive(session, &monitor_alive_key(&own)).await?;
        let tasks = start.tasks;
        Ok(Self { shared, config, watchers, commands: sender, tasks, publishing, alive, lock })
    }

    /// Notifies systemd that the daemon is ready.
    pub fn announce_ready(&self) {
        watchdog::notify(&[NotifyState::Ready, NotifyState::Status(&self.report().line())]);
    }

    /// Receiver of the throws judged from now on, in batches.
    pub fn watch(&self) -> broadcast::Receiver<Arc<[Judgement]>> {
        self.watchers.subscribe()
    }

    /// Endpoints on which the session listens.
    pub async fn locators(&self) -> Vec<String> {
        self.shared.session.info().locators().await.iter().map(ToString::to_string).collect()
    }

    /// The database.
    pub fn store(&self) -> &Store {
        &self.shared.store
    }

    /// The status of the daemon.
    pub fn report(&self) -> StatusReport {
        self.shared.status.report(&self.shared.store)
    }

    /// A view of the daemon for the dashboard.
    pub fn view(&self) -> View {
        View {
            status: Arc::clone(&self.shared.status),
            store: self.shared.store.clone(),
            config: self.config.subscribe(),
            commands: self.commands.clone(),
        }
    }

    /// Runs a further task under the supervision of the daemon: [`Self::ended`] returns when the task ends.
    pub fn adopt<T>(&mut self, name: &'static str, task: impl Future<Output = T> + Send + 'static) {
        self.tasks.spawn(name, task);
    }

    /// Waits until a task or the writer of the database ends, and returns its name. Each of them should run until
    /// [`Self::stop`], so the daemon must end.
    pub async fn ended(&mut self) -> &'static str {
        tokio::select! {
            ended = self.tasks.next_end() => ended,
            () = self.shared.store.stopped() => DATABASE,
        }
    }

    /// Applies the settings that can change without a restart (diagnosis, machines). Returns the sections that differ
    /// and need a restart.
    #[must_use]
    pub fn reload(&self, new: Config) -> Vec<&'static str> {
        let old = Arc::clone(&self.config.borrow());
        let needs_restart = [
            ("monitor", old.monitor != new.monitor),
            ("subscribe", old.subscribe != new.subscribe),
            ("identify", old.identify != new.identify),
            ("store", old.store != new.store),
            ("web", old.web != new.web),
            ("webhook", old.webhook != new.webhook),
            ("log", old.log != new.log),
            ("zenoh", old.zenoh.to_string() != new.zenoh.to_string()),
        ];
        let config = Config { diagnosis: new.diagnosis, machines: new.machines, ..Config::clone(&old) };
        self.config.send_replace(Arc::new(config));
        needs_restart.into_iter().filter(|(_, differs)| *differs).map(|(section, _)| section).collect()
    }
}

impl Starting {
    /// The key expression of the part of the fleet that this daemon serves.
    fn scope(&self, kind: Kind) -> String {
        self.shared.config.subscribe.key.key_expression(kind)
    }

    async fn start_publisher(&mut self, outlet: Outlet, is_first: bool) -> Result<(), StartError> {
        let publisher = Publisher {
            shared: Arc::clone(&self.shared),
            outlet,
            audience: bus::declare_publisher(&self.shared.session, self.scope(Kind::Alarm)).await?,
            is_first,
        };
        self.tasks.spawn(PUBLISH, publisher.run());
        Ok(())
    }

    async fn start_judge(
        &mut self,
        outlet: Outlet,
        config: watch::Receiver<Arc<Config>>,
        watchers: broadcast::Sender<Arc<[Judgement]>>,
        commands: mpsc::Receiver<PendingCommand>,
    ) -> Result<(), StartError> {
        let shared = Arc::clone(&self.shared);
        let peers = Peers::watch(&shared.session, shared.config.monitor.watched().collect()).await?;
        let judge = Judge::restore(shared.store.clone(), config).await?;
        let links = Links { outlet, watchers, commands, peers };
        self.tasks.spawn(JUDGE, JudgeLoop::new(shared, judge, links).run());
        Ok(())
    }

    /// Starts the reception of live throws and of the loggers' backlogs.
    async fn start_receiver(&mut self) -> Result<(), StartError> {
        let Shared { config, session, store, status, .. } = &*self.shared;
        let (subscribe, monitor) = (&config.subscribe, &config.monitor);
        let (key, counters) = (self.scope(Kind::Throw), Arc::clone(&status.inbox));
        let (inbox, dropped) = Inbox::subscribe(session, &key, subscribe.max_payload_bytes, counters).await?;
        let mut machines = store.reader().machines().await?;
        machines.retain(|machine| monitor.reserves(machine).is_none());
        let (machines, left_out): (Vec<_>, Vec<_>) =
            machines.into_iter().partition(|machine| subscribe.serves(machine));
        status.edit().not_served = left_out.iter().take(NAMED).map(ToString::to_string).collect();
        status.edit().key = subscribe.key.clone().into();
        let shared = || Arc::clone(&self.shared);
        let intake = Arc::new(Intake::new(shared(), machines));
        let backlog = Backlog::new(shared(), Arc::clone(&intake), dropped);
        self.tasks.spawn(RECEIVE, ReceiveLoop::new(shared(), inbox, intake).run());
        // Stopped together with the receiving loop: the next start fetches the rest of the backlogs.
        self.tasks.spawn("backlog", backlog.run());
        Ok(())
    }

    /// Starts the tasks that answer queries and commands.
    async fn start_answers(&mut self, sender: &CommandSender) -> Result<(), BusError> {
        let Shared { config, session, store, status, .. } = &*self.shared;
        let own_machine = config.monitor.as_machine();
        let key = monitor_status_key(&own_machine);
        let reader = store.reader().clone();
        let itself = CommandTarget { monitor: own_machine.to_string(), session: session.zid().to_string() };
        let alarms = |elsewhere| Responder::Alarms { reader: reader.clone(), status: Arc::clone(status), elsewhere };
        let commands = || Responder::Commands { sender: sender.clone(), itself: itself.clone() };
        let mut all = vec![
            ("answer status", key.clone(), Responder::Status { key, shared: Arc::clone(&self.shared) }),
            ("answer health", self.scope(Kind::Health), Responder::Health(reader.clone())),
            ("answer alarms", self.scope(Kind::Alarm), alarms(None)),
            ("answer commands", self.scope(Kind::Command), commands()),
        ];
        // Alarms about the daemon itself carry its own name, which `subscribe.key` need not include.
        let own = |kind| machine_key(&own_machine, kind);
        if !bus::intersect(&self.scope(Kind::Alarm), &own(Kind::Alarm)) {
            let elsewhere = Some(self.scope(Kind::Alarm));
            all.push(("answer own alarms", own(Kind::Alarm), alarms(elsewhere)));
            all.push(("answer own commands", own(Kind::Command), commands()));
        }
        for (name, key, responder) in all {
            let questions = QueryQueue::declare(session, &key).await?;
            self.tasks.spawn(name, responder.run(questions));
        }
        Ok(())
    }
}

/// Logs how the database was found at the start.
fn report_database(report: &store::Report, settings: &store::Settings) {
    let database = settings.path.display();
    match &report.found {
        Found::Fresh => tracing::info!(%database, "a new database"),
        Found::Clean => tracing::info!(%database, "the database was closed cleanly"),
        Found::Unclean => tracing::warn!(%database, "the database was not closed cleanly; the check found no damage"),
        Found::WithoutLog => tracing::warn!(
            %database,
            "the database was not closed cleanly, and its write-ahead log is missing: unless this is a backup, the last throws may be LOST"
        ),
        // In the log already: the copy of its rows may take minutes.
        Found::SetAside { .. } => {}
    }
    tracing::info!(version = env!("CARGO_PKG_VERSION"), "pointsd starts");
    if report.upgraded_by > 0 {
        tracing::info!(migrations = report.upgraded_by, "the database was migrated");
    }
    if report.newer_schema {
        tracing::warn!("a newer version of pointsd has used this database; its additions are ignored");
    }
}
