//! The running monitor: pipeline, supervision, configuration.
//!
//! ```text
//! zenoh -> receive -> store (committed) -> judge: identify, diagnose, commit -> publish -> zenoh
//!                                            ^ operators' commands, the passing of time
//! ```
//! Each loop is a task. The queues between them are bounded, or are tables. A task that ends on its own ends the
//! daemon: what it does is not optional.

mod answer;
pub mod clock;
pub mod config;
mod fleet;
mod heartbeat;
mod identify;
mod judge;
mod keep;
mod lock;
mod offline;
mod presence;
mod publish;
mod receive;
mod status;
mod supervise;
mod view;

use std::{
    collections::{HashSet, VecDeque},
    sync::Arc,
};

use tokio::{
    sync::{Notify, broadcast, mpsc, watch},
    task::JoinHandle,
};
use tokio_util::sync::CancellationToken;
use zenoh::Session;

pub use fleet::Fleet;
pub use heartbeat::{Heartbeats, Organ};
pub use identify::Pool;
pub use judge::Judged;
pub use lock::{DatabaseLock, LockError};
pub use offline::Offline;
pub use status::{Status, StatusReport};
pub use supervise::Ended;
pub use view::View;

use crate::{
    bus::{self, Audience, BusError, Inbox, Limits, LivelinessToken, Outlet, OutletEnd, PresenceWatch, Questions},
    store::{self, Found, Store, StoreError},
    wire::{Kind, machine_key, monitor_alive_key, monitor_status_key},
};
use config::Config;
use judge::Judge;
use publish::Publisher;
use receive::Receiver;
use status::Gauges;
use supervise::Tasks;

/// Judged throws that a slow watcher may lag behind before it misses some.
const WATCHED: usize = 4_096;
/// Operators' commands that may wait.
const ORDERS: usize = 16;

/// Why the daemon cannot start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The database cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Zenoh cannot be used.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The database is not ours.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// The system gives no thread.
    #[error("the system gives no thread to publish from: {0}")]
    Thread(#[from] std::io::Error),
}

/// The running daemon.
pub struct Daemon {
    session: Session,
    store: Store,
    gauges: Gauges,
    config: watch::Sender<Arc<Config>>,
    watchers: broadcast::Sender<Judged>,
    tasks: Tasks,
    stops: Stops,
    receive: JoinHandle<()>,
    judge: JoinHandle<()>,
    publish: JoinHandle<()>,
    outlet_end: OutletEnd,
    alive: LivelinessToken,
    lock: DatabaseLock,
}

/// One after the other, so that each loop can finish what the one before it handed over.
#[derive(Default)]
struct Stops {
    receive: CancellationToken,
    judge: CancellationToken,
    publish: CancellationToken,
    /// The time is up: leave what is not done.
    give_up: CancellationToken,
}

impl Daemon {
    /// Opens the database and zenoh, and starts every loop. Returns when everything works.
    ///
    /// # Errors
    /// When the database or zenoh cannot be used.
    pub async fn start(config: Config) -> Result<Self, StartError> {
        let lock = DatabaseLock::take(&config.store.path)?;
        let opened = supervise::patiently("opening the database", Store::open(&config.store, clock::now())).await?;
        report_database(&opened.report, &config.store);
        let is_first = opened.report.found == Found::Fresh;
        let store = opened.store;
        let session = bus::open(config.zenoh.clone()).await?;
        let config = Arc::new(config);

        let (tasks, stops, status) = (Tasks::new(), Stops::default(), Arc::new(Status::new()));
        let (spooled, outbox) = (Arc::new(Notify::new()), Arc::new(Notify::new()));
        let (watchers, _) = broadcast::channel(WATCHED);
        let (config_sender, config_receiver) = watch::channel(Arc::clone(&config));
        let (outlet, outlet_end) = Outlet::start(session.clone())?;
        let (orders, inbox_of_orders) = mpsc::channel(ORDERS);
        let (alive_loggers, loggers) = watch::channel(HashSet::new());

        let fleet = Fleet::restore(store.reader().monitors().await?);
        let last_heard = store.reader().last_heard().await?;
        let machines = store.reader().machines().await?.into_iter().collect();
        let judge = Judge {
            store: store.clone(),
            fleet,
            pool: Pool::new(config.identify.threads),
            config: config_receiver,
            status: Arc::clone(&status),
            outlet: Some(outlet.clone()),
            spooled: Arc::clone(&spooled),
            outbox: Arc::clone(&outbox),
            watchers: watchers.clone(),
            give_up: stops.give_up.clone(),
            loggers,
            itself: config.monitor.as_machine(),
            own: VecDeque::new(),
            ticks: 0,
        };
        let judge = tasks.spawn("judge", judge.run(inbox_of_orders, stops.judge.clone()));

        answer_questions(&config, &session, &store, &tasks, orders).await?;
        let tokens = PresenceWatch::subscribe(&session, &config.scope.key_expression(Kind::Alive)).await?;
        tasks.spawn("presence", presence::run(tokens, Arc::clone(&status), alive_loggers));
        tasks.spawn("keep house", keep::run(store.clone(), last_heard));

        let limits = Limits {
            max_machines: config.subscribe.max_machines,
            max_payload_bytes: config.subscribe.max_payload_bytes,
            kept_of_larger_bytes: store::QUARANTINED_BYTES,
        };
        let is_client = config.zenoh.get_json("mode").is_ok_and(|mode| mode.contains("client"));
        let inbox = Inbox::subscribe(&session, &config.scope.key_expression(Kind::Throw), limits, is_client).await?;
        let publisher = Publisher {
            store: store.clone(),
            session: session.clone(),
            outlet: outlet.clone(),
            status: Arc::clone(&status),
            outbox,
            audience: Audience::of(&session, &config.scope.key_expression(Kind::Alarm)).await?,
            is_first,
            is_client,
        };
        let publish = tasks.spawn("publish", publisher.run(stops.publish.clone()));
        let gauges = Gauges {
            status: Arc::clone(&status),
            inbox: inbox.counters(),
            outlet: outlet.counters(),
            store: store.clone(),
        };
        let receiver = Receiver {
            inbox,
            store: store.clone(),
            status,
            spooled,
            machines,
            max_machines: config.subscribe.max_machines,
            max_payload_bytes: config.subscribe.max_payload_bytes,
            itself: config.monitor.as_machine(),
            give_up: stops.give_up.clone(),
        };
        let receive = tasks.spawn("receive", receiver.run(stops.receive.clone()));

        let key = monitor_status_key(&config.monitor.site, &config.monitor.id);
        let questions = Questions::declare(&session, &key).await?;
        tasks.spawn("answer status", answer::status(questions, key, gauges.clone()));
        tasks.spawn("watchdog", supervise::watch(gauges.clone()));
        let alive = bus::declare_alive(&session, &monitor_alive_key(&config.monitor.site, &config.monitor.id)).await?;
        Ok(Self {
            session,
            store,
            gauges,
            config: config_sender,
            watchers,
            tasks,
            stops,
            receive,
            judge,
            publish,
            outlet_end,
            alive,
            lock,
        })
    }

