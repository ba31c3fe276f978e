//! The real programs in a temporary folder, on free ports.

#![allow(dead_code, reason = "shared by test targets, each of which needs some of it")]

use std::{
    borrow::Borrow,
    ffi::OsString,
    fmt::Display,
    fs,
    io::{BufRead, BufReader},
    net::{SocketAddr, TcpListener},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Output, Stdio},
    sync::{Arc, Condvar, Mutex, mpsc},
    thread,
    time::{Duration, Instant},
};

use pointsd::{
    bus,
    daemon::config::{Document, client_session},
    simulate::{Fault, FleetFault, FleetSettings},
    store::{Reader, Selector},
    throw::{Throw, ThrowRef, Trace},
    wire::{Alarm, encode_throw},
};
use sqlx::Connection as _;
use zenoh::{
    Session, bytes::Encoding, handlers::FifoChannelHandler, pubsub::Subscriber, qos::CongestionControl, sample::Sample,
};

/// Longest wait for an event, sufficient on a loaded computer.
pub(crate) const PATIENCE: Duration = Duration::from_mins(1);

/// The number in an environment variable for long runs; `usual` if it is not set.
pub(crate) fn size(variable: &str, usual: usize) -> usize {
    std::env::var(variable)
        .map_or(usual, |text| text.parse().unwrap_or_else(|_| panic!("{variable}={text}: no number")))
}

/// Whether a program is installed; prints a line if it is not.
pub(crate) fn has(program: &str) -> bool {
    let is_there = Command::new(program).arg("--version").output().is_ok();
    if !is_there {
        println!("skipped: {program} is not installed");
    }
    is_there
}

/// A folder with a configuration and a database.
pub(crate) struct Rig {
    folder: PathBuf,
    temporary: tempfile::TempDir,
    extra: String,
    store: String,
    listen: String,
    router: Option<String>,
    environment: Vec<(OsString, OsString)>,
}

/// A running `pointsd run`.
pub(crate) struct Daemon {
    child: Child,
    /// Address of its listener for clients.
    pub(crate) endpoint: String,
    log: Arc<Log>,
}

/// Log lines of a daemon.
#[derive(Default)]
struct Log {
    lines: Mutex<Vec<String>>,
    /// Notified for each new line.
    more: Condvar,
}

#[derive(Debug)]
pub(crate) struct NotStarted {
    pub(crate) status: ExitStatus,
    pub(crate) log: Vec<String>,
}

impl Rig {
    pub(crate) fn new() -> Self {
        Self::with("")
    }

    /// A rig with additional lines of configuration.
    pub(crate) fn with(extra: &str) -> Self {
        let temporary = tempfile::tempdir().unwrap();
        Self {
            folder: temporary.path().to_owned(),
            temporary,
            extra: extra.to_owned(),
            store: "ballast_mib = 0\n".to_owned(),
            listen: "tcp/127.0.0.1:0".to_owned(),
            router: None,
            environment: Vec::new(),
        }
    }

    /// Its files are in the folder of another rig or in another existing one.
    pub(crate) fn in_folder(self, folder: &Path) -> Self {
        Self { folder: folder.to_owned(), ..self }
    }

    /// Sets the lines of the section `[store]`.
    pub(crate) fn store(self, lines: &str) -> Self {
        Self { store: lines.to_owned(), ..self }
    }

    /// The daemon listens on the same port at every start, so that clients can connect again.
    pub(crate) fn same_port(self) -> Self {
        Self { listen: format!("tcp/{}", free_address()), ..self }
    }

    /// The daemon has the port of another rig's daemon.
    pub(crate) fn listening_like(self, other: &Self) -> Self {
        Self { listen: other.listen.clone(), ..self }
    }

    /// The daemon connects to a router, and has no listener.
    pub(crate) fn behind(self, router: &str) -> Self {
        Self { router: Some(router.to_owned()), ..self }
    }

    /// Sets an environment variable of the daemon from the next start.
    pub(crate) fn set(&mut self, name: &str, value: impl Into<OsString>) {
        self.environment.push((name.into(), value.into()));
    }

    /// Ends the rig and returns its own folder.
    pub(crate) fn into_folder(self) -> tempfile::TempDir {
        assert_eq!(self.folder, self.temporary.path(), "the files are in another folder");
        self.temporary
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(crate) fn database(&self) -> PathBuf {
        self.folder.join("points.db")
    }

    /// Writes the configuration; returns its path.
    pub(crate) fn write_config(&self) -> PathBuf {
        let path = self.folder.join("pointsd.toml");
        let Self { extra, store, .. } = self;
        let zenoh = match &self.router {
            Some(router) => format!("mode = \"client\"\nlisten.endpoints = []\nconnect.endpoints = [{router:?}]"),
            None => format!("listen.endpoints = [{:?}]", self.listen),
        };
        let database = self.database().display().to_string();
        let text = format!("{extra}\n[store]\npath = {database:?}\n{store}\n[zenoh]\n{zenoh}\n");
        fs::write(&path, text).unwrap();
        path
    }

    /// A rig with a daemon that is ready.
    pub(crate) fn running() -> (Self, Daemon) {
        Self::running_with("")
    }

    /// A rig with additional lines of configuration, and a daemon that is ready.
    pub(crate) fn running_with(extra: &str) -> (Self, Daemon) {
        let rig = Self::with(extra);
        let daemon = rig.start();
        (rig, daemon)
    }

    /// Starts the daemon and waits until it is ready.
    pub(crate) fn start(&self) -> Daemon {
        self.try_start().unwrap_or_else(|failed| panic!("the daemon is not ready: {failed:?}"))
    }

    /// Starts the daemon and waits until it is ready or has ended.
    pub(crate) fn try_start(&self) -> Result<Daemon, NotStarted> {
        let (mut daemon, ready) = self.launch();
        match ready.recv_timeout(PATIENCE) {
            Ok(endpoint) => {
                daemon.endpoint = endpoint;
                Ok(daemon)
            }
            Err(mpsc::RecvTimeoutError::Disconnected) => {
                Err(NotStarted { status: daemon.child.wait().unwrap(), log: daemon.log() })
            }
            Err(mpsc::RecvTimeoutError::Timeout) => panic!("the daemon does not become ready: {:?}", daemon.log()),
        }
    }

    /// Starts the daemon; the receiver gets its endpoint when it is ready.
    pub(crate) fn launch(&self) -> (Daemon, mpsc::Receiver<String>) {
        let mut command = pointsd(&["run", "--config"]);
        command.arg(self.write_config()).envs(self.environment.iter().cloned());
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let log = Arc::new(Log::default());
        let (ready, endpoint) = mpsc::channel();
        let lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let kept = Arc::clone(&log);
        thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                if line.contains(" ready ") {
                    let at = line.find("tcp/127.0.0.1:").unwrap_or(line.len());
                    let endpoint: String = line[at..].chars().take_while(|c| *c != '"').collect();
                    let _ = ready.send(endpoint);
                }
                kept.lines.lock().unwrap().push(line);
                kept.more.notify_all();
            }
        });
        (Daemon { child, endpoint: self.listen.clone(), log }, endpoint)
    }

    /// Every row of the health history, in the order of arrival.
    pub(crate) async fn history(&self) -> Vec<pointsd::wire::Health> {
        let reader = Reader::open(&self.database()).await.unwrap();
        reader.health_history(&Selector::default(), jiff::Timestamp::UNIX_EPOCH, 1_000_000).await.unwrap()
    }

    /// Waits until `count` throws are judged.
    pub(crate) async fn judged(&self, count: usize) -> Vec<pointsd::wire::Health> {
        let deadline = Instant::now() + PATIENCE;
        // Without `until`, as the compiler cannot show that its async closure is `Send`, and some tests spawn this.
        loop {
            let history = self.history().await;
            if history.len() >= count {
                return history;
            }
            assert!(Instant::now() < deadline, "{} of {count} throws are judged: {history:?}", history.len());
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Runs `pointsd sql` and returns the rows.
    pub(crate) fn sql(&self, question: &str) -> Vec<serde_json::Value> {
        let text = ends(0, pointsd(&["sql", "--json", question, "--database"]).arg(self.database()));
        serde_json::from_str(&text).unwrap()
    }

    /// Runs a query that returns one whole number.
    pub(crate) fn number(&self, question: &str) -> u64 {
        let rows = self.sql(question);
        let value = rows[0].as_object().and_then(|row| row.values().next()?.as_u64());
        value.unwrap_or_else(|| panic!("{question}: {rows:?}"))
    }

    /// Waits until a query returns this whole number.
    pub(crate) async fn until_number(&self, question: &str, expected: u64) {
        until(PATIENCE, async || {
            let number = self.number(question);
            if number == expected { Ok(()) } else { Err(format!("{question}: {number}, not {expected}")) }
        })
        .await;
    }

    /// Waits until a query returns a row.
    pub(crate) async fn until_sql(&self, question: &str) {
        until(PATIENCE, async || if self.sql(question).is_empty() { Err(question) } else { Ok(()) }).await;
    }

    async fn connection(&self) -> sqlx::SqliteConnection {
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(self.database());
        sqlx::SqliteConnection::connect_with(&options).await.unwrap()
    }

    /// Locks the database for other programs with a statement such as `BEGIN IMMEDIATE`, until `ROLLBACK`.
    pub(crate) async fn locked(&self, begin: &'static str) -> sqlx::SqliteConnection {
        let mut connection = self.connection().await;
        sqlx::query(begin).execute(&mut connection).await.unwrap();
        connection
    }

    /// Changes the database as another program would, also beside a running daemon.
    pub(crate) async fn change(&self, statement: impl Into<String>) {
        let mut connection = self.connection().await;
        sqlx::query(sqlx::AssertSqlSafe(statement.into())).execute(&mut connection).await.unwrap();
        connection.close().await.unwrap();
    }
}

impl Daemon {
    /// Stops it with SIGTERM, as the drop of the value does.
    pub(crate) fn terminate(self) {
        drop(self);
    }

    pub(crate) fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    pub(crate) fn signal(&self, signal: &str) {
        send_signal(signal, self.id());
    }

    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    pub(crate) fn is_running(&mut self) -> bool {
        self.ended().is_none()
    }

    pub(crate) fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().unwrap()
    }

    pub(crate) fn log(&self) -> Vec<String> {
        self.log.lines.lock().unwrap().clone()
    }

    /// Waits until it logs a line that contains `words`; returns the first such line.
    pub(crate) fn until_log(&self, words: &str) -> String {
        let found = |lines: &[String]| lines.iter().find(|line| line.contains(words)).cloned();
        let lines = self.log.lines.lock().unwrap();
        let (lines, _) = self.log.more.wait_timeout_while(lines, PATIENCE, |lines| found(lines).is_none()).unwrap();
        found(&lines).unwrap_or_else(|| panic!("no log line with {words:?}: {lines:?}"))
    }

    /// Waits for the exit.
    pub(crate) fn wait(&mut self, limit: Duration) -> ExitStatus {
        let deadline = Instant::now() + limit;
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(Instant::now() < deadline, "still running after {limit:?}: {:?}", self.log());
            thread::sleep(Duration::from_millis(20));
        }
    }

    pub(crate) async fn client(&self) -> Session {
        client_of(&self.endpoint).await
    }

    /// A logger with its own session that publishes on this key.
    pub(crate) async fn logger(&self, key: &str) -> Sender {
        Sender::of(&self.client().await, key).await
    }

    /// The output of `pointsd status --json`.
    pub(crate) fn status(&self) -> serde_json::Value {
        // The exit code may report alarms, so it is ignored.
        let (_, text) = self.operate(&["status", "--json"]);
        let mut status: serde_json::Value =
            serde_json::from_str(&text).unwrap_or_else(|_| panic!("{text}: {:?}", self.log()));
        status["daemons"][0].take()
    }

    /// Waits until its status fulfils a condition.
    pub(crate) async fn until_status(&self, what: &str, is_so: impl Fn(&serde_json::Value) -> bool) {
        until(PATIENCE, async || {
            let status = self.status();
            if is_so(&status) { Ok(()) } else { Err(format!("no {what}: {status}; {:?}", self.log())) }
        })
        .await;
    }

    /// Runs an operator's command, which ends with this exit code; returns what it printed.
    #[track_caller]
    pub(crate) fn says(&self, exit: i32, arguments: &[&str]) -> String {
        ends(exit, pointsd(arguments).args(["--connect", &self.endpoint]))
    }

    /// Runs an operator's command; returns its exit code and what it printed.
    pub(crate) fn operate(&self, arguments: &[&str]) -> (Option<i32>, String) {
        run(pointsd(arguments).args(["--connect", &self.endpoint]))
    }
}