    /// Throws as they are judged, from now on.
    #[must_use]
    pub fn watch(&self) -> broadcast::Receiver<Judged> {
        self.watchers.subscribe()
    }

    /// The zenoh session, for what else runs in this process.
    #[must_use]
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// Where others can connect.
    pub async fn locators(&self) -> Vec<String> {
        self.session.info().locators().await.iter().map(ToString::to_string).collect()
    }

    /// The database.
    #[must_use]
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// How the daemon stands.
    #[must_use]
    pub fn report(&self) -> StatusReport {
        self.gauges.report()
    }

    /// A look at it for what else runs in this process.
    #[must_use]
    pub fn view(&self) -> View {
        View { gauges: self.gauges.clone(), config: self.config.subscribe() }
    }

    /// Runs a task of another room under the daemon's rule: when it ends on its own, so does the daemon.
    pub fn adopt<T>(&self, name: &'static str, task: impl Future<Output = T> + Send + 'static) {
        self.tasks.spawn(name, task);
    }

    /// Waits until a task ends on its own, which none should.
    pub async fn ended(&mut self) -> Ended {
        tokio::select! {
            ended = self.tasks.ended() => ended,
            () = self.store.stopped() => Ended("the database"),
        }
    }

    /// Takes over what of a new configuration can change while running: the diagnosis and the machines. Returns the
    /// sections that differ and need a restart.
    pub fn reload(&self, new: Config) -> Vec<&'static str> {
        let old = Arc::clone(&self.config.borrow());
        let needs_restart = [
            ("monitor", old.monitor != new.monitor),
            ("subscribe", old.subscribe != new.subscribe),
            ("identify", old.identify != new.identify),
            ("store", old.store != new.store),
            ("web", old.web != new.web),
            ("log", old.log != new.log),
            ("zenoh", old.zenoh_text() != new.zenoh_text()),
        ];
        let config = Config { diagnosis: new.diagnosis, machines: new.machines, ..Config::clone(&old) };
        self.config.send_replace(Arc::new(config));
        needs_restart.into_iter().filter(|(_, differs)| *differs).map(|(section, _)| section).collect()
    }
}

fn report_database(report: &store::Report, settings: &store::Settings) {
    let database = settings.path.display();
    match &report.found {
        Found::Fresh => tracing::info!(%database, "a new database"),
        Found::Clean => tracing::info!(%database, "the database was closed in good order"),
        Found::Unclean => tracing::warn!(%database, "the database was not closed in good order; checked, and sound"),
        Found::SetAside { to, why } => {
            let set_aside = to.display();
            tracing::error!(%database, %set_aside, why, "the database was BROKEN: it was set aside and a fresh one begun");
        }
    }
    if report.upgraded_by > 0 {
        tracing::info!(migrations = report.upgraded_by, "the database was brought up to date");
    }
    if report.newer_schema {
        tracing::warn!("a newer version of the program has used this database; what it added is left alone");
    }
}

async fn answer_questions(
    config: &Config,
    session: &Session,
    store: &Store,
    tasks: &Tasks,
    orders: mpsc::Sender<judge::Order>,
) -> Result<(), BusError> {
    let reader = store.reader();
    let scope = |kind| config.scope.key_expression(kind);
    let questions = Questions::declare(session, &scope(Kind::Health)).await?;
    tasks.spawn("answer health", answer::health(questions, reader.clone()));
    let questions = Questions::declare(session, &scope(Kind::Alarm)).await?;
    tasks.spawn("answer alarms", answer::alarms(questions, reader.clone(), None));
    let questions = Questions::declare(session, &scope(Kind::Command)).await?;
    tasks.spawn("answer commands", answer::commands(questions, orders.clone()));

    // The daemon's own alarms stand under its own name, which need not lie in the part of the fleet that it serves.
    let own = |kind| machine_key(&config.monitor.as_machine(), kind);
    if bus::intersect(&scope(Kind::Alarm), &own(Kind::Alarm)) {
        return Ok(());
    }
    let questions = Questions::declare(session, &own(Kind::Alarm)).await?;
    tasks.spawn("answer own alarms", answer::alarms(questions, reader.clone(), Some(scope(Kind::Alarm))));
    let questions = Questions::declare(session, &own(Kind::Command)).await?;
    tasks.spawn("answer own commands", answer::commands(questions, orders));
    Ok(())
}