/// Polls `look` every 20 ms until it returns a result; fails with its last error after `limit`.
pub(crate) async fn until<T, E: Display>(limit: Duration, mut look: impl AsyncFnMut() -> Result<T, E>) -> T {
    let deadline = Instant::now() + limit;
    loop {
        match look().await {
            Ok(result) => return result,
            Err(problem) => assert!(Instant::now() < deadline, "{problem}"),
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

pub(crate) type Alarms = Subscriber<FifoChannelHandler<Sample>>;

/// Subscribes to all alarms.
pub(crate) async fn listen(session: &Session) -> Alarms {
    session.declare_subscriber("points/v1/**/alarm").await.unwrap()
}

/// The next alarm event, with its key.
pub(crate) async fn next(alarms: &Alarms) -> (String, Alarm) {
    let sample = tokio::time::timeout(2 * PATIENCE, alarms.recv_async()).await.unwrap().unwrap();
    assert_eq!(sample.encoding(), &Encoding::APPLICATION_JSON);
    (sample.key_expr().to_string(), serde_json::from_slice(&sample.payload().to_bytes()).unwrap())
}

/// A client of this endpoint that connects again soon after a cut.
pub(crate) async fn client_of(endpoint: &str) -> Session {
    client(&format!("endpoints = [{endpoint:?}], retry = {{ period_init_ms = 50, period_max_ms = 200 }}")).await
}

/// A client with the default retry times of zenoh.
pub(crate) async fn patient_client_of(endpoint: &str) -> Session {
    client(&format!("endpoints = [{endpoint:?}]")).await
}

async fn client(connect: &str) -> Session {
    let document = Document::parse("test".as_ref(), format!("zenoh.connect = {{ {connect} }}")).unwrap();
    bus::open(client_session(&document).unwrap()).await.unwrap()
}

impl Drop for Daemon {
    /// Sends SIGTERM; the daemon ends without an error within ten seconds, a third of the time limit of the systemd unit.
    /// A test that failed must not leave it behind.
    fn drop(&mut self) {
        if thread::panicking() || self.ended().is_some() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        } else {
            self.signal("-TERM");
            assert!(self.wait(Duration::from_secs(10)).success(), "{:?}", self.log());
        }
    }
}

pub(crate) fn send_signal(signal: &str, process: u32) {
    ends(0, Command::new("kill").args([signal, &process.to_string()]));
}

/// The value of a line in `/proc/{process}/status`.
pub(crate) fn status_of(process: u32, key: &str) -> String {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':')).unwrap();
    line.trim_end_matches("kB").trim().to_owned()
}

/// An address at which nothing listens at present.
pub(crate) fn free_address() -> SocketAddr {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

/// Another process; the drop of this value kills it.
pub(crate) struct Program(pub(crate) Child);

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A program of this package; an environment variable can name another build.
fn program(variable: &str, built: &str) -> Command {
    Command::new(std::env::var_os(variable).unwrap_or_else(|| built.into()))
}

pub(crate) fn pointsd(arguments: &[&str]) -> Command {
    let mut command = program("CARGO_BIN_EXE_pointsd", env!("CARGO_BIN_EXE_pointsd"));
    command.args(arguments).env_remove("NOTIFY_SOCKET").env_remove("WATCHDOG_USEC");
    command
}

pub(crate) fn pointsim(arguments: &[&str]) -> Command {
    let mut command = program("CARGO_BIN_EXE_pointsim", env!("CARGO_BIN_EXE_pointsim"));
    command.args(arguments);
    command
}

/// Runs a program; returns its exit code and what it printed.
pub(crate) fn run(command: &mut Command) -> (Option<i32>, String) {
    let output = command.output().unwrap();
    (output.status.code(), String::from_utf8([output.stdout, output.stderr].concat()).unwrap())
}

/// Runs a program whose stdout is a closed pipe.
pub(crate) fn run_with_closed_pipe(command: &mut Command) -> Output {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    child.wait_with_output().unwrap()
}

/// Runs a program, which ends with this exit code; returns what it printed.
#[track_caller]
pub(crate) fn ends(exit: i32, command: &mut Command) -> String {
    let (code, text) = run(command);
    assert_eq!(code, Some(exit), "{command:?}: {text}");
    text
}

/// Throws of one simulated machine, ten minutes apart.
pub(crate) fn throws(boot_id: &str, count: u64) -> Vec<Throw> {
    simulated(Vec::new(), boot_id, count)
}

/// Throws of the same machine with a fault.
pub(crate) fn faulty_throws(fault: Fault, boot_id: &str, count: u64) -> Vec<Throw> {
    simulated(vec![FleetFault { machine: 0, fault }], boot_id, count)
}

fn simulated(faults: Vec<FleetFault>, boot_id: &str, count: u64) -> Vec<Throw> {
    let settings = FleetSettings { machines: 1, faults, ..FleetSettings::default() };
    let mut machine = settings.build(5).unwrap().remove(0);
    let first: jiff::Timestamp = "2026-05-04T10:00:00Z".parse().unwrap();
    (1..=count)
        .map(|throw_no| {
            let at = first + jiff::SignedDuration::from_mins(10 * throw_no.cast_signed());
            Throw { supply_v: None, ..machine.next_throw(boot_id, at).unwrap() }
        })
        .collect()
}

/// A small throw that cannot be evaluated.
pub(crate) fn stub(boot_id: &str, throw_no: u64) -> Throw {
    Throw {
        id: ThrowRef { boot_id: boot_id.to_owned(), throw_no },
        started_at: "2026-05-04T10:00:00Z".parse().unwrap(),
        ..Throw::recorded(Trace::new(100.0, vec![0.0; 20], vec![0.0; 20]).unwrap())
    }
}

/// A connected logger of one machine.
pub(crate) struct Sender {
    pub(crate) session: Session,
    publisher: zenoh::pubsub::Publisher<'static>,
}

impl Sender {
    /// A logger on this session that publishes on this key.
    pub(crate) async fn of(session: &Session, key: &str) -> Self {
        Self { session: session.clone(), publisher: matched(session, key).await }
    }

    /// Publishes throws in CBOR.
    pub(crate) async fn send(&self, throws: impl IntoIterator<Item: Borrow<Throw>>) {
        for throw in throws {
            self.publisher.put(encode_throw(throw.borrow())).await.unwrap();
        }
    }

    /// Closes the session after everything is sent.
    pub(crate) async fn close(self) {
        drop(self.publisher);
        self.session.close().await.unwrap();
    }
}

pub(crate) async fn put(session: &Session, key: &str, encoding: Encoding, payload: Vec<u8>) {
    session.put(key, payload).encoding(encoding).congestion_control(CongestionControl::Block).await.unwrap();
}

/// A publisher that has a subscriber.
pub(crate) async fn matched(session: &Session, key: impl Into<String>) -> zenoh::pubsub::Publisher<'static> {
    let publisher = session
        .declare_publisher(key.into())
        .encoding(Encoding::APPLICATION_CBOR)
        .congestion_control(CongestionControl::Block)
        .await
        .unwrap();
    until_matched(&publisher).await;
    publisher
}

/// Waits until the publisher has a subscriber.
pub(crate) async fn until_matched(publisher: &zenoh::pubsub::Publisher<'_>) {
    let listener = publisher.matching_listener().await.unwrap();
    while !publisher.matching_status().await.unwrap().matching() {
        tokio::time::timeout(PATIENCE, listener.recv_async()).await.unwrap().unwrap();
    }
}
